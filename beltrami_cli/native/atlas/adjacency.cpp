#include "atlas/adjacency.hpp"

#include <span>

namespace beltrami::atlas {
namespace {

// An edge on which more faces meet is open without looking for pairs among them.
constexpr std::size_t most_faces_on_an_edge = 16;

struct Ends {
  Index low, high;
  Point2 at_low, at_high;
  double side;  // its sign tells on which side of low -> high the face lies in the image
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
  return same(a.at_low, b.at_low) && same(a.at_high, b.at_high) && ((a.side < 0 && b.side > 0) || (a.side > 0 && b.side < 0));
}

void join(Mesh& mesh, Edge one, Edge other, bool seam) {
  mesh.twins[static_cast<std::size_t>(one)] = other;
  mesh.twins[static_cast<std::size_t>(other)] = one;
  mesh.seams[static_cast<std::size_t>(one)] = mesh.seams[static_cast<std::size_t>(other)] = seam;
}

// Two faces with the same three places lie on each other: the surface does not go on from one to the other.
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
  // Several sheets meet here; each goes on where exactly one other face continues it in the image.
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
    // A face that repeats a place has no inside that could lead from one edge to another.
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

// Where neighbours differ by a rounding, the later face takes the corners of the earlier: no texel falls between.
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

}  // namespace

void join_faces(Mesh& mesh) {
  find_twins(mesh);
  close_cracks(mesh);
}

}  // namespace beltrami::atlas
