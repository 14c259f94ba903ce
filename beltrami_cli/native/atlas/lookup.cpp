#include "atlas/lookup.hpp"

#include <algorithm>
#include <cmath>

#include "atlas/connections.hpp"

namespace beltrami::atlas {
namespace {

// Tolerance above the rounding of single-precision coordinates and of unfolding, too small to change an interpolated
// value.
constexpr double on_centre = 1e-4;
// Faces smaller than a texel may have no texel around a point, but one nearby.
constexpr double farthest_substitute = 1.5;

double snapped(double x) {
  const double nearest = std::nearbyint(x);
  return std::abs(x - nearest) <= on_centre ? nearest : x;
}

class Lookup {
 public:
  Lookup(const Blueprint& plan, Index face, Point2 place)
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
    return plan_.ownership.overlapping[static_cast<std::size_t>(plan_.charts.chart_of[static_cast<std::size_t>(face_)])] != 0 &&
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

  const Blueprint& plan_;
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

Point3 position_of(const Mesh& mesh, const Landing& landing) {
  Point3 position;
  for (std::size_t k = 0; k < 3; ++k)
    position = position + landing.weights[k] * mesh.corner(static_cast<std::size_t>(landing.face), k);
  return position;
}

std::optional<Sample> look_up(const Blueprint& plan, const Landing& landing) {
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

std::optional<Sample> stand_in(const Blueprint& plan, Index face, std::int64_t x, std::int64_t y, Point3 position) {
  const Texture& grid = plan.mesh.grid(static_cast<std::size_t>(face));
  const auto texel = grid.texel(wrapped(x, grid.width, grid.wrap_x), wrapped(y, grid.height, grid.wrap_y));
  if (plan.ownership.window[static_cast<std::size_t>(texel)] == none) return std::nullopt;
  const auto cell = static_cast<Index>(plan.cell_of(texel, grid));
  return Sample{{cell, cell, cell, cell}, {1, 0, 0, 0}, position, plan.near_borders.is_near_open(texel)};
}

}  // namespace beltrami::atlas
