// A quick estimate of clean colours by passes over the nearest neighbours. Their weights fall to 0 at differences that
// noise rarely reaches (J. Tukey's biweight).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "instruction_set.hpp"

namespace beltrami::noise {

constexpr std::size_t channels = 3;

// The remaining noise halves with each pass, so its variance falls to a quarter.
constexpr int passes = 3;
constexpr float left_by_pass = 0.25F;

// Squared difference of three channels, in units of the noise variance, from which on weights are 0. Differences of
// independent noise have a mean of 6, and exceed 24 in one of 200 pairs.
constexpr float max_square = 24;

// Minimum limit of squared differences, as a divisor.
constexpr float least_limit = 1e-6F;

// The variance of the noise at each sample, or one for all.
struct Variances {
  const float* values;
  bool is_one;

  float limit(std::size_t sample) const { return max_square * values[is_one ? 0 : sample]; }
};

// `count` squares of side * side cells, one after the other.
struct PilotSquares {
  std::size_t count, side;
  const bool* filled;  // null: all cells are
  Variances variances;

  std::size_t cells() const { return count * side * side; }
};

BELTRAMI_DECLARE_VARIANTS(
    void smooth_padded_squares(const PilotSquares& squares, const float* colours, float* pilot))

// Writes the pilot of planes of squares. Values at cells that are not filled are unspecified.
void smooth_squares(const PilotSquares& squares, const float* colours, float* pilot);

// Writes the pilot of planes of `count` samples joined by edges, whose ends must be below `count`.
void smooth_graph(const float* colours, std::size_t count, std::span<const std::array<std::int64_t, 2>> edges,
                  Variances variances, float* pilot);

}  // namespace beltrami::noise
