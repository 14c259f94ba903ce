// Sums over channels for Stein's unbiased estimate of the error of a blend of two estimates, see flow/blending.py, for
// noise that may be clipped at 0 and full scale.
#pragma once

#include <cstddef>
#include <span>

#include "instruction_set.hpp"
#include "layout.hpp"

namespace beltrami::patches {

using Values = Layout<const float>;

// Tables for a unit normal variable z, at limits a from `-furthest` to `furthest` in even steps: E max(z - a, 0) and
// P(z > a).
struct NormalTables {
  float furthest;
  std::span<const float> lost, share;
};

// The noise of a channel, and whether it is clipped at 0 and at 1.
struct ChannelNoise {
  float variance;  // assumed by the estimate of the error
  float sigma;     // before clipping
  bool low, high;
};

struct BlendNoise {
  std::span<const ChannelNoise> channels;
  NormalTables tables;
  Values relative;  // factors of the variance, by sample; one channel
};

// Two estimates, without and with perturbation of the noisy colours.
struct Estimates {
  Values first, second, near_first, near_second;
};

// The samples from `begin` on, before `end`.
struct Range {
  std::size_t begin, end;
};

BELTRAMI_DECLARE_VARIANTS(
    // Writes the terms of the numerator and of the denominator of the weight of the second estimate, two channels. `probe`:
    // the perturbation divided by its squared size.
    void blend_terms(const Values& noisy, const Values& probe, const Estimates& estimates, const BlendNoise& noise,
                     const Range& samples, const Layout<float>& terms);

    // Writes the noisy colours, clipped as they are, minus their expectation given an estimate.
    void blend_residual(const Values& noisy, const Values& estimate, const BlendNoise& noise, const Range& samples,
                        const Layout<float>& residual);

    // Writes the share of unclipped noisy colours, given an estimate of the colours without noise.
    void blend_share_within(const Values& estimate, const BlendNoise& noise, const Range& samples, const Layout<float>& share))

inline auto best_blend_terms() { return BELTRAMI_VARIANT_OF(blend_terms, choose_instruction_set()); }
inline auto best_blend_residual() { return BELTRAMI_VARIANT_OF(blend_residual, choose_instruction_set()); }
inline auto best_blend_share_within() { return BELTRAMI_VARIANT_OF(blend_share_within, choose_instruction_set()); }

}  // namespace beltrami::patches
