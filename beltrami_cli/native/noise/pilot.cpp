#include <algorithm>
#include <vector>

#include "noise/pilot.hpp"

namespace beltrami::noise {
namespace {

// The channels of a sample and its limit, or the sums of weighted differences and of weights, adjacent in memory.
struct alignas(16) Row {
  std::array<float, channels> colours;
  float last;
};

void add_pairs(const std::vector<Row>& samples, std::span<const std::array<std::int64_t, 2>> edges, float scale,
               std::vector<Row>& sums) {
  for (const auto& [first, second] : edges) {
    const Row &one = samples[static_cast<std::size_t>(first)], &other = samples[static_cast<std::size_t>(second)];
    std::array<float, channels> difference;
    float squared = 0;
    for (std::size_t k = 0; k < channels; ++k) {
      difference[k] = other.colours[k] - one.colours[k];
      squared += difference[k] * difference[k];
    }
    const float limit = std::max((one.last + other.last) * scale, least_limit);
    // The minimum of two variables: for a constant, compilers make a branch, which noise makes unpredictable.
    const float nearness = (limit - std::min(squared, limit)) / limit, weight = nearness * nearness;
    Row &to_one = sums[static_cast<std::size_t>(first)], &to_other = sums[static_cast<std::size_t>(second)];
    for (std::size_t k = 0; k < channels; ++k) {
      to_one.colours[k] += difference[k] * weight;
      to_other.colours[k] -= difference[k] * weight;
    }
    to_one.last += weight;
    to_other.last += weight;
  }
}

}  // namespace

void smooth_squares(const PilotSquares& squares, const float* colours, float* pilot) {
  BELTRAMI_VARIANT_OF(smooth_padded_squares, choose_instruction_set())(squares, colours, pilot);
}

void smooth_graph(const float* colours, std::size_t count, std::span<const std::array<std::int64_t, 2>> edges,
                  Variances variances, float* pilot) {
  std::vector<Row> samples(count), sums(count);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t k = 0; k < channels; ++k) samples[i].colours[k] = colours[k * count + i];
    samples[i].last = variances.limit(i);
  }
  float scale = 0.5F;  // of the mean of two limits
  for (int number = 0; number < passes; ++number, scale *= left_by_pass) {
    std::fill(sums.begin(), sums.end(), Row{{}, 1.0F});
    add_pairs(samples, edges, scale, sums);
    for (std::size_t i = 0; i < count; ++i)
      for (std::size_t k = 0; k < channels; ++k) samples[i].colours[k] += sums[i].colours[k] / sums[i].last;
  }
  for (std::size_t i = 0; i < count; ++i)
    for (std::size_t k = 0; k < channels; ++k) pilot[k * count + i] = samples[i].colours[k];
}

}  // namespace beltrami::noise
