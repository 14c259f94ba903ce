#include "parametric/gaussian_means.hpp"

#include <algorithm>
#include <vector>

#include "parallel.hpp"

namespace beltrami::parametric {
namespace {

// Adds weight * values to sums.
void accumulate(const float* values, float weight, std::size_t count, float* sums) {
  for (std::size_t i = 0; i < count; ++i) sums[i] += weight * values[i];
}

}  // namespace

void convolve(const float* planes, std::size_t count, std::size_t rows, std::size_t columns, std::span<const float> taps,
              float* result, unsigned threads) {
  const std::size_t reach = taps.size() / 2;
  // A chunk is some rows of a plane; a line of means down columns has zeros on both sides.
  const std::size_t height = std::max<std::size_t>(1, (std::size_t{1} << 16) / std::max<std::size_t>(1, columns));
  parallel_chunks(count * rows, height, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    std::vector<float> line(columns + 2 * reach, 0.0F);
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t row = i % rows;
      std::fill(line.begin(), line.end(), 0.0F);
      for (std::size_t tap = 0; tap < taps.size(); ++tap)
        if (row + tap >= reach && row + tap < rows + reach)
          accumulate(planes + (i + tap - reach) * columns, taps[tap], columns, line.data() + reach);
      float* means = result + i * columns;
      std::fill(means, means + columns, 0.0F);
      for (std::size_t tap = 0; tap < taps.size(); ++tap) accumulate(line.data() + tap, taps[tap], columns, means);
    }
  });
}

}  // namespace beltrami::parametric
