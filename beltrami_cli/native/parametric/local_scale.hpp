// The unit of length that follows a sampling whose density varies.
#pragma once

#include <cstddef>

namespace beltrami::parametric {

// For every cell 1 / (mean squared length of the edges to the right and below) over a square window about it; 1 where
// the window holds no edge with a length. The mean is geometric: the few long edges over a slit, or short ones in a
// fold, do not move it far. squared_lengths: planes of rows * columns, see Grid; only the first two are
// read. scale: rows * columns.
void local_scale(std::size_t rows, std::size_t columns, const float* squared_lengths, int window_radius, float* scale);

}  // namespace beltrami::parametric
