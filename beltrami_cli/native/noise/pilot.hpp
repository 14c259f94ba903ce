// A quick estimate of clean colours: passes over the nearest neighbours, whose weights fall to 0 at differences that noise
// hardly reaches (J. Tukey's biweight).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "instruction_set.hpp"

namespace beltrami::noise {

constexpr std::size_t channels = 3;

// The noise that is left halves with each pass, and its variance falls to a quarter.
constexpr int passes = 3;
constexpr float left_by_pass = 0.25F;

// Squared difference of three channels, in units of the noise variance, at which a weight is 0. Differences of independent
// noise have a mean of 6, and exceed 24 in one of 200 pairs.
constexpr float max_square = 24;

// Least limit of squared differences, so that it can be divided by.
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

// Writes the pilot of planes of squares; what it writes at cells that are not filled has no meaning.
void smooth_squares(const PilotSquares& squares, const float* colours, float* pilot);

// Writes the pilot of planes of `count` samples joined by edges, whose ends must be below `count`.
void smooth_graph(const float* colours, std::size_t count, std::span<const std::array<std::int64_t, 2>> edges,
                  Variances variances, float* pilot);

}  // namespace beltrami::noise
