// Collaborative estimation of groups of similar patches, each channel by itself: every patch of a group becomes
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
// A pilot has lost some detail and kept some noise. How much detail a group holds is known without bias: with sums over
// its K patches of squared differences from their mean, E_X of the pilot and E_Y of the noisy patches, and d the mean of D,
// it is E_Y - (K - 1) d. So D is multiplied by
//
//   alpha = strength (E_X + c s d) / (max(E_Y - (K - 1) d, 0) + c d),
//
// the ratio of the detail in the pilot to this, drawn to `shrinkage` s where there is little of either, and at least
// `least_ratio`. Where the pilot is negligible against alpha D, every patch becomes the mean m of all, Theta = 1 / K.
// Noise of the energy e = strength d (n - 1) / (n K) is left in its differences from its own mean, which are multiplied by
// (1 - e / E_m)+, with E_m the sum of their squares [2].
//
// [1] S. Herbreteau, C. Kervrann, "Towards a unified view of unsupervised non-local methods for image denoising: the
//     NL-Ridge approach", ICIP 2022, https://arxiv.org/abs/2203.00570
// [2] W. James, C. Stein, "Estimation with quadratic loss", Proc. Fourth Berkeley Symposium 1 (1961), 361-379.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "instruction_set.hpp"

namespace beltrami::patches {

// Number of patches in a group: without a pilot, and with one, on surfaces and on grids.
constexpr std::size_t few = 16, medium = 32, many = 48;

// Values per row of the patches of surfaces and of grids, including padding.
constexpr std::size_t short_row = 32, long_row = 64;

// Value of cells and nodes without a colour. It is so far from all colours that no candidate lacks a value that the first
// patch has: distances of such patches are above `too_far`.
constexpr float far_away = 1e9F, too_far = 1e17F;

// Mixing of channels: `forth`, channels * channels factors, gives the channels that are estimated separately; `back` is
// its inverse.
struct Mixing {
  const float *forth, *back;
  const float *variances, *shrinkage;  // of each mixed channel: the variance of its noise, and see above
  float least_ratio, strength;
};

struct Colours {
  const float *noisy, *pilot;
  std::size_t channels;
  Mixing mixing;
  const float* relative;  // factors of the variance, by sample; nullptr: 1
};

// Sums of weighted estimates and of their weights, laid out like the colours.
struct Sums {
  float *estimates, *weights;
};

// One channel of a group, and scratch memory. Patches are rows of `length` values, as differences from one colour, to
// keep the precision of sums.
struct alignas(64) Group {
  std::size_t size, length;  // `few` to `many`, `short_row` or `long_row`
  std::size_t found;         // patches, at most `size`
  std::size_t count;         // values in a patch
  std::array<std::uint8_t, long_row> used;  // where in its row each is; elsewhere the patches are 0
  float shrinkage, least_ratio, strength;   // with a pilot

  alignas(64) std::array<float, many> energy;  // of the noise
  alignas(64) std::array<float, many * long_row> noisy, pilot;  // 0 where a row has no value

  alignas(64) std::array<float, many> weights;  // of the estimates, 1 / |Theta_k|^2
  alignas(64) std::array<float, many * long_row> estimates;

  alignas(64) std::array<float, many * long_row> values;  // patches are its columns
  alignas(64) std::array<float, many * many> theta;
};

// Estimates the patches of a group from its noisy ones, by the pilot if there is one. All `size` rows are written;
// those from `found` on, and their weights, are undefined.
BELTRAMI_DECLARE_VARIANTS(void estimate_group(Group& group, bool has_pilot))

}  // namespace beltrami::patches
