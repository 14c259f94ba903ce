// Samples of one channel whose noise was cut off at 0, at 1 or at both, see flow/clipping.py: replacing them by what noise is
// beyond the limit, and correcting averages of them. All arrays hold one value a sample.
#pragma once

#include <cstddef>

#include "colours/colours.hpp"
#include "layout.hpp"

namespace beltrami::colours {

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

}  // namespace beltrami::colours
