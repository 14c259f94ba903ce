// The average of eq. (9) over the samples of one kernel.
#pragma once

#include <span>
#include <vector>

#include "triangulated/fast_marching.hpp"
#include "triangulated/metric.hpp"

namespace beltrami::triangulated {

// Averages differences from the first sample, the centre, so that a constant is a fixed point to the last bit. sums: scratch
// for as many numbers as there are channels. weights: w_q, or nullptr for 1.
void average(std::span<const Reached> samples, Rows<float> colours, const float* weights, float quarter_inverse_t,
             std::vector<double>& sums, float* smoothed);

}  // namespace beltrami::triangulated
