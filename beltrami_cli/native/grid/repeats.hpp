// Repeats of a sample on a canvas, beyond seams.
//
// A chart that is finer than its extension shows each sample there in several cells. They have the noise of one sample,
// so together they should count as one sample, and not bias averages.
#pragma once

#include <cstddef>
#include <cstdint>

namespace beltrami::grid {

struct HaloCells {
  const std::int64_t* cells;    // of the canvas, ascending
  const std::int64_t* sources;  // of each, the cell that it repeats
  const std::int32_t* seams;    // the seam that each was reached over
  std::size_t count;
};

// Writes, for each of rows * columns cells, the number of halo cells within `reach` rows and columns, including itself,
// that were reached over the same seam and have the value of the same source; 1 for other cells, at most 255.
void count_repeats(std::size_t rows, std::size_t columns, const HaloCells& halo, std::ptrdiff_t reach,
                   std::uint8_t* repeats, unsigned threads);

}  // namespace beltrami::grid
