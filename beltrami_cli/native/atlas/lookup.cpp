#include "atlas/lookup.hpp"

#include <algorithm>
#include <cmath>
#include <span>

namespace beltrami::atlas {
namespace {

// Tolerance of contact: the precision of a single-precision coordinate near 1 of a texture of 1,024 texels.
constexpr double touching = 1e-4;
// Maximum number of faces between neighbouring cells; beyond it they count as joined.
constexpr std::size_t most_faces = 256, most_seams = 16;
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
  const Point2 way = to - from, edge = b - a;
  return !is_clear(from, way, std::sqrt(dot(way, way)), a, b) && !is_clear(a, edge, std::sqrt(dot(edge, edge)), from, to);
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

// Tolerance above the rounding of single-precision coordinates and of unfolding, too small to change an interpolated
// value.
constexpr double on_centre = 1e-4;
// Faces smaller than a texel may have no texel around a point, but one nearby.
constexpr double farthest_substitute = 1.5;
constexpr int longest_search = 64;

double snapped(double x) {
  const double nearest = std::nearbyint(x);
  return std::abs(x - nearest) <= on_centre ? nearest : x;
}

class Lookup {
 public:
  Lookup(const Plan& plan, Index face, Point2 place)
      : plan_(plan), face_(face), place_(place), grid_(plan.mesh.grid(static_cast<std::size_t>(face))),
        is_flat_(doubled_area(plan.mesh.texels[static_cast<std::size_t>(face)]) == 0) {}

  std::int64_t texel(double x, double y) const {
    return grid_.texel(wrapped(static_cast<std::int64_t>(x), grid_.width, grid_.wrap_x),
                       wrapped(static_cast<std::int64_t>(y), grid_.height, grid_.wrap_y));
  }

  bool is_of_owners_chart(std::int64_t texel) const {
    const Index window = plan_.ownership.window[static_cast<std::size_t>(texel)];
    return window != none && plan_.windows.windows[static_cast<std::size_t>(window)].chart ==
                                 plan_.charts.chart_of[static_cast<std::size_t>(face_)];
  }

  // Whether the texel shows this part of the surface: it belongs to the chart, or to one that overlaps the chart, and
  // the chart does not end before it.
  bool is_ours(std::int64_t texel, double x, double y) const {
    if (plan_.ownership.window[static_cast<std::size_t>(texel)] == none) return false;
    if (is_flat_) return true;
    if (is_of_owners_chart(texel)) return is_joined(texel, x, y);
    return plan_.ownership.loser[static_cast<std::size_t>(plan_.charts.chart_of[static_cast<std::size_t>(face_)])] != 0 &&
           is_covered(plan_.mesh, face_, {x, y});
  }

  bool is_joined(std::int64_t texel, double x, double y) const {
    const Index owner = plan_.ownership.face[static_cast<std::size_t>(texel)];
    if (owner == face_ || plan_.near_borders.nearness(texel) == 0) return true;
    const Index there = is_owned_here(texel, x, y) ? owner : none;
    return Connections(plan_.mesh, plan_.charts).inside(face_, place_, there, {x, y});
  }

  void add(double x, double y, double weight) {
    if (!(weight > 0)) return;
    const auto number = texel(x, y);
    near_open_ = near_open_ || plan_.near_borders.is_near_open(number);
    if (!is_ours(number, x, y)) return;
    cells_[count_] = cell(number);
    weights_[count_++] = weight;
    sum_ += weight;
  }

  void add_nearest() {
    double least = farthest_substitute * farthest_substitute;
    std::int64_t found = -1;
    const double left = std::floor(place_.x), top = std::floor(place_.y);
    for (double y = top - 1; y <= top + 2; ++y)
      for (double x = left - 1; x <= left + 2; ++x) {
        const Point2 offset = Point2{x, y} - place_;
        if (!(dot(offset, offset) < least) || !is_ours(texel(x, y), x, y)) continue;
        least = dot(offset, offset);
        found = texel(x, y);
      }
    if (found < 0) return;
    cells_[count_] = cell(found);
    weights_[count_++] = sum_ = 1;
  }

