// Compiled once for each instruction set, see instruction_set.hpp.
#include "patches/patch_rows.hpp"

#include <array>

#include "lanes.hpp"

namespace beltrami::patches::BELTRAMI_VARIANT {

using namespace beltrami::lanes::BELTRAMI_VARIANT;

void compare_rows(const float* rows, std::size_t length, const float* mask, std::span<const std::int32_t> places,
                  float* distances) {
  constexpr std::size_t width = 16, packs = width / lane_count;
  const float* first = rows + static_cast<std::size_t>(places[0]) * length;
  for (std::size_t k = 0; k < places.size(); ++k) {
    const float* other = rows + static_cast<std::size_t>(places[k]) * length;
    std::array<Lanes, packs> sums{};
    for (std::size_t i = 0; i < length; i += width)
      for (std::size_t v = 0; v < packs; ++v) {
        const std::size_t at = i + v * lane_count;
        const Lanes difference = (load(other + at) - load(first + at)) * load(mask + at);
        sums[v] += difference * difference;
      }
    // As many partial sums for any number of lanes.
    alignas(64) std::array<float, width> partial;
    for (std::size_t v = 0; v < packs; ++v) store(partial.data() + v * lane_count, sums[v]);
    for (std::size_t half = width / 2; half > 0; half /= 2)
      for (std::size_t i = 0; i < half; ++i) partial[i] += partial[i + half];
    distances[k] = partial[0];
  }
}

void take_rows(const float* channel, std::span<const std::size_t> rows, const NodeMask& mask, float mean, float* group) {
  for (std::size_t k = 0; k < rows.size(); ++k)
    for (std::size_t at = 0; at < short_row; at += lane_count)
      store(group + k * short_row + at, (load(channel + rows[k] + at) - mean) * load(mask.data() + at));
}

void add_rows(const Group& group, std::span<const std::size_t> rows, const NodeMask& mask, float mean, float* channel) {
  for (std::size_t k = 0; k < rows.size(); ++k)
    for (std::size_t at = 0; at < short_row; at += lane_count) {
      const Lanes estimate = load(group.estimates.data() + k * short_row + at) + mean;
      float* sum = channel + rows[k] + at;
      store(sum, load(sum) + estimate * load(mask.data() + at) * group.weights[k]);
    }
}

}  // namespace beltrami::patches::BELTRAMI_VARIANT
