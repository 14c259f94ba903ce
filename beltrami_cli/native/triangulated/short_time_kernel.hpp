// One iteration of the short-time Beltrami kernel.
//
// A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images on manifolds" (2007),
// eqs. (8) and (9):  I'(p) = sum_q w_q K(p,q) I(q) / sum_q w_q K(p,q),  K(p,q) = exp(-d(p,q)^2 / (4 t)),
// over the q with K >= threshold, d the geodesic distance on the image manifold.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "parallel.hpp"
#include "triangulated/fast_marching.hpp"
#include "triangulated/metric.hpp"
#include "triangulated/stencils.hpp"

namespace beltrami::triangulated {

struct KernelParameters {
  float time_step;          // t, squared length
  float radius;             // sqrt(-4 t ln threshold), length
  std::size_t max_samples;  // ends a march that would hold more, at least 1
  Index first = 0, last = std::numeric_limits<Index>::max();  // vertices in [first, last) have a kernel
};

struct KernelStatistics {
  std::int64_t samples = 0;    // in all kernels
  std::int64_t truncated = 0;  // kernels truncated at max_samples

  KernelStatistics& operator+=(const KernelStatistics& more) {
    samples += more.samples;
    truncated += more.truncated;
    return *this;
  }
};

// The average of eq. (9) over the samples of one kernel, of differences from the first sample, the centre, so that a
// constant is preserved exactly. sums: scratch memory, one number per channel. weights: w_q, or nullptr for 1.
void average(std::span<const Reached> samples, Rows<float> colours, const float* weights, float quarter_inverse_t,
             std::vector<double>& sums, float* smoothed);

// Reads all colours before writing any (Jacobi): `smoothed`, vertex_count rows of colours.width, must not overlap them.
// weights: w_q >= 0 of every vertex, or nullptr for 1. If all weights of a kernel are zero, the colour is not changed.
// Unselected vertices keep their colours; rows of vertices without a kernel are not written. Bit-identical for any
// number of threads. Throws Cancelled if poll asks to stop.
KernelStatistics smooth(const Stencils& stencils, Rows<float> colours, const float* weights,
                        const KernelParameters& parameters, float* smoothed, unsigned threads, const Poll& poll = {},
                        const Selection& selection = {});

}  // namespace beltrami::triangulated
