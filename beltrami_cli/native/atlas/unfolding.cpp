#include "atlas/unfolding.hpp"

#include <algorithm>
#include <cmath>

namespace beltrami::atlas {
namespace {

// Maximum number of faces: a halo is a few texels wide, and only fans of slivers need more.
constexpr int longest_walk = 64;
// Tolerance within which a point on an edge belongs to the face before it, so that it does not fall off an open edge.
constexpr double relative_rounding = 1e-9;
// Relative difference of steps across an edge; smaller ones are due to the curvature of the surface.
constexpr double contradiction = 0.5;
// Edge k of an unfolded face leads from corner k to the next; the path enters over the last edge.
constexpr std::size_t entry = 2, no_edge = 3;

struct Base {
  Point2 a, b;  // an edge in the plane; what comes next lies on its left
};

// Apex over the edge from a to b in space, in units of the edge: foot and height.
struct Apex {
  double foot, height;
};

Apex apex_of(Point3 a, Point3 b, Point3 c) {
  const Point3 base = b - a, side = c - a, normal = cross(base, side);
  const double squared = dot(base, base);
  return {dot(side, base) / squared, std::sqrt(dot(normal, normal)) / squared};
}

Point2 raise(Base base, Apex apex) {
  const Point2 along = base.b - base.a;
  return base.a + apex.foot * along + apex.height * Point2{-along.y, along.x};
}

double left_of(Point2 from, Point2 to, Point2 point) { return cross(to - from, point - from); }

bool is_beyond(Base edge, Point2 point, double reach) {
  const Point2 along = edge.b - edge.a;
  const double length = std::sqrt(dot(along, along));
  return left_of(edge.a, edge.b, point) > relative_rounding * length * (length + reach);
}

// Code in the mesh of edge k of an unfolded face, which may have the opposite direction there.
Edge edge_of(const UnfoldedFace& unfolded, std::size_t k) {
  const std::size_t from = unfolded.corner[k], to = unfolded.corner[next(k)];
  return static_cast<Edge>(3 * static_cast<std::size_t>(unfolded.face) + (next(from) == to ? from : to));
}

// Unfolds the face beyond an edge, which leads from `place` at base.a to base.b.
End enter(const Mesh& mesh, Edge edge, Base base, Index place, UnfoldedFace& unfolded) {
  const Edge twin = mesh.twins[static_cast<std::size_t>(edge)];
  if (twin == none) return End::open;
  const auto face = static_cast<std::size_t>(twin / 3), j = static_cast<std::size_t>(twin % 3);
  const bool along = mesh.places[face][j] == place;
  const std::size_t ka = along ? j : next(j), kb = along ? next(j) : j, kd = next(next(j));
  const Point2 apex = raise(base, apex_of(mesh.corner(face, ka), mesh.corner(face, kb), mesh.corner(face, kd)));
  unfolded = {static_cast<Index>(face),
          {static_cast<std::uint8_t>(ka), static_cast<std::uint8_t>(kd), static_cast<std::uint8_t>(kb)},
          {base.a, apex, base.b}};
  return End::landed;
}

// The edge, other than the entry, over which a line leaves a face for a point outside; no_edge for a point inside.
std::size_t exit_of(const UnfoldedFace& unfolded, std::size_t entered, Point2 from, Point2 to, double reach) {
  std::size_t found = no_edge;
  for (std::size_t k = 0; k < 3; ++k) {
    if (k == entered || !is_beyond({unfolded.at[k], unfolded.at[next(k)]}, to, reach)) continue;
    // If the point is beyond two edges, the line passes their common corner on one side or the other.
    const bool corner_is_between = found + 1 == k;
    if (found == no_edge || (left_of(from, to, unfolded.at[corner_is_between ? k : 0]) > 0) == corner_is_between) found = k;
  }
  return found;
}

End follow(const Mesh& mesh, Point2 from, Point2 to, std::size_t entered, UnfoldedFace& unfolded) {
  const double reach = std::sqrt(dot(to - from, to - from));
  for (int step = 0; step < longest_walk; ++step) {
    const std::size_t k = exit_of(unfolded, entered, from, to, reach);
    if (k == no_edge) return End::landed;
    const Index place = mesh.places[static_cast<std::size_t>(unfolded.face)][unfolded.corner[k]];
    const Base base{unfolded.at[k], unfolded.at[next(k)]};
    if (const End end = enter(mesh, edge_of(unfolded, k), base, place, unfolded); end != End::landed) return end;
    entered = entry;
  }
  return End::lost;
}

}  // namespace

Plane::Plane(const Mesh& mesh, Edge edge) {
  const auto face = static_cast<std::size_t>(edge / 3), k = static_cast<std::size_t>(edge % 3);
  const auto& texels = mesh.texels[face];
  origin_ = texels[k];
  along_ = texels[next(k)] - origin_;
  side_ = texels[next(next(k))] - origin_;
  area_ = cross(along_, side_);
  const Point3 a = mesh.corner(face, k), b = mesh.corner(face, next(k));
  edge_ = b - a;
  length_ = std::sqrt(dot(edge_, edge_));
  if (!is_flat()) return;
  const Apex apex = apex_of(a, b, mesh.corner(face, next(next(k))));
  foot_ = apex.foot;
  height_ = apex.height;
}

double Plane::thickness() const {
  const Point2 third = side_ - along_;
  return std::abs(area_) / std::sqrt(std::max({dot(along_, along_), dot(side_, side_), dot(third, third)}));
}

Point2 Plane::across() const {
  const double length = std::sqrt(dot(along_, along_)), side = area_ < 0 ? 1 : -1;
  return {-along_.y * side / length, along_.x * side / length};
}

void Plane::correct(Point3 right, Point3 down) {
  const Point2 out = across();
  const Point3 step = out.x * right + out.y * down, x = (1 / length_) * edge_, aside = step - dot(step, x) * x;
  const double height = std::sqrt(dot(aside, aside));
  if (!(height > 0)) return;
  const Point3 y = (1 / height) * aside;
  const Point2 measured{dot(step, x), height}, own = at(origin_ + out), difference = own - measured;
  if (dot(difference, difference) <= contradiction * contradiction * dot(measured, measured)) return;
  right_ = {dot(right, x), dot(right, y)};
  down_ = {dot(down, x), dot(down, y)};
  corrected_ = true;
}

Point2 Plane::at(Point2 place) const {
  const Point2 offset = place - origin_;
  if (corrected_) {
    const Point2 from = nearest(place), beyond = offset - (from.x / length_) * along_;
    return from + beyond.x * right_ + beyond.y * down_;
  }
  const double beta = cross(offset, side_) / area_, gamma = cross(along_, offset) / area_;
  return {(beta + gamma * foot_) * length_, -gamma * height_ * length_};
}

Point2 Plane::nearest(Point2 place) const {
  return {std::clamp(dot(place - origin_, along_) / dot(along_, along_), 0.0, 1.0) * length_, 0};
}

Path::Path(const Mesh& mesh, Edge edge, const Plane& plane, Point2 place) : plane_(plane), end_(End::lost) {
  if (!plane_.is_flat()) return;
  from_ = plane_.nearest(place);
  to_ = plane_.at(place);
  const Index first = mesh.places[static_cast<std::size_t>(edge / 3)][static_cast<std::size_t>(edge % 3)];
  end_ = enter(mesh, edge, {{0, 0}, {plane_.length(), 0}}, first, face_);
  if (end_ == End::landed) end_ = follow(mesh, from_, to_, entry, face_);
}

Landing Path::landing() const {
  std::array<double, 3> weights;
  double sum = 0;
  for (std::size_t k = 0; k < 3; ++k)
    sum += weights[k] = std::max(-left_of(face_.at[next(k)], face_.at[next(next(k))], to_), 0.0);
  Landing landing{face_.face, {}};
  if (sum > 0) {
    for (std::size_t k = 0; k < 3; ++k) landing.weights[face_.corner[k]] = weights[k] / sum;
    return landing;
  }
  // A degenerate face: a point of the edge over which the path entered.
  const Point2 a = face_.at[next(entry)], along = face_.at[entry] - a;
  const double t = std::clamp(dot(to_ - a, along) / dot(along, along), 0.0, 1.0);
  landing.weights[face_.corner[next(entry)]] = 1 - t;
  landing.weights[face_.corner[entry]] = t;
  return landing;
}

End Path::continued(const Mesh& mesh, Point2 place) const {
  UnfoldedFace unfolded = face_;
  return follow(mesh, to_, plane_.at(place), no_edge, unfolded);
}

}  // namespace beltrami::atlas
