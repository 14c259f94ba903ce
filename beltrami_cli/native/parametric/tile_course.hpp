// The order in which the cells of a window are updated, laid out for the planes of one tile.
// For the translation units of sweep_tile.cpp: whatever is here is compiled for one instruction set.
#pragma once

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
    const auto place = [](int slot) { return slot * static_cast<std::ptrdiff_t>(lane_count); };
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
      Lanes best = load(window + stop.slot);
      for (const Edge* end = edges_.data() + stop.edges; edge != end; ++edge)
        best = smaller(load(window + edge->from) + load(lengths + edge->length), best);
      for (const Triangle* end = triangles_.data() + stop.triangles; triangle != end; ++triangle) {
        const float* k_plane = coefficients + triangle->coefficients;
        const Lanes axis = load(window + triangle->axis);
        const Lanes u = load(window + triangle->diagonal) - axis;
        const Lanes k = load(k_plane), nu = load(k_plane + n_) * u;
        const Lanes radicand = load(k_plane + height_) - nu * u;
        const Lanes s = square_root(larger(radicand, Lanes{}));
        const Lanes through = axis + k * u + s;
        const Mask from_within = (k * s > nu) & (k * s - s < nu);
        best = select(from_within, smaller(through, best), best);
      }
      store(window + stop.slot, best);
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
  std::vector<Edge> edges_;
  std::vector<Triangle> triangles_;
  std::vector<Stop> stops_;
  std::ptrdiff_t height_ = 0, n_ = 0;
};

}  // namespace beltrami::parametric::BELTRAMI_VARIANT
