// Coarse grid of squares of cells.
#pragma once

#include <cstddef>
#include <cstdint>

namespace beltrami::grid {

// A grid of rows * columns cells, in squares of side `side`; the last of a row or column may be narrower.
struct Squares {
  std::size_t rows, columns, side;
  const std::uint8_t* kind;

  std::size_t down() const { return (rows + side - 1) / side; }
  std::size_t across() const { return (columns + side - 1) / side; }
};

// Averages planes over the cells of each square that have its kind; 0 in empty squares.
void means_of_squares(const Squares& squares, const std::uint8_t* kinds, const float* planes, std::size_t count, float* means,
                      unsigned threads);

// Adds changes of the owned squares to planes at the owned cells, interpolated bilinearly between the centres of
// squares.
void add_enlarged(const Squares& squares, const std::uint8_t* kinds, const float* changes, std::size_t count, float* planes,
                  unsigned threads);

}  // namespace beltrami::grid
