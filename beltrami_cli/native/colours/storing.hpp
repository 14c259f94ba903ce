// Colours stored as integers among the pixels of an image.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace beltrami::colours {

// How far stored numbers moved: sums that are exact, so the same in any order.
struct Moved {
  std::uint64_t total = 0, squares = 0, largest = 0;
};

// Colours of full scale 1, a row a pixel; a column of them for each entry of `channels`.
struct Rows {
  const float* values;
  std::span<const std::int32_t> channels;  // of the pixel
};

// Stores rows at some pixels of an image with `width` channels each, rounded to the nearest, the even of two. What is
// beyond the range is clipped; what is no number becomes 0. No pixel may be named twice.
template <class Sample, class Index>
Moved store(const Rows& rows, std::span<const Index> pixels, std::size_t width, Sample* samples, unsigned threads);

}  // namespace beltrami::colours
