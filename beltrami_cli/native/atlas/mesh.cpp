#include "atlas/mesh.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "atlas/adjacency.hpp"

namespace beltrami::atlas {
namespace {

// Rounds off what computing u * width leaves behind, so that what is meant to lie on a texel's centre does so.
constexpr double coordinate_steps = 1 << 20;
// Coordinates beyond this name no texel to any use; such faces stay, but without extent in the image.
constexpr double farthest_texel = 1 << 28;
// More faces on the same three places than this are not compared with each other.
constexpr std::ptrdiff_t most_copies = 16;

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
      if (mesh.places[one][i] == mesh.places[other][j] && !same(mesh.texels[one][i], mesh.texels[other][j])) return false;
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

}  // namespace

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
