// Textured triangles and their neighbours over edges: inside a chart, or across a seam.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "atlas/points.hpp"
#include "atlas/texture.hpp"

namespace beltrami::atlas {

using Index = std::int32_t;
constexpr Index none = -1;

// What is handed in. A place is a point of space in which all vertices at it are joined.
struct Surface {
  const double* positions = nullptr;     // three a place
  Index place_count = 0;
  std::span<const Index> places;         // three a triangle
  const double* uv = nullptr;            // six a triangle, v down
  std::span<const Index> texture_of;     // one a triangle; -1: none
  std::vector<Texture> textures;

  Point3 position(Index place) const {
    const double* p = positions + 3 * static_cast<std::size_t>(place);
    return {p[0], p[1], p[2]};
  }
};

// Edge k of a face leads from its corner k to its corner k + 1 (mod 3); it is coded 3 * face + k.
using Edge = Index;
constexpr std::size_t next(std::size_t k) { return k == 2 ? 0 : k + 1; }

struct Mesh {
  const Surface* surface = nullptr;
  std::vector<std::array<Index, 3>> places;
  std::vector<std::array<Point2, 3>> texels;  // corners in the texture's plane
  std::vector<Index> texture;
  std::vector<Edge> twins;          // [edge]: the same edge of the face on the other side; none if it is open
  std::vector<std::uint8_t> seams;  // [edge]: whether the twin lies across a seam, in another part of the image plane

  std::size_t size() const { return places.size(); }
  const Texture& grid(std::size_t face) const { return surface->textures[static_cast<std::size_t>(texture[face])]; }
  Point3 corner(std::size_t face, std::size_t k) const { return surface->position(places[face][k]); }
};

// Twice the signed area of a face in the plane of its texture.
inline double doubled_area(const std::array<Point2, 3>& corners) {
  return cross(corners[1] - corners[0], corners[2] - corners[0]);
}

// Takes the textured faces; of those with equal places and equal texture coordinates the first. Two faces are
// neighbours inside a chart if they share an edge in space and in the image and lie on its two sides there;
// otherwise an edge of exactly two faces is a seam, unless they lie on each other. Where more than two faces meet,
// each pair that goes on inside a chart is joined. All other edges are open.
// Throws std::invalid_argument if an index is out of range.
Mesh make_mesh(const Surface& surface);

}  // namespace beltrami::atlas
