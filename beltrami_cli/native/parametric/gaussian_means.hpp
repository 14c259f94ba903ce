// Separable means over the cells of a grid, for the regularised metric.
#pragma once

#include <cstddef>
#include <span>

namespace beltrami::parametric {

// Convolves planes of rows * columns cells with the taps (an odd number of them) down columns and along rows. Beyond the
// grid's borders everything is 0.
void convolve(const float* planes, std::size_t count, std::size_t rows, std::size_t columns, std::span<const float> taps,
              float* result, unsigned threads);

}  // namespace beltrami::parametric
