// The planes of a tile and its border: lengths of edges, and coefficients of stencils.
// For the translation units of sweep_tile.cpp: whatever is here is compiled for one instruction set.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "parametric/lanes.hpp"
#include "parametric/stencil_classes.hpp"
#include "parametric/sweep_tile.hpp"

namespace beltrami::parametric::BELTRAMI_VARIANT {

// Planes of the tile and its border: lengths of the four edges, then three coefficients for each stencil class.
constexpr std::size_t coefficient_planes = 3 * stencil_classes.size();
constexpr std::size_t plane_count = 2 * direction_count + coefficient_planes;

// Two registers of centres go through the same operations by turns, so that neither waits for its square roots.
constexpr std::size_t register_count = 2, centre_count = register_count * lane_count;

struct Layout {
  Layout(const Tile& tile, int window_radius)
      : border(static_cast<std::size_t>(window_radius) + 1),
        rows(tile.rows + 2 * border),
        // Whole blocks of centres, and room for the loads of the last lanes.
        columns(((tile.columns + centre_count - 1) / centre_count) * centre_count + 2 * border),
        size(rows * columns + lane_count) {}
  std::size_t border, rows, columns, size;
  std::ptrdiff_t at(Offset offset) const { return offset.y * static_cast<std::ptrdiff_t>(columns) + offset.x; }
};

// Copies a plane of the grid to the tile and its border, each value converted; `fill` stands outside the grid.
template <class T, class Convert>
void copy_plane(const Grid& grid, const T* plane, const Tile& tile, const Layout& layout, float fill, float* out,
                Convert convert) {
  std::fill(out, out + layout.size, fill);
  // The grid's rectangle in the tile's planes.
  const auto first = [&](std::size_t begin) { return begin < layout.border ? layout.border - begin : 0; };
  const std::size_t left = first(tile.column), top = first(tile.row);
  const std::size_t right_end = std::min(layout.columns, grid.columns + layout.border - tile.column);
  const std::size_t bottom = std::min(layout.rows, grid.rows + layout.border - tile.row);
  for (std::size_t y = top; y < bottom; ++y) {
    const T* row = plane + (tile.row + y - layout.border) * grid.columns + (tile.column + left - layout.border);
    std::transform(row, row + (right_end - left), out + y * layout.columns + left, convert);
  }
}

inline void copy_plane(const Grid& grid, const float* plane, const Tile& tile, const Layout& layout, float fill,
                       float* out) {
  copy_plane(grid, plane, tile, layout, fill, out, [](float value) { return value; });
}

inline void copy_planes(const Grid& grid, Planes planes, const Tile& tile, const Layout& layout, float* out) {
  for (std::size_t channel = 0; channel < planes.channels; ++channel)
    copy_plane(grid, planes.data + channel * grid.cells(), tile, layout, 0, out + channel * layout.size);
}

// |dX|^2 + beta^2 |dI|^2 of every edge in the tile and its border; no_edge where there is none.
inline void measure_edges(const TileJob& job, const Tile& tile, const Layout& layout, const float* metric,
                   const float* scale, float* blocked, float* squared, float* lengths) {
  const Grid& grid = *job.grid;
  const float squared_beta = job.parameters->beta * job.parameters->beta;
  copy_plane(grid, grid.kind, tile, layout, no_edge, blocked,
             [](std::uint8_t kind) { return kind == empty ? no_edge : 0.0F; });
  const std::array<std::size_t, direction_count> steps{1, layout.columns, layout.columns + 1, layout.columns - 1};
  for (std::size_t direction = 0; direction < direction_count; ++direction) {
    float* __restrict total = squared + direction * layout.size;
    copy_plane(grid, grid.squared_lengths + direction * grid.cells(), tile, layout, no_edge, total);
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

inline void make_class(const Layout& layout, const float* squared, const StencilClass& stencil, float* out) {
  const auto plane = [&](EdgePlace place) { return squared + place.plane * layout.size + layout.at(place.cell); };
  const float* to_diagonal = plane(edge_place({0, 0}, stencil.diagonal));
  const float* to_axis = plane(edge_place({0, 0}, stencil.axis));
  const float* between = plane(edge_place(stencil.axis, stencil.diagonal - stencil.axis));
  const Lanes none = splat(0), missing = splat(no_edge);
  // One cell in from every side, where all neighbours are at hand; further out no window reaches. The planes have room
  // for the lanes behind the last cell.
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

}  // namespace beltrami::parametric::BELTRAMI_VARIANT