  std::optional<Sample> sample(Point3 position) const {
    if (count_ == 0) return std::nullopt;
    Sample result{{}, {}, position, near_open_};
    for (std::size_t i = 0; i < 4; ++i) {
      result.cells[i] = cells_[i < count_ ? i : 0];
      result.weights[i] = i < count_ ? static_cast<float>(weights_[i] / sum_) : 0;
    }
    return result;
  }

  // Whether the owner of a texel has it at this point of the chart's plane, not in another period.
  bool is_owned_here(std::int64_t texel, double x, double y) const {
    if (!is_of_owners_chart(texel)) return false;
    const Point2 place = plan_.owned_place(texel, grid_);
    return place.x == x && place.y == y;
  }

  // The position on the surface of a texel's owner.
  Point3 owners_position(std::int64_t texel) const {
    const FaceMap map(plan_.mesh, plan_.ownership.face[static_cast<std::size_t>(texel)]);
    return map.inside(plan_.owned_place(texel, grid_));
  }

 private:
  Index cell(std::int64_t texel) const { return static_cast<Index>(plan_.cell_of(texel, grid_)); }

  const Plan& plan_;
  Index face_;
  Point2 place_;
  const Texture& grid_;
  bool is_flat_;  // without area in the image
  std::array<Index, 4> cells_{};
  std::array<double, 4> weights_{};
  std::size_t count_ = 0;
  double sum_ = 0;
  bool near_open_ = false;
};

}  // namespace

bool is_covered(const Mesh& mesh, Index start, Point2 place) {
  auto face = static_cast<std::size_t>(start);
  Edge entry = none;
  for (int step = 0; step < longest_search; ++step) {
    const auto& corners = mesh.texels[face];
    const double orientation = doubled_area(corners) < 0 ? -1 : 1;
    double farthest = on_centre;
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
    const Way way(mesh_, seam, to);
    if (way.end() != End::landed) return false;
    const Landing landing = way.landing();
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
                     [&](Edge seam) { return Way(mesh_, seam, to).end() != End::open; });
}

Point3 position_of(const Mesh& mesh, const Landing& landing) {
  Point3 position;
  for (std::size_t k = 0; k < 3; ++k)
    position = position + landing.weights[k] * mesh.corner(static_cast<std::size_t>(landing.face), k);
  return position;
}

std::optional<Sample> look_up(const Plan& plan, const Landing& landing) {
  const auto face = static_cast<std::size_t>(landing.face);
  Point2 place;
  for (std::size_t k = 0; k < 3; ++k) place = place + landing.weights[k] * plan.mesh.texels[face][k];
  Point3 position = position_of(plan.mesh, landing);
  place = {snapped(place.x), snapped(place.y)};
  Lookup lookup(plan, landing.face, place);
  const double x = std::floor(place.x), y = std::floor(place.y), u = place.x - x, v = place.y - y;
  if (u == 0 && v == 0 && lookup.is_owned_here(lookup.texel(x, y), x, y))
    position = lookup.owners_position(lookup.texel(x, y));  // one sample, one position
  lookup.add(x, y, (1 - u) * (1 - v));
  lookup.add(x + 1, y, u * (1 - v));
  lookup.add(x, y + 1, (1 - u) * v);
  lookup.add(x + 1, y + 1, u * v);
  auto sample = lookup.sample(position);
  if (sample) return sample;
  lookup.add_nearest();
  return lookup.sample(position);
}

std::optional<Sample> stand_in(const Plan& plan, Index face, std::int64_t x, std::int64_t y, Point3 position) {
  const Texture& grid = plan.mesh.grid(static_cast<std::size_t>(face));
  const auto texel = grid.texel(wrapped(x, grid.width, grid.wrap_x), wrapped(y, grid.height, grid.wrap_y));
  if (plan.ownership.window[static_cast<std::size_t>(texel)] == none) return std::nullopt;
  const auto cell = static_cast<Index>(plan.cell_of(texel, grid));
  return Sample{{cell, cell, cell, cell}, {1, 0, 0, 0}, position, plan.near_borders.is_near_open(texel)};
}

}  // namespace beltrami::atlas
