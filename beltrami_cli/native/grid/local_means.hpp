// Local means on a grid: of colours, for the regularised metric; and of lengths, for a unit of length that follows the
// density of samples.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "grid/grid.hpp"
#include "instruction_set.hpp"

namespace beltrami::grid {

BELTRAMI_DECLARE_VARIANTS(
    // Writes sums of tap * value for `count` values; the values of successive taps are `step` apart.
    void sum_over_taps(const float* values, std::size_t step, std::span<const float> taps, std::size_t count, float* sums))

// Convolves planes of rows * columns cells with the taps (an odd number of them) down columns and along rows. Beyond the
// grid's borders everything is 0.
void convolve(const Planes& planes, std::size_t rows, std::size_t columns, std::span<const float> taps, float* result,
              unsigned threads);

// For every cell 1 / (mean squared length of the edges to the right and below) over a square window; 1 where the window
// has no edge with a length. The geometric mean is robust to few long edges over a slit, or short ones in a fold.
// right, below, scale: rows * columns; infinite, or 0, where there is no edge.
void local_scale(std::size_t rows, std::size_t columns, const float* right, const float* below, int window_radius,
                 float* scale);

}  // namespace beltrami::grid
