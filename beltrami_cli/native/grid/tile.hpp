// The planes of a tile and its border, with the lengths of edges and the coefficients of stencils; and the updates of a
// window's cells in these planes. Part of each variant of sweep_tile.cpp.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "grid/sweep_tile.hpp"
#include "lanes.hpp"

namespace beltrami::grid::BELTRAMI_VARIANT {

using namespace beltrami::lanes::BELTRAMI_VARIANT;

// Planes of the tile and its border: lengths of the four edges, then three coefficients for each stencil class.
constexpr std::size_t coefficient_planes = 3 * stencil_classes.size();
constexpr std::size_t plane_count = 2 * direction_count + coefficient_planes;

// Two registers of centres alternate, so that neither waits for its square roots.
constexpr std::size_t register_count = 2, centre_count = register_count * lane_count;

struct TileLayout {
  TileLayout(const Tile& tile, int window_radius)
      : border(static_cast<std::size_t>(window_radius) + 1),
        rows(tile.rows + 2 * border),
        // Whole blocks of centres, and spare cells for the loads of the last lanes.
        columns(((tile.columns + centre_count - 1) / centre_count) * centre_count + 2 * border),
        size(rows * columns + lane_count) {}
  std::size_t border, rows, columns, size;
  std::ptrdiff_t at(Offset offset) const { return offset.y * static_cast<std::ptrdiff_t>(columns) + offset.x; }
};

// Copies a plane of the grid to the tile and its border, converting each value; `fill` is the value outside the grid.
template <class T, class Convert>
void copy_to_tile(const Grid& grid, const T* plane, const Tile& tile, const TileLayout& layout, float fill, float* out,
                Convert convert) {
  std::fill(out, out + layout.size, fill);
  // Rectangle of the grid in the tile's planes.
  const auto first = [&](std::size_t begin) { return begin < layout.border ? layout.border - begin : 0; };
  const std::size_t left = first(tile.column), top = first(tile.row);
  const std::size_t right_end = std::min(layout.columns, grid.columns + layout.border - tile.column);
  const std::size_t bottom = std::min(layout.rows, grid.rows + layout.border - tile.row);
  for (std::size_t y = top; y < bottom; ++y) {
    const T* row = plane + (tile.row + y - layout.border) * grid.columns + (tile.column + left - layout.border);
    std::transform(row, row + (right_end - left), out + y * layout.columns + left, convert);
  }
}

inline void copy_to_tile(const Grid& grid, const float* plane, const Tile& tile, const TileLayout& layout, float fill,
                       float* out) {
  copy_to_tile(grid, plane, tile, layout, fill, out, [](float value) { return value; });
}

inline void copy_to_tile(const Grid& grid, Planes planes, const Tile& tile, const TileLayout& layout, float* out) {
  for (std::size_t channel = 0; channel < planes.channels; ++channel)
    copy_to_tile(grid, planes[channel], tile, layout, 0, out + channel * layout.size);
}

// |dX|^2 + beta^2 |dI|^2 of every edge in the tile and its border; no_edge where there is none.
inline void measure_edges(const TileJob& job, const Tile& tile, const TileLayout& layout, const float* metric,
                   const float* scale, float* blocked, float* squared, float* lengths) {
  const Grid& grid = *job.grid;
  const float squared_beta = job.parameters->beta * job.parameters->beta;
  copy_to_tile(grid, grid.kind, tile, layout, no_edge, blocked,
             [](std::uint8_t kind) { return kind == empty ? no_edge : 0.0F; });
  const std::array<std::size_t, direction_count> steps{1, layout.columns, layout.columns + 1, layout.columns - 1};
  for (std::size_t direction = 0; direction < direction_count; ++direction) {
    float* __restrict total = squared + direction * layout.size;
    copy_to_tile(grid, grid.squared_lengths[direction], tile, layout, no_edge, total);
    if (scale != nullptr)
      for (std::size_t i = 0; i < layout.size; ++i) total[i] *= scale[i];
    const std::size_t last = layout.size - steps[direction];
    const float* __restrict blocked_there = blocked + steps[direction];
    for (std::size_t i = 0; i < last; ++i) total[i] += blocked[i] + blocked_there[i];
    for (std::size_t channel = 0; channel < job.metric.channels; ++channel) {
      const float* __restrict from = metric + channel * layout.size;
      const float* __restrict to = from + steps[direction];
      for (std::size_t i = 0; i < last; ++i) total[i] += squared_beta * ((to[i] - from[i]) * (to[i] - from[i]));
    }
    float* __restrict length = lengths + direction * layout.size;
    for (std::size_t i = 0; i < layout.size; ++i) {
      total[i] = total[i] < no_edge ? total[i] : no_edge;
      length[i] = std::sqrt(total[i]);
    }
  }
}

inline void make_class(const TileLayout& layout, const float* squared, const StencilClass& stencil, float* out) {
  const auto plane = [&](EdgePlace place) { return squared + place.plane * layout.size + layout.at(place.cell); };
  const float* to_diagonal = plane(edge_place({0, 0}, stencil.diagonal));
  const float* to_axis = plane(edge_place({0, 0}, stencil.axis));
  const float* between = plane(edge_place(stencil.axis, stencil.diagonal - stencil.axis));
  const Lanes none = splat(0), missing = splat(no_edge);
  // One cell inside every side, where all neighbours exist; windows do not reach further out. The planes have spare
  // cells for the lanes behind the last cell.
  const std::size_t first = layout.columns + 1, last = (layout.rows - 1) * layout.columns - 1;
  for (std::size_t i = first; i < last; i += lane_count) {
    const Lanes a = load(to_diagonal + i), b = load(to_axis + i), c = load(between + i);
    const Lanes inverse = 1.0F / c;
    const Lanes slope = (b + c - a) * 0.5F * inverse;
    const Lanes squared_height = b - slope * slope * c;
    const Mask usable =
        (a + b >= c) & (a < missing) & (b < missing) & (c < missing) & (c > none) & (squared_height > none);
    store(out + i, select(usable, slope, none));
    store(out + layout.size + i, select(usable, squared_height, none));
    store(out + 2 * layout.size + i, select(usable, squared_height * inverse, none));
  }
}

// Targets with offsets in the window and in the planes of a tile, instead of slots and cells. They are the same for all
// centres; computing them per centre would take as long as the updates.
class Course {
 public:
  Course(const std::vector<Target>& targets, const TileLayout& layout) {
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

  // Updates the window of the centres to which the pointers into the planes point.
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

  // The distance through a triangle, or the previous one if the path does not come from it or is longer.
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

}  // namespace beltrami::grid::BELTRAMI_VARIANT
