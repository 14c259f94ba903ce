#include "parametric/local_scale.hpp"

#include <algorithm>
#include <vector>

#include "parametric/grid.hpp"

namespace beltrami::parametric {
namespace {

struct Sum {
  double length = 0;
  double count = 0;
};

// Edges of the two axes that start at a cell.
Sum edges_at(const float* squared_lengths, std::size_t cells, std::size_t cell) {
  Sum sum;
  for (const Direction axis : {right, below}) {
    const float length = squared_lengths[axis * cells + cell];
    if (length < no_edge) {
      sum.length += static_cast<double>(length);
      sum.count += 1;
    }
  }
  return sum;
}

}  // namespace

void local_scale(std::size_t rows, std::size_t columns, const float* squared_lengths, int window_radius, float* scale) {
  const auto reach = static_cast<std::size_t>(window_radius);
  const std::size_t cells = rows * columns;
  // Sums over the window's rows, one a column, move down with the window; those over its columns along the row.
  std::vector<Sum> down(columns);
  const auto move = [&](std::size_t row, double sign) {
    for (std::size_t column = 0; column < columns; ++column) {
      const Sum edges = edges_at(squared_lengths, cells, row * columns + column);
      down[column].length += sign * edges.length;
      down[column].count += sign * edges.count;
    }
  };
  for (std::size_t row = 0; row < std::min(reach, rows); ++row) move(row, 1);
  for (std::size_t row = 0; row < rows; ++row) {
    if (row + reach < rows) move(row + reach, 1);
    if (row > reach) move(row - reach - 1, -1);
    Sum window;
    const auto add = [&](std::size_t column, double sign) {
      window.length += sign * down[column].length;
      window.count += sign * down[column].count;
    };
    for (std::size_t column = 0; column < std::min(reach, columns); ++column) add(column, 1);
    for (std::size_t column = 0; column < columns; ++column) {
      if (column + reach < columns) add(column + reach, 1);
      if (column > reach) add(column - reach - 1, -1);
      // Counts are whole, so they come out exactly; lengths leave rests of rounding.
      const bool known = window.count > 0.5 && window.length > 0;
      scale[row * columns + column] = known ? static_cast<float>(window.count / window.length) : 1;
    }
  }
}

}  // namespace beltrami::parametric
