// Collaborative estimation of groups of patches that look alike, each channel by itself: every patch of a group becomes
// a linear combination of all of them.
//
// Let Y be the noisy patches of a group, n values by K patches, X the same patches of a pilot (an earlier estimate), and D
// diagonal, with the energy of the noise in each patch. The combinations Theta, whose columns sum to 1, with the least
// expected error are
//
//   Theta = I - (B - b b^T / sum b) D,   B = (X^T X + D)^-1,   b = B 1,
//
// which is the ridge estimate of [1], eqs. (8) and (13), under the constraint that a constant stays. Without a pilot, the
// least of Stein's unbiased estimate of the error is at the same Theta with B = (Y^T Y)^-1.
//
// [1] S. Herbreteau, C. Kervrann, "Towards a unified view of unsupervised non-local methods for image denoising: the
//     NL-Ridge approach", ICIP 2022, https://arxiv.org/abs/2203.00570
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "instruction_set.hpp"

namespace beltrami::patches {

// Patches in a group: of those without a pilot, and of those with one on surfaces and on grids.
constexpr std::size_t few = 16, medium = 32, many = 48;

// Channels of samples, one plane after the other, `stride` values each.
struct Channels {
  const float *noisy, *pilot;
  const float* variances;  // of the noise, one a channel
  const float* relative;   // what a sample's variance is multiplied by; nullptr: 1
  std::size_t count, stride;
};

// Sums of estimates and of their weights, laid out like the channels.
struct Sums {
  float *estimates, *weights;
};

// The most samples of a patch.
constexpr std::size_t most_rows = 52;

// Memory of one thread, aligned to cache lines.
struct alignas(64) GroupScratch {
  std::array<float, most_rows * many> pilot, noisy;
  std::array<float, many * many> theta;
  std::array<float, many> relative, energy;
};

// Writes to `distances` the sums of squared differences between rows of `length` floats, a multiple of 16: the first and
// those of `rows`. Differences are multiplied by `mask`, 0 or 1.
using CompareRows = void (*)(const float* features, std::size_t length, const float* mask, const std::int32_t* rows,
                             std::size_t count, float* distances);

BELTRAMI_DECLARE_VARIANTS(void compare_rows(const float* features, std::size_t length, const float* mask,
                                            const std::int32_t* rows, std::size_t count, float* distances))

// Adds the estimates of one group: its patches are columns, and the sample of row p and column k is places[p * size + k].
// Columns from `found` on are not used, and rows of places hold valid indices there. size: `few`, `medium` or `many`.
using AddGroup = void (*)(const Channels& channels, const std::int32_t* places, std::size_t rows, std::size_t size,
                          std::size_t found, bool has_pilot, const Sums& sums, GroupScratch& scratch);

BELTRAMI_DECLARE_VARIANTS(void add_group(const Channels& channels, const std::int32_t* places, std::size_t rows,
                                         std::size_t size, std::size_t found, bool has_pilot, const Sums& sums,
                                         GroupScratch& scratch))

}  // namespace beltrami::patches
