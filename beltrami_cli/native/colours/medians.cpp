#include <algorithm>
#include <cmath>
#include <vector>

#include "colours/colours.hpp"
#include "parallel.hpp"

namespace beltrami::colours {
namespace {

constexpr std::size_t rows_per_chunk = 1 << 11;
constexpr std::size_t fewest = 4;

float median_of(std::vector<float>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

void take_medians(const Layout<const float>& colours, std::size_t channels, const Around& around, float* medians,
                  float* deviations, unsigned threads) {
  parallel_chunks(around.count, rows_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    std::vector<float> values;
    for (std::size_t row = begin; row < end; ++row)
      for (std::size_t k = 0; k < channels; ++k) {
        const float colour = colours.at(k, static_cast<std::size_t>(around.samples[row]));
        const std::int64_t* others = around.neighbours + row * around.width;
        values.clear();
        for (std::size_t i = 0; i < around.width; ++i)
          if (others[i] >= 0) values.push_back(colours.at(k, static_cast<std::size_t>(others[i])));
        float &median = medians[row * channels + k], &deviation = deviations[row * channels + k];
        median = colour, deviation = 0;
        if (values.size() < fewest) continue;
        median = median_of(values);
        for (float& value : values) value = std::abs(value - median);
        deviation = median_of(values);
      }
  });
}

}  // namespace beltrami::colours
