// Tables of functions; samples whose noise was cut off at 0 or 1: replacing them by what noise is beyond the limit, and
// correcting averages of them; and colours stored as integers among the pixels of an image.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>

#include "layout.hpp"

namespace beltrami::colours {

// Values at places that ascend in nearly even steps, two or more; linear in between, and beyond both ends as there.
class Table {
 public:
  Table(std::span<const double> at, std::span<const double> values)
      : at_(at), values_(values), steps_(static_cast<double>(at.size() - 1) / (at.back() - at.front())) {}

  float operator()(float where) const {
    const std::size_t last = at_.size() - 1;
    const double place = std::clamp(static_cast<double>(where), at_[0], at_[last]);
    std::size_t k = std::min(last - 1, static_cast<std::size_t>(std::max(0.0, (place - at_[0]) * steps_)));  // NaN: 0
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

// How a channel was cut off, see flow/corrections/clipping.py. All arrays of these functions hold one value a sample.
struct CutOff {
  float sigma;  // of the noise
  bool low, high;
};

struct Samples {
  Layout<const float> relative;  // what the variance of a sample's noise is multiplied by
  std::size_t count;
};

// Moves averages in whose samples `share` are at a limit, negative for that at 0, towards it. Both tables go over that share:
// how far the mean lies from the limit before (`alpha`) and after (`gap`) noise with a deviation of 1 was cut off. Local
// noise is at most `trusted` times as much as was found.
void restore(const Layout<float>& averages, const Layout<const float>& share, const CutOff& cut, float trusted,
             const Table& alpha, const Table& gap, const Samples& samples, unsigned threads);

// Replaces samples at a limit by the mean of the values beyond it, by an estimate of the colour without noise; `beyond`:
// E[z | z > a] of a normal variable z with a deviation of 1.
void impute(const Layout<float>& colours, const Layout<const float>& estimate, const CutOff& cut, const Table& beyond,
            const Samples& samples, unsigned threads);

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
