#include "grid/window_sweep.hpp"

#include <algorithm>
#include <limits>
#include <numeric>
#include <vector>

#include "grid/sweep_tile.hpp"
#include "instruction_set.hpp"

namespace beltrami::grid {
namespace {

std::vector<Tile> cut_into_tiles(const Grid& grid) {
  std::vector<Tile> tiles;
  // A band of a canvas has rows without owned cells above, and its own rows are whole tiles.
  const std::uint8_t* first = std::find(grid.kind, grid.kind + grid.cells(), owned);
  const std::size_t top = static_cast<std::size_t>(first - grid.kind) / std::max<std::size_t>(1, grid.columns);
  for (std::size_t row = top; row < grid.rows; row += tile_rows)
    for (std::size_t column = 0; column < grid.columns; column += tile_columns) {
      const Tile tile{row, column, std::min(tile_rows, grid.rows - row), std::min(tile_columns, grid.columns - column)};
      bool used = false;
      for (std::size_t y = row; y < row + tile.rows && !used; ++y) {
        const std::uint8_t* kind = grid.kind + y * grid.columns + column;
        used = std::find(kind, kind + tile.columns, owned) != kind + tile.columns;
      }
      if (used) tiles.push_back(tile);
    }
  return tiles;
}

int squared_length(Offset offset) { return offset.x * offset.x + offset.y * offset.y; }

std::vector<Offset> rings_of_window(int radius) {
  std::vector<Offset> offsets;
  for (int y = -radius; y <= radius; ++y)
    for (int x = -radius; x <= radius; ++x)
      if (x != 0 || y != 0) offsets.push_back({x, y});
  std::stable_sort(offsets.begin(), offsets.end(),
                   [](Offset a, Offset b) { return squared_length(a) < squared_length(b); });
  return offsets;
}

template <class Usable>
Target make_target(int radius, Offset offset, Usable usable) {
  const auto slot = [&](Offset at) { return (at.y + radius) * (2 * radius + 1) + at.x + radius; };
  Target target{slot(offset), offset, {}, {}};
  for (const Offset step : neighbours)
    if (usable(offset + step)) {
      const auto [plane, cell] = edge_place(offset, step);
      target.edges.push_back({slot(offset + step), plane, cell});
    }
  for (std::size_t i = 0; i < stencil_classes.size(); ++i) {
    const Offset axis = offset + stencil_classes[i].axis, diagonal = offset + stencil_classes[i].diagonal;
    if (usable(axis) && usable(diagonal)) target.triangles.push_back({slot(axis), slot(diagonal), i});
  }
  return target;
}

}  // namespace

void copy_planes(const Planes& planes, std::size_t cells, float* const* copies, unsigned threads) {
  constexpr std::size_t at_once = 1 << 15;
  parallel_chunks(cells, at_once, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    for (std::size_t channel = 0; channel < planes.channels; ++channel)
      std::copy(planes[channel] + begin, planes[channel] + end, copies[channel] + begin);
  });
}

WindowProgram make_window_program(int radius) {
  WindowProgram program{radius, {}};
  for (const Offset offset : rings_of_window(radius)) {
    const auto nearer = [&](Offset other) { return squared_length(other) < squared_length(offset); };
    program.targets.push_back(make_target(radius, offset, nearer));
  }
  return program;
}

std::int64_t smooth_by_sweeps(const Grid& grid, Planes metric, Planes colours, const SweepParameters& parameters,
                              const WindowProgram& program, float* smoothed, unsigned threads, const Poll& poll) {
  copy_planes(colours, grid.cells(), planes_of(smoothed, grid, colours.channels).data(), threads);
  const auto tiles = cut_into_tiles(grid);
  const auto sweep = BELTRAMI_VARIANT_OF(sweep_tile, choose_instruction_set());
  const TileJob job{&grid, metric, colours, &parameters, &program, smoothed};
  std::vector<TileScratch> scratch(std::max(1U, threads));
  std::vector<std::int64_t> samples(tiles.size());
  parallel_chunks(
      tiles.size(), 1, threads,
      [&](std::size_t begin, std::size_t end, unsigned worker) {
        for (std::size_t i = begin; i < end; ++i) samples[i] = sweep(job, tiles[i], scratch[worker]);
      },
      poll ? Poll([&](std::size_t done) { return poll(done * grid.cells() / tiles.size()); }) : Poll());
  return std::accumulate(samples.begin(), samples.end(), std::int64_t{0});
}

void distances_by_sweeps(const Grid& grid, Planes metric, const SweepParameters& parameters, const WindowProgram& program,
                         std::size_t cell, float* distances) {
  const std::size_t side = 2 * static_cast<std::size_t>(program.radius) + 1;
  TileScratch scratch;
  const TileJob job{&grid, metric, {nullptr, 0}, &parameters, &program, nullptr, distances};
  BELTRAMI_VARIANT_OF(sweep_tile, choose_instruction_set())(job, {cell / grid.columns, cell % grid.columns, 1, 1}, scratch);
  const float reach = std::min(parameters.radius, longest_radius);
  std::replace_if(distances, distances + side * side, [&](float distance) { return !(distance <= reach); },
                  std::numeric_limits<float>::infinity());
}

}  // namespace beltrami::grid
