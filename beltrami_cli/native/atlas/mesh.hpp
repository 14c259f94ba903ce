// Textured triangles and their neighbours over edges: inside a chart, or across a seam.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace beltrami::atlas {

using Index = std::int32_t;
constexpr Index none = -1;

// Points of the image plane and of space.
struct Point2 {
  double x = 0, y = 0;
};

struct Point3 {
  double x = 0, y = 0, z = 0;
};

inline Point2 operator+(Point2 a, Point2 b) { return {a.x + b.x, a.y + b.y}; }
inline Point2 operator-(Point2 a, Point2 b) { return {a.x - b.x, a.y - b.y}; }
inline Point2 operator*(double s, Point2 a) { return {s * a.x, s * a.y}; }
inline double dot(Point2 a, Point2 b) { return a.x * b.x + a.y * b.y; }
inline double cross(Point2 a, Point2 b) { return a.x * b.y - a.y * b.x; }

inline Point3 operator+(Point3 a, Point3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Point3 operator-(Point3 a, Point3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Point3 operator*(double s, Point3 a) { return {s * a.x, s * a.y, s * a.z}; }
inline double dot(Point3 a, Point3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Point3 cross(Point3 a, Point3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// The grid of a texture. Texel (x, y) has its centre at the integer point (x, y) of the texture's plane, x to the right and
// y down; beyond the image the plane goes on as the wrap modes say.
enum class Wrap : std::uint8_t { repeat, mirror, clamp };

struct Texture {
  std::int32_t width = 0, height = 0;
  Wrap wrap_x = Wrap::repeat, wrap_y = Wrap::repeat;
  std::int64_t offset = 0;  // number of its first texel among the texels of all textures

  std::int64_t texel(std::int32_t x, std::int32_t y) const {
    return offset + static_cast<std::int64_t>(y) * width + x;
  }
};

inline std::int64_t floor_mod(std::int64_t i, std::int64_t n) {
  if (i >= 0 && i < n) return i;
  const std::int64_t remainder = i % n;
  return remainder < 0 ? remainder + n : remainder;
}

// The texel column or row visible at coordinate i of the plane.
inline std::int32_t wrapped(std::int64_t i, std::int32_t size, Wrap wrap) {
  if (i >= 0 && i < size) return static_cast<std::int32_t>(i);
  if (wrap == Wrap::clamp) return i < 0 ? 0 : size - 1;
  if (wrap == Wrap::repeat) return static_cast<std::int32_t>(floor_mod(i, size));
  const std::int64_t twofold = floor_mod(i, 2 * static_cast<std::int64_t>(size));
  return static_cast<std::int32_t>(twofold < size ? twofold : 2 * static_cast<std::int64_t>(size) - 1 - twofold);
}

// The coordinate of texel j within [start, start + size), where each texel has one (for mirror and clamp, start is a
// multiple of the size).
inline std::int64_t unwrapped(std::int32_t j, std::int64_t start, std::int32_t size, Wrap wrap) {
  if (wrap == Wrap::clamp) return j;
  if (wrap == Wrap::repeat) return start + floor_mod(j - start, size);
  const bool odd = floor_mod(start, 2 * static_cast<std::int64_t>(size)) != 0;
  return odd ? start + size - 1 - j : start + j;
}

// The input. A place is a position in space, at which all vertices are joined.
struct Surface {
  const double* positions = nullptr;     // three a place
  Index place_count = 0;
  std::span<const Index> places;         // three a triangle
  const double* uv = nullptr;            // six a triangle, v down
  std::span<const Index> texture_of;     // one a triangle; -1: none
  std::vector<Texture> textures;

  // Total over all textures.
  std::int64_t texel_count() const { return textures.empty() ? 0 : textures.back().texel(0, textures.back().height); }
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
  // Both ends of an edge in the texture's plane.
  std::array<Point2, 2> ends(Edge edge) const {
    const auto& corners = texels[static_cast<std::size_t>(edge / 3)];
    const auto k = static_cast<std::size_t>(edge % 3);
    return {corners[k], corners[next(k)]};
  }
};

// Twice the signed area of a face in the plane of its texture.
inline double doubled_area(const std::array<Point2, 3>& corners) {
  return cross(corners[1] - corners[0], corners[2] - corners[0]);
}

// The affine map of a face from the texture's plane to space.
class FaceMap {
 public:
  FaceMap(const Mesh& mesh, Index face) {
    const auto f = static_cast<std::size_t>(face);
    origin_ = mesh.texels[f][0];
    first_ = mesh.texels[f][1] - origin_;
    second_ = mesh.texels[f][2] - origin_;
    const double area = cross(first_, second_);
    scale_ = area != 0 ? 1 / area : 0;
    base_ = mesh.corner(f, 0);
    along_first_ = mesh.corner(f, 1) - base_;
    along_second_ = mesh.corner(f, 2) - base_;
  }

  // Point in the plane of the face, inside it or not.
  Point3 extended(Point2 place) const {
    const Point2 offset = place - origin_;
    return base_ + cross(offset, second_) * scale_ * along_first_ + cross(first_, offset) * scale_ * along_second_;
  }

  // Whether a point is inside the face, where `inside` and `extended` have equal bits.
  bool holds(Point2 place) const {
    const Point2 offset = place - origin_;
    const double u = cross(offset, second_) * scale_, v = cross(first_, offset) * scale_;
    return u >= 0 && v >= 0 && u + v <= 1;
  }

  // Point on the face, for a point inside up to rounding (which slivers magnify).
  Point3 inside(Point2 place) const {
    const Point2 offset = place - origin_;
    double u = std::clamp(cross(offset, second_) * scale_, 0.0, 1.0);
    double v = std::clamp(cross(first_, offset) * scale_, 0.0, 1.0);
    const double beyond = std::max(u + v, 1.0);
    u /= beyond;
    v /= beyond;
    return base_ + u * along_first_ + v * along_second_;
  }

 private:
  Point2 origin_, first_, second_;
  Point3 base_, along_first_, along_second_;
  double scale_ = 0;
};

// Whether two corners are equal up to rounding.
bool same_texel(Point2 a, Point2 b);

// Builds the mesh of the textured faces; of duplicates with equal places and texture coordinates, of the first. Two
// faces are neighbours inside a chart if they share an edge in space and in the image and are on its two sides there;
// otherwise an edge of exactly two faces is a seam, unless the faces coincide. Where more than two faces meet, each
// pair that continues inside a chart is joined. All other edges are open. Throws std::invalid_argument if an index is
// out of range.
Mesh make_mesh(const Surface& surface);

}  // namespace beltrami::atlas
