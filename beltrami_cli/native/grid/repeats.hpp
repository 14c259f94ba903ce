// How often a canvas shows a sample beyond a seam.
//
// A chart that is finer than what it is continued by shows each sample there in several cells. They hold one sample's
// noise, so together they should count for one sample, and not draw averages to it.
#pragma once

#include <cstddef>
#include <cstdint>

namespace beltrami::grid {

struct HaloCells {
  const std::int64_t* cells;    // of the canvas, ascending
  const std::int64_t* sources;  // the cell whose value each has
  const std::int32_t* seams;    // the seam that each was reached over
  std::size_t count;
};

// Writes for each of rows * columns cells how many halo cells within `reach` rows and columns, itself included, were
// reached over the same seam and have the value of the same source; 1 for other cells, and at most 255.
void count_repeats(std::size_t rows, std::size_t columns, const HaloCells& halo, std::ptrdiff_t reach,
                   std::uint8_t* repeats, unsigned threads);

}  // namespace beltrami::grid
