// The order in which the cells of a window are updated, laid out for the planes of one tile.
// For the translation units of sweep_tile.cpp: whatever is here is compiled for one instruction set.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "parametric/lanes.hpp"
#include "parametric/tile_planes.hpp"
#include "parametric/window_program.hpp"

namespace beltrami::parametric::BELTRAMI_VARIANT {

// A list of targets with places in the window and in the planes of a tile in place of slots and cells: these are the
// same for all centres, which are so many that working them out anew would take as long as the updates.
class Course {
 public:
  Course(const std::vector<Target>& targets, const Layout& layout) {
    const auto place = [](int slot) { return slot * static_cast<std::ptrdiff_t>(centre_count); };
    const auto plane = [&](std::size_t index) { return static_cast<std::ptrdiff_t>(index * layout.size); };
    for (const Target& target : targets) {
      for (const EdgeStep& edge : target.edges)
        edges_.push_back({place(edge.from), plane(edge.plane) + layout.at(edge.cell)});
      for (const TriangleStep& triangle : target.triangles)
        triangles_.push_back({place(triangle.axis), place(triangle.diagonal),
                              plane(3 * triangle.stencil_class) + layout.at(target.offset)});
      stops_.push_back({place(target.slot), edges_.size(), triangles_.size()});
    }
    height_ = plane(1);
    n_ = plane(2);
  }

  // Updates the window of the centres at which the pointers into the planes stand.
  void run(const float* lengths, const float* coefficients, float* window) const {
    const Edge* edge = edges_.data();
    const Triangle* triangle = triangles_.data();
    for (const Stop& stop : stops_) {
      std::array<Lanes, register_count> best;
      for (std::size_t r = 0; r < register_count; ++r) best[r] = load(window + stop.slot + r * lane_count);
      for (const Edge* end = edges_.data() + stop.edges; edge != end; ++edge)
        for (std::size_t r = 0; r < register_count; ++r) {
          const std::size_t lane = r * lane_count;
          best[r] = smaller(load(window + edge->from + lane) + load(lengths + edge->length + lane), best[r]);
        }
      for (const Triangle* end = triangles_.data() + stop.triangles; triangle != end; ++triangle)
        for (std::size_t r = 0; r < register_count; ++r)
          best[r] = through(*triangle, coefficients + r * lane_count, window + r * lane_count, best[r]);
      for (std::size_t r = 0; r < register_count; ++r) store(window + stop.slot + r * lane_count, best[r]);
    }
  }

 private:
  struct Edge {
    std::ptrdiff_t from, length;
  };
  struct Triangle {
    std::ptrdiff_t axis, diagonal, coefficients;
  };
  struct Stop {
    std::ptrdiff_t slot;
    std::size_t edges, triangles;  // up to which
  };

  // The distance through a triangle, or the best so far if the way does not come out of it or is longer.
  Lanes through(const Triangle& triangle, const float* coefficients, const float* window, Lanes best) const {
    const float* k_plane = coefficients + triangle.coefficients;
    const Lanes axis = load(window + triangle.axis);
    const Lanes u = load(window + triangle.diagonal) - axis;
    const Lanes k = load(k_plane), nu = load(k_plane + n_) * u;
    const Lanes radicand = load(k_plane + height_) - nu * u;
    const Lanes s = square_root(larger(radicand, Lanes{}));
    const Mask from_within = (k * s > nu) & (k * s - s < nu);
    return select(from_within, smaller(axis + k * u + s, best), best);
  }

  std::vector<Edge> edges_;
  std::vector<Triangle> triangles_;
  std::vector<Stop> stops_;
  std::ptrdiff_t height_ = 0, n_ = 0;
};

}  // namespace beltrami::parametric::BELTRAMI_VARIANT
