// The inner part of the window sweep, compiled once for each instruction set from the same source.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "grid/window_sweep.hpp"
#include "instruction_set.hpp"

namespace beltrami::grid {

// Rectangle of centres; the sweep also reads a border of the window's radius.
struct Tile {
  std::size_t row, column, rows, columns;
};

struct TileJob {
  const Grid* grid;
  Planes metric, colours;
  const SweepParameters* parameters;
  const WindowProgram* program;
  float* smoothed;
  float* distances = nullptr;  // of a tile of one cell: where its window's distances go
};

// Scratch memory of one thread, which grows on demand and is reused.
struct TileScratch {
  std::vector<float> planes, window, sums;
};

// Returns the number of samples in the kernels of the tile's owned cells.
BELTRAMI_DECLARE_VARIANTS(std::int64_t sweep_tile(const TileJob& job, const Tile& tile, TileScratch& scratch))

}  // namespace beltrami::grid
