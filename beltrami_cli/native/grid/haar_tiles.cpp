#include "grid/haar_tiles.hpp"

#include <algorithm>
#include <array>

namespace beltrami::grid {
namespace {

constexpr std::size_t cells_a_side = tile_side + 1;

// A tile's first cell, and its cells down and across within the grid: squares need the next row and the next column.
struct Tile {
  std::size_t row, column, height, width;
};

Tile tile_at(std::size_t row, std::size_t column, const FilledPlanes& planes) {
  return {row, column, std::min(cells_a_side, planes.rows - row), std::min(cells_a_side, planes.columns - column)};
}

// Copies a tile, 0 where cells are not filled or beyond the grid: loops over all of it have the same length then.
template <class Value>
using Patch = std::array<std::array<Value, cells_a_side>, cells_a_side>;

Patch<float> copy(const Tile& tile, const float* values, const FilledPlanes& planes) {
  Patch<float> patch{};
  for (std::size_t y = 0; y < tile.height; ++y) {
    const std::size_t cell = (tile.row + y) * planes.columns + tile.column;
    for (std::size_t x = 0; x < tile.width; ++x) patch[y][x] = planes.filled[cell + x] ? values[cell + x] : 0;
  }
  return patch;
}

// Sums down columns of squares, which go side by side, and then of these.
using Sums = std::array<double, tile_side>;

double total(const Sums& sums) {
  double all = 0;
  for (const double sum : sums) all += sum;
  return all;
}

// Which squares count: 1 or 0.
struct Counting {
  std::array<Sums, tile_side> squares{};
  double count = 0;

  Counting(const Tile& tile, const FilledPlanes& planes) {
    for (std::size_t y = 0; y + 1 < tile.height; ++y) {
      const bool* above = planes.filled + (tile.row + y) * planes.columns + tile.column;
      const bool* below = above + planes.columns;
      for (std::size_t x = 0; x + 1 < tile.width; ++x)
        squares[y][x] = above[x] && above[x + 1] && below[x] && below[x + 1] ? 1.0 : 0.0;
      count += total(squares[y]);
    }
  }
};

std::array<double, tile_measures> measure(const Patch<float>& patch, const Counting& counting) {
  Sums details{}, squares{}, means{}, low{}, high{}, first{}, plain{};
  const double level = patch[0][0];  // taken off the means: small numbers, whose squares lose no digits
  for (std::size_t y = 0; y < tile_side; ++y)
    for (std::size_t x = 0; x < tile_side; ++x) {
      const double a = patch[y][x], b = patch[y][x + 1], c = patch[y + 1][x], d = patch[y + 1][x + 1];
      const double counts = counting.squares[y][x];
      const double detail = counts * ((a - b - c + d) / 2), mean = counts * ((a + b + c + d) / 4 - level);
      details[x] += detail * detail;
      squares[x] += mean * mean;
      means[x] += mean;
      low[x] += a == 0 ? counts : 0.0;
      high[x] += a == 1 ? counts : 0.0;
      first[x] += counts * a;
      plain[x] += a == b && b == c && c == d ? counts : 0.0;
    }
  const double count = counting.count, mean = total(means) / count;
  return {total(details) / count, std::max(total(squares) / count - mean * mean, 0.0), total(low) / count,
          total(high) / count, total(first) / count, total(plain) / count};
}

}  // namespace

void measure_tiles(const FilledPlanes& planes, std::span<const std::int64_t> first_rows, std::int32_t* counts,
                   double* measures) {
  const std::size_t tiles = tiles_across(planes.columns), all = first_rows.size() * tiles;
  std::fill(counts, counts + all, 0);
  std::fill(measures, measures + tile_measures * planes.count * all, 0.0);
  for (std::size_t i = 0; i < all; ++i) {
    const Tile tile = tile_at(static_cast<std::size_t>(first_rows[i / tiles]), i % tiles * tile_side, planes);
    const Counting counting(tile, planes);
    counts[i] = static_cast<std::int32_t>(counting.count);
    if (counts[i] == 0) continue;
    for (std::size_t plane = 0; plane < planes.count; ++plane) {
      const float* values = planes.values + plane * planes.rows * planes.columns;
      const auto found = measure(copy(tile, values, planes), counting);
      for (std::size_t k = 0; k < tile_measures; ++k) measures[(k * planes.count + plane) * all + i] = found[k];
    }
  }
}

}  // namespace beltrami::grid
