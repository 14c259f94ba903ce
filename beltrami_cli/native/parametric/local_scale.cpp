#include "parametric/local_scale.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "parametric/grid.hpp"

namespace beltrami::parametric {
namespace {

struct Sum {
  double logarithm = 0;  // of squared lengths
  double count = 0;
};

// Edges of the two axes that start at a cell.
Sum edges_at(const float* squared_lengths, std::size_t cells, std::size_t cell) {
  Sum sum;
  double product = 1;  // which a double holds, of two: one logarithm for both
  for (const Direction axis : {right, below}) {
    const float length = squared_lengths[axis * cells + cell];
    if (std::isfinite(length) && length > 0) {
      product *= static_cast<double>(length);
      sum.count += 1;
    }
  }
  if (sum.count > 0) sum.logarithm = std::log(product);
  return sum;
}

}  // namespace

void local_scale(std::size_t rows, std::size_t columns, const float* squared_lengths, int window_radius, float* scale) {
  const auto reach = static_cast<std::size_t>(window_radius);
  const std::size_t cells = rows * columns;
  // Sums over the window's rows, one a column, move down with the window; those over its columns along the row. The rows
  // in the window are kept, since logarithms take most of the time.
  const std::size_t held = 2 * reach + 1;
  std::vector<Sum> down(columns), kept(held * columns);
  const auto move = [&](std::size_t row, double sign) {
    Sum* edges = kept.data() + row % held * columns;
    for (std::size_t column = 0; column < columns; ++column) {
      if (sign > 0) edges[column] = edges_at(squared_lengths, cells, row * columns + column);
      down[column].logarithm += sign * edges[column].logarithm;
      down[column].count += sign * edges[column].count;
    }
  };
  for (std::size_t row = 0; row < std::min(reach, rows); ++row) move(row, 1);
  for (std::size_t row = 0; row < rows; ++row) {
    if (row > reach) move(row - reach - 1, -1);
    if (row + reach < rows) move(row + reach, 1);
    Sum window;
    const auto add = [&](std::size_t column, double sign) {
      window.logarithm += sign * down[column].logarithm;
      window.count += sign * down[column].count;
    };
    for (std::size_t column = 0; column < std::min(reach, columns); ++column) add(column, 1);
    for (std::size_t column = 0; column < columns; ++column) {
      if (column + reach < columns) add(column + reach, 1);
      if (column > reach) add(column - reach - 1, -1);
      // Counts are whole, so they come out exactly.
      scale[row * columns + column] =
          window.count > 0.5 ? std::exp(static_cast<float>(-window.logarithm / window.count)) : 1;
    }
  }
}

}  // namespace beltrami::parametric
