#include "atlas/mesh.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <stdexcept>

namespace beltrami::atlas {
namespace {

// Removes the rounding of u * width, so that coordinates of texel centres are on the centres.
constexpr double coordinate_steps = 1 << 20;
// Limit of useful coordinates; faces beyond it are kept, but without extent in the image.
constexpr double farthest_texel = 1 << 28;
// Maximum number of faces with the same three places that are compared with each other.
constexpr std::ptrdiff_t most_copies = 16;
// Precision of a single-precision coordinate near 1 of a texture of 16,384 texels.
constexpr double same_texel_tolerance = 1.0 / 1024;
// Maximum number of faces at an edge among which pairs are searched; with more, the edge is open.
constexpr std::size_t most_faces_on_an_edge = 16;

std::array<Index, 3> sorted(std::array<Index, 3> triple) {
  std::sort(triple.begin(), triple.end());
  return triple;
}

// Lists the items of each key in [0, keys), in order: items of key k are [offsets[k], offsets[k + 1]).
template <class KeyOf>
void bucket(std::size_t count, std::size_t keys, const KeyOf& key_of, std::vector<Index>& offsets,
            std::vector<Index>& items) {
  offsets.assign(keys + 1, 0);
  for (std::size_t i = 0; i < count; ++i)
    if (const Index key = key_of(i); key != none) ++offsets[static_cast<std::size_t>(key) + 1];
  for (std::size_t k = 0; k < keys; ++k) offsets[k + 1] += offsets[k];
  items.resize(static_cast<std::size_t>(offsets.back()));
  auto cursor = offsets;
  for (std::size_t i = 0; i < count; ++i)
    if (const Index key = key_of(i); key != none)
      items[static_cast<std::size_t>(cursor[static_cast<std::size_t>(key)]++)] = static_cast<Index>(i);
}

std::array<Point2, 3> texel_corners(const double* uv, const Texture& texture) {
  std::array<Point2, 3> corners;
  for (std::size_t k = 0; k < 3; ++k) {
    const double x = uv[2 * k] * texture.width - 0.5, y = uv[2 * k + 1] * texture.height - 0.5;
    if (!(std::abs(x) < farthest_texel && std::abs(y) < farthest_texel)) return {};
    corners[k] = {std::nearbyint(x * coordinate_steps) / coordinate_steps,
                  std::nearbyint(y * coordinate_steps) / coordinate_steps};
  }
  return corners;
}

bool is_copy(const Mesh& mesh, std::size_t one, std::size_t other) {
  if (mesh.texture[one] != mesh.texture[other]) return false;
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j)
      if (mesh.places[one][i] == mesh.places[other][j] && !same_texel(mesh.texels[one][i], mesh.texels[other][j])) return false;
  return true;
}

void remove_copies(Mesh& mesh) {
  std::vector<Index> offsets, faces;
  bucket(mesh.size(), static_cast<std::size_t>(mesh.surface->place_count),
         [&](std::size_t f) { return std::min({mesh.places[f][0], mesh.places[f][1], mesh.places[f][2]}); }, offsets,
         faces);
  std::vector<std::uint8_t> copy(mesh.size(), 0);
  for (std::size_t place = 0; place + 1 < offsets.size(); ++place) {
    const auto begin = faces.begin() + offsets[place], end = faces.begin() + offsets[place + 1];
    const auto key = [&](Index face) { return sorted(mesh.places[static_cast<std::size_t>(face)]); };
    std::sort(begin, end, [&](Index a, Index b) {
      const auto key_a = key(a), key_b = key(b);
      return key_a != key_b ? key_a < key_b : a < b;
    });
    for (auto face = begin; face != end; ++face)
      for (auto before = face; before != begin && face - before < most_copies && key(*(before - 1)) == key(*face); --before)
        if (is_copy(mesh, static_cast<std::size_t>(*(before - 1)), static_cast<std::size_t>(*face)))
          copy[static_cast<std::size_t>(*face)] = 1;
  }
  std::size_t kept = 0;
  for (std::size_t face = 0; face < mesh.size(); ++face) {
    if (copy[face] != 0) continue;
    mesh.places[kept] = mesh.places[face];
    mesh.texels[kept] = mesh.texels[face];
    mesh.texture[kept++] = mesh.texture[face];
  }
  mesh.places.resize(kept);
  mesh.texels.resize(kept);
  mesh.texture.resize(kept);
}

void take_faces(Mesh& mesh) {
  const Surface& surface = *mesh.surface;
  for (std::size_t face = 0; face < surface.texture_of.size(); ++face) {
    const Index texture = surface.texture_of[face];
    if (texture == none) continue;
    if (texture < 0 || static_cast<std::size_t>(texture) >= surface.textures.size())
      throw std::invalid_argument("a face names a texture that does not exist");
    const auto* places = surface.places.data() + 3 * face;
    for (std::size_t k = 0; k < 3; ++k)
      if (places[k] < 0 || places[k] >= surface.place_count)
        throw std::invalid_argument("a face names a place that does not exist");
    mesh.places.push_back({places[0], places[1], places[2]});
    mesh.texels.push_back(texel_corners(surface.uv + 6 * face, surface.textures[static_cast<std::size_t>(texture)]));
    mesh.texture.push_back(texture);
  }
}

struct Ends {
  Index low, high;
  Point2 at_low, at_high;
  double side;  // its sign: on which side of low -> high the face lies in the image
};

Ends ends_of(const Mesh& mesh, Edge edge) {
  const auto face = static_cast<std::size_t>(edge / 3), k = static_cast<std::size_t>(edge % 3);
  const auto& texels = mesh.texels[face];
  const Index a = mesh.places[face][k], b = mesh.places[face][next(k)];
  const double area = doubled_area(texels);
  return a < b ? Ends{a, b, texels[k], texels[next(k)], area} : Ends{b, a, texels[next(k)], texels[k], -area};
}

bool is_inside_chart(const Mesh& mesh, Edge one, Edge other) {
  if (mesh.texture[static_cast<std::size_t>(one / 3)] != mesh.texture[static_cast<std::size_t>(other / 3)]) return false;
  const Ends a = ends_of(mesh, one), b = ends_of(mesh, other);
  return same_texel(a.at_low, b.at_low) && same_texel(a.at_high, b.at_high) && ((a.side < 0 && b.side > 0) || (a.side > 0 && b.side < 0));
}

void join(Mesh& mesh, Edge one, Edge other, bool seam) {
  mesh.twins[static_cast<std::size_t>(one)] = other;
  mesh.twins[static_cast<std::size_t>(other)] = one;
  mesh.seams[static_cast<std::size_t>(one)] = mesh.seams[static_cast<std::size_t>(other)] = seam;
}

// Two faces with the same three places coincide: the surface does not continue from one to the other.
bool is_fold(const Mesh& mesh, Edge one, Edge other) {
  return sorted(mesh.places[static_cast<std::size_t>(one / 3)]) == sorted(mesh.places[static_cast<std::size_t>(other / 3)]);
}

void pair_edges(Mesh& mesh, std::span<const Index> edges) {
  if (edges.size() < 2 || edges.size() > most_faces_on_an_edge) return;
  if (edges.size() == 2) {
    const bool inside = is_inside_chart(mesh, edges[0], edges[1]);
    if (inside || !is_fold(mesh, edges[0], edges[1])) join(mesh, edges[0], edges[1], !inside);
    return;
  }
  // Several sheets meet here; each continues where exactly one other face continues it in the image.
  std::array<Edge, most_faces_on_an_edge> partner;
  for (std::size_t i = 0; i < edges.size(); ++i) {
    partner[i] = none;
    int partners = 0;
    for (std::size_t j = 0; j < edges.size(); ++j)
      if (j != i && is_inside_chart(mesh, edges[i], edges[j])) {
        partner[i] = static_cast<Edge>(j);
        ++partners;
      }
    if (partners != 1) partner[i] = none;
  }
  for (std::size_t i = 0; i < edges.size(); ++i)
    if (partner[i] != none && static_cast<std::size_t>(partner[i]) > i &&
        partner[static_cast<std::size_t>(partner[i])] == static_cast<Edge>(i))
      join(mesh, edges[i], edges[static_cast<std::size_t>(partner[i])], false);
}

void find_twins(Mesh& mesh) {
  mesh.twins.assign(3 * mesh.size(), none);
  mesh.seams.assign(3 * mesh.size(), 0);
  const auto other_end = [&](Edge edge, bool low) {
    const auto& places = mesh.places[static_cast<std::size_t>(edge / 3)];
    const Index a = places[static_cast<std::size_t>(edge % 3)], b = places[next(static_cast<std::size_t>(edge % 3))];
    return low ? std::min(a, b) : std::max(a, b);
  };
  const auto key_of = [&](std::size_t edge) {
    // A face that repeats a place has no inside that could connect its edges.
    const auto& [a, b, c] = mesh.places[edge / 3];
    return a == b || b == c || c == a ? none : other_end(static_cast<Edge>(edge), true);
  };
  std::vector<Index> offsets, edges;
  bucket(3 * mesh.size(), static_cast<std::size_t>(mesh.surface->place_count), key_of, offsets, edges);
  for (std::size_t place = 0; place + 1 < offsets.size(); ++place) {
    const auto begin = edges.begin() + offsets[place], end = edges.begin() + offsets[place + 1];
    std::sort(begin, end, [&](Edge a, Edge b) {
      const Index high_a = other_end(a, false), high_b = other_end(b, false);
      return high_a != high_b ? high_a < high_b : a < b;
    });
    for (auto run = begin; run != end;) {
      auto stop = run;
      while (stop != end && other_end(*stop, false) == other_end(*run, false)) ++stop;
      pair_edges(mesh, std::span<const Index>(&*run, static_cast<std::size_t>(stop - run)));
      run = stop;
    }
  }
}

// If neighbours differ by rounding, the later face takes the corners of the earlier one, so that no texel is left out
// between.
void close_cracks(Mesh& mesh) {
  for (std::size_t edge = 0; edge < mesh.twins.size(); ++edge) {
    const Edge twin = mesh.twins[edge];
    if (twin == none || mesh.seams[edge] != 0 || static_cast<std::size_t>(twin) < edge) continue;
    const std::size_t face = edge / 3, k = edge % 3;
    const auto other = static_cast<std::size_t>(twin / 3), j = static_cast<std::size_t>(twin % 3);
    const bool along = mesh.places[face][k] == mesh.places[other][j];
    mesh.texels[other][along ? j : next(j)] = mesh.texels[face][k];
    mesh.texels[other][along ? next(j) : j] = mesh.texels[face][next(k)];
  }
}

// Fills Mesh::twins and Mesh::seams from the places and texels of the faces, and equalises the corners of neighbours in
// a chart, which may differ by rounding.
void join_faces(Mesh& mesh) {
  find_twins(mesh);
  close_cracks(mesh);
}

}  // namespace

bool same_texel(Point2 a, Point2 b) {
  return std::abs(a.x - b.x) <= same_texel_tolerance && std::abs(a.y - b.y) <= same_texel_tolerance;
}

Mesh make_mesh(const Surface& surface) {
  if (surface.texture_of.size() > static_cast<std::size_t>(std::numeric_limits<Index>::max()) / 3)
    throw std::length_error("the mesh has more triangles than 32-bit indices can count");
  Mesh mesh;
  mesh.surface = &surface;
  take_faces(mesh);
  remove_copies(mesh);
  join_faces(mesh);
  return mesh;
}

}  // namespace beltrami::atlas
