#include "atlas/unfolding.hpp"

#include <algorithm>
#include <cmath>

namespace beltrami::atlas {
namespace {

// A halo is a few texels wide; only fans of slivers need more faces than this.
constexpr int longest_walk = 64;
// What lies on an edge but for rounding belongs to the face before it: it must not fall off an open edge.
constexpr double rounding = 1e-9;

struct Base {
  Point2 a, b;  // an edge in the plane; what comes next lies on its left
};

// The apex over the edge from a to b in space, in units of the edge: its foot and its height.
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
  return left_of(edge.a, edge.b, point) > rounding * length * (length + reach);
}

// Weights of a, b and the apex.
std::array<double, 3> weights_in(Base base, Point2 apex, Point2 point) {
  std::array<double, 3> weights{left_of(base.b, apex, point), left_of(apex, base.a, point),
                                left_of(base.a, base.b, point)};
  for (double& weight : weights) weight = std::max(weight, 0.0);
  const double sum = weights[0] + weights[1] + weights[2];
  if (sum > 0) return {weights[0] / sum, weights[1] / sum, weights[2] / sum};
  const Point2 along = base.b - base.a;
  const double t = std::clamp(dot(point - base.a, along) / dot(along, along), 0.0, 1.0);
  return {1 - t, t, 0};
}

struct Start {
  Base base;
  Point2 from, to;
};

// The face's own plane: the edge along the x axis, the face below it, the place above.
std::optional<Start> start_at(const Mesh& mesh, std::size_t face, std::size_t k, Point2 place) {
  const auto& texels = mesh.texels[face];
  const Point2 along = texels[next(k)] - texels[k], side = texels[next(next(k))] - texels[k], offset = place - texels[k];
  const double area = cross(along, side);
  if (area == 0) return std::nullopt;
  const Point3 a = mesh.corner(face, k), b = mesh.corner(face, next(k));
  const double length = std::sqrt(dot(b - a, b - a));
  if (!(length > 0)) return std::nullopt;
  const Apex apex = apex_of(a, b, mesh.corner(face, next(next(k))));
  const double t = std::clamp(dot(offset, along) / dot(along, along), 0.0, 1.0);
  const double beta = cross(offset, side) / area, gamma = cross(along, offset) / area;
  return Start{{{0, 0}, {length, 0}},
               {t * length, 0},
               {(beta + gamma * apex.foot) * length, -gamma * apex.height * length}};
}

}  // namespace

std::optional<Landing> unfold(const Mesh& mesh, Edge edge, Point2 place) {
  const auto first = static_cast<std::size_t>(edge / 3);
  const auto start = start_at(mesh, first, static_cast<std::size_t>(edge % 3), place);
  if (!start) return std::nullopt;
  Base base = start->base;
  Index place_a = mesh.places[first][static_cast<std::size_t>(edge % 3)];
  const Point2 ray = start->to - start->from;
  const double reach = std::sqrt(dot(ray, ray));
  Edge crossed = edge;
  for (int step = 0; step < longest_walk; ++step) {
    const Edge twin = mesh.twins[static_cast<std::size_t>(crossed)];
    if (twin == none) return std::nullopt;
    const auto face = static_cast<std::size_t>(twin / 3), j = static_cast<std::size_t>(twin % 3);
    const bool along = mesh.places[face][j] == place_a;
    const std::size_t ka = along ? j : next(j), kb = along ? next(j) : j, kd = next(next(j));
    const Point2 apex = raise(base, apex_of(mesh.corner(face, ka), mesh.corner(face, kb), mesh.corner(face, kd)));
    // The straight line leaves on the side of b if the apex is on its left. If it leads along the edge through the apex,
    // it may leave by the other one.
    const Base to_a{base.a, apex}, to_b{apex, base.b};
    bool by_b = left_of(start->from, start->to, apex) > 0;
    if (!is_beyond(by_b ? to_b : to_a, start->to, reach) && is_beyond(by_b ? to_a : to_b, start->to, reach)) by_b = !by_b;
    const Base exit = by_b ? to_b : to_a;
    if (!is_beyond(exit, start->to, reach)) {
      const auto weights = weights_in(base, apex, start->to);
      Landing landing{static_cast<Index>(face), {}};
      landing.weights[ka] = weights[0];
      landing.weights[kb] = weights[1];
      landing.weights[kd] = weights[2];
      return landing;
    }
    // Edge k leads from corner k to the next: of the two corners it joins, the one whose next is the other.
    const std::size_t from = by_b ? kd : ka, to = by_b ? kb : kd;
    crossed = static_cast<Edge>(3 * face + (next(from) == to ? from : to));
    place_a = mesh.places[face][from];
    base = exit;
  }
  return std::nullopt;
}

}  // namespace beltrami::atlas
