// Tiles of 2 x 2 squares of a grid, from whose finest details its noise is estimated.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace beltrami::grid {

// Squares a side of a tile.
constexpr std::size_t tile_side = 8;

constexpr std::size_t tiles_across(std::size_t columns) { return (columns + tile_side - 1) / tile_side; }

// Of each tile: mean square of the squares' diagonal Haar coefficients (a - b - c + d) / 2, variance of their means, share
// of their first cells at 0 and at 1, mean of their first cells, and share of squares of equal cells.
constexpr std::size_t tile_measures = 6;

// Planes of rows * columns cells, and where there is something to look at.
struct FilledPlanes {
  const float* values;
  std::size_t count, rows, columns;
  const bool* filled;
};

// Goes through bands of tiles, each from some row on. Only squares whose four cells are filled count.
//   counts    [band][tile]: squares that count
//   measures  [measure][plane][band][tile]; 0 where no square counts
void measure_tiles(const FilledPlanes& planes, std::span<const std::int64_t> first_rows, std::int32_t* counts,
                   double* measures);

}  // namespace beltrami::grid
