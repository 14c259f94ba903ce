#include "atlas/connections.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "atlas/unfolding.hpp"

namespace beltrami::atlas {
namespace {

// Tolerance of contact: the precision of a single-precision coordinate near 1 of a texture of 1,024 texels.
constexpr double touching = 1e-4;
// Maximum number of faces between neighbouring cells; beyond it they count as joined.
constexpr std::size_t most_faces = 256, most_seams = 16;
// Tolerance outside of a face, above the rounding of unfolding; and the maximum number of faces of a walk.
constexpr double beyond_edge = 1e-4;
constexpr int longest_search = 64;
// A path over a seam returns to the same point if it ends nearer to it than to any other texel.
constexpr double same_place = 0.5;

// Whether all points are more than `touching` off the line, on one side.
bool is_clear(Point2 from, Point2 along, double length, Point2 a, Point2 b) {
  const double slack = touching * length, left = cross(along, a - from), right = cross(along, b - from);
  return (left > slack && right > slack) || (left < -slack && right < -slack);
}

bool touch(Point2 from, Point2 to, Point2 a, Point2 b) {
  if (std::max(a.x, b.x) < std::min(from.x, to.x) - touching || std::min(a.x, b.x) > std::max(from.x, to.x) + touching ||
      std::max(a.y, b.y) < std::min(from.y, to.y) - touching || std::min(a.y, b.y) > std::max(from.y, to.y) + touching)
    return false;
  const Point2 line = to - from, edge = b - a;
  return !is_clear(from, line, std::sqrt(dot(line, line)), a, b) && !is_clear(a, edge, std::sqrt(dot(edge, edge)), from, to);
}

// The faces of a chart that a line touches, starting with a given face, also over edges that it only touches; and the
// borders it meets.
class Touched {
 public:
  Touched(const Mesh& mesh, Index face, Point2 from, Point2 to) : mesh_(mesh), from_(from), to_(to) {
    faces_[face_count_++] = face;
  }

  // Continues until a face fits, or none is left.
  template <class Fits>
  bool find(const Fits& fits) {
    for (std::size_t i = 0; i < face_count_; ++i) {
      if (fits(faces_[i]) || face_count_ == most_faces) return true;
      for (Edge edge = 3 * faces_[i]; edge < 3 * faces_[i] + 3; ++edge) visit(edge);
    }
    return false;
  }

  bool meets_open() const { return meets_open_; }
  std::span<const Edge> seams() const { return std::span(seams_).first(seam_count_); }

 private:
  void visit(Edge edge) {
    const auto [a, b] = mesh_.ends(edge);
    if (!touch(from_, to_, a, b)) return;
    const Edge twin = mesh_.twins[static_cast<std::size_t>(edge)];
    if (twin == none) {
      meets_open_ = true;
    } else if (mesh_.seams[static_cast<std::size_t>(edge)] != 0) {
      if (seam_count_ < most_seams) seams_[seam_count_++] = edge;
    } else {
      const auto end = faces_.begin() + static_cast<std::ptrdiff_t>(face_count_);
      if (face_count_ < most_faces && std::find(faces_.begin(), end, twin / 3) == end) faces_[face_count_++] = twin / 3;
    }
  }

  const Mesh& mesh_;
  Point2 from_, to_;
  std::array<Index, most_faces> faces_;
  std::array<Edge, most_seams> seams_;
  std::size_t face_count_ = 0, seam_count_ = 0;
  bool meets_open_ = false;
};

bool holds(const Mesh& mesh, Index face, Point2 place) {
  const auto& corners = mesh.texels[static_cast<std::size_t>(face)];
  const double orientation = doubled_area(corners) < 0 ? -1 : 1;
  for (std::size_t k = 0; k < 3; ++k) {
    const Point2 along = corners[next(k)] - corners[k];
    if (orientation * cross(along, place - corners[k]) < -touching * std::sqrt(dot(along, along))) return false;
  }
  return true;
}

}  // namespace

bool is_covered(const Mesh& mesh, Index start, Point2 place) {
  auto face = static_cast<std::size_t>(start);
  Edge entry = none;
  for (int step = 0; step < longest_search; ++step) {
    const auto& corners = mesh.texels[face];
    const double orientation = doubled_area(corners) < 0 ? -1 : 1;
    double farthest = beyond_edge;
    Edge exit = none;
    for (std::size_t k = 0; k < 3; ++k) {
      const Edge edge = static_cast<Edge>(3 * face + k);
      const Point2 along = corners[next(k)] - corners[k];
      const double length = std::sqrt(dot(along, along));
      if (edge == entry || length == 0) continue;
      const double outside = -orientation * cross(along, place - corners[k]) / length;
      if (outside > farthest) {
        farthest = outside;
        exit = edge;
      }
    }
    if (exit == none) return true;
    entry = mesh.twins[static_cast<std::size_t>(exit)];
    if (entry == none || mesh.seams[static_cast<std::size_t>(exit)] != 0) return false;
    face = static_cast<std::size_t>(entry / 3);
  }
  return false;
}

bool Connections::inside(Index face, Point2 from, Index other, Point2 to) const {
  Touched touched(mesh_, face, from, to);
  if (touched.find([&](Index found) { return other == none ? holds(mesh_, found, to) : found == other; })) return true;
  return std::any_of(touched.seams().begin(), touched.seams().end(), [&](Edge seam) {
    const Path path(mesh_, seam, to);
    if (path.end() != End::landed) return false;
    const Landing landing = path.landing();
    const auto landed = static_cast<std::size_t>(landing.face);
    if (charts_.chart_of[landed] != charts_.chart_of[static_cast<std::size_t>(face)]) return false;
    Point2 offset = -1 * to;
    for (std::size_t k = 0; k < 3; ++k) offset = offset + landing.weights[k] * mesh_.texels[landed][k];
    return dot(offset, offset) < same_place * same_place;
  });
}

bool Connections::outwards(Index face, Point2 from, Point2 to) const {
  Touched touched(mesh_, face, from, to);
  if (touched.find([](Index) { return false; })) return true;
  if (touched.seams().empty()) return !touched.meets_open();
  return std::any_of(touched.seams().begin(), touched.seams().end(),
                     [&](Edge seam) { return Path(mesh_, seam, to).end() != End::open; });
}

}  // namespace beltrami::atlas
