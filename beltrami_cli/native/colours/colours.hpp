// Rows of colours stored as integers among the pixels of an image, and tables of functions.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace beltrami::colours {

// Values at places that ascend in nearly even steps, two or more; linear in between, and beyond both ends as there.
class Table {
 public:
  Table(std::span<const double> at, std::span<const double> values)
      : at_(at), values_(values), steps_(static_cast<double>(at.size() - 1) / (at.back() - at.front())) {}

  // The place is a number.
  float operator()(float where) const {
    const std::size_t last = at_.size() - 1;
    const double place = std::clamp(static_cast<double>(where), at_[0], at_[last]);
    std::size_t k = std::min(last - 1, static_cast<std::size_t>((place - at_[0]) * steps_));
    // Rounding may lead to a neighbour of the interval that holds the place.
    k -= k > 0 && place < at_[k] ? 1 : 0;
    k += k + 2 <= last && place >= at_[k + 1] ? 1 : 0;
    const double slope = (values_[k + 1] - values_[k]) / (at_[k + 1] - at_[k]);
    return static_cast<float>(slope * (place - at_[k]) + values_[k]);
  }

 private:
  std::span<const double> at_, values_;
  double steps_;
};

// How far stored numbers moved: sums that are exact, so the same in any order.
struct Moved {
  std::uint64_t total = 0, squares = 0, largest = 0;
};

// Colours of full scale 1, a row a pixel; a column of them for each entry of `channels`.
struct Rows {
  const float* values;
  std::span<const std::int32_t> channels;  // of the pixel
};

// Stores rows at some pixels of an image with `width` channels each, rounded to the nearest, the even of two. Values
// beyond the range are clipped; NaN becomes 0. No pixel may be named twice.
template <class Sample, class Index>
Moved store(const Rows& rows, std::span<const Index> pixels, std::size_t width, Sample* samples, unsigned threads);

}  // namespace beltrami::colours
