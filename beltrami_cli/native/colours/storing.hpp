// Storage of colours as integers in the pixels of an image.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace beltrami::colours {

// Changes of stored numbers: sums that are exact, and so independent of their order.
struct Moved {
  std::uint64_t total = 0, squares = 0, largest = 0;
};

// Colours of full scale 1, one row per pixel, with a column for each entry of `channels`.
struct Rows {
  const float* values;
  std::span<const std::int32_t> channels;  // of the pixel
};

// Stores rows in pixels of an image with `width` channels each, rounded to nearest, ties to even. Values beyond the
// range are clipped; NaN becomes 0. No pixel may occur twice.
template <class Sample, class Index>
Moved store(const Rows& rows, std::span<const Index> pixels, std::size_t width, Sample* samples, unsigned threads);

}  // namespace beltrami::colours
