// Imputation of samples clipped at 0 or 1, and correction of their averages, by tables of functions.
#pragma once

#include <algorithm>
#include <cstddef>
#include <span>

#include "layout.hpp"

namespace beltrami::colours {

// A function tabulated at two or more nearly evenly spaced, ascending places; interpolated linearly, and constant
// beyond both ends.
class Table {
 public:
  Table(std::span<const double> at, std::span<const double> values)
      : at_(at), values_(values), steps_(static_cast<double>(at.size() - 1) / (at.back() - at.front())) {}

  float operator()(float where) const {
    const std::size_t last = at_.size() - 1;
    const double place = std::clamp(static_cast<double>(where), at_[0], at_[last]);
    std::size_t k = std::min(last - 1, static_cast<std::size_t>(std::max(0.0, (place - at_[0]) * steps_)));  // NaN: 0
    // Because of rounding, the place may be in an adjacent interval.
    k -= k > 0 && place < at_[k] ? 1 : 0;
    k += k + 2 <= last && place >= at_[k + 1] ? 1 : 0;
    const double slope = (values_[k + 1] - values_[k]) / (at_[k + 1] - at_[k]);
    return static_cast<float>(slope * (place - at_[k]) + values_[k]);
  }

 private:
  std::span<const double> at_, values_;
  double steps_;
};

// Clipping of a channel, see flow/corrections/clipping.py. Arrays of these functions have one value per sample.
struct Clipping {
  float sigma;  // of the noise
  bool low, high;
};

struct Samples {
  Layout<const float> relative;  // what the variance of a sample's noise is multiplied by
  std::size_t count;
};

// Corrects averages; a `share` of their samples is at a limit (negative: at 0). Both tables are over that share: the
// distance of the mean to the limit before (`alpha`) and after (`gap`) clipping unit noise. Local noise is at most
// `trusted` times the estimate.
void restore(const Layout<float>& averages, const Layout<const float>& share, const Clipping& clipping, float trusted,
             const Table& alpha, const Table& gap, const Samples& samples, unsigned threads);

// Replaces samples at a limit by the mean of the values beyond it, given an estimate of the colour without noise;
// `beyond`: E[z | z > a] of a unit normal variable z.
void impute(const Layout<float>& colours, const Layout<const float>& estimate, const Clipping& clipping,
            const Table& beyond, const Samples& samples, unsigned threads);

}  // namespace beltrami::colours
