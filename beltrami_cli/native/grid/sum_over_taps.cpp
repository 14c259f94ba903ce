// Compiled once for each instruction set, see instruction_set.hpp.
#include <array>

#include "grid/local_means.hpp"
#include "lanes.hpp"

namespace beltrami::grid::BELTRAMI_VARIANT {

using namespace beltrami::lanes::BELTRAMI_VARIANT;

void sum_over_taps(const float* values, std::size_t step, std::span<const float> taps, std::size_t count, float* sums) {
  constexpr std::size_t packs = 4, width = packs * lane_count;  // sums stay in registers
  std::size_t first = 0;
  for (; first + width <= count; first += width) {
    std::array<Lanes, packs> sum{};
    for (std::size_t tap = 0; tap < taps.size(); ++tap)
      for (std::size_t v = 0; v < packs; ++v) sum[v] += load(values + tap * step + first + v * lane_count) * taps[tap];
    for (std::size_t v = 0; v < packs; ++v) store(sums + first + v * lane_count, sum[v]);
  }
  for (; first < count; ++first) {
    float sum = 0;
    for (std::size_t tap = 0; tap < taps.size(); ++tap) sum += values[tap * step + first] * taps[tap];
    sums[first] = sum;
  }
}

}  // namespace beltrami::grid::BELTRAMI_VARIANT
