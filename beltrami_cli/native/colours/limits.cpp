#include "colours/colours.hpp"

#include <algorithm>
#include <cstdint>
#include <limits>

namespace beltrami::colours {
namespace {

// Rows that are looked at side by side: values stand at the same channels in each such group of rows, so that the inner
// loop goes through memory in its order, whatever the number of channels.
constexpr std::size_t group = 16;

// Groups after which counts in 32 bits are added up, long before they overflow.
constexpr std::size_t groups_per_sum = 1 << 16;

constexpr float infinity = std::numeric_limits<float>::infinity();

// Running values of every place in a group.
struct Places {
  explicit Places(std::size_t size) : least(size, infinity), most(size, -infinity), at_0(size), at_1(size) {}

  void look_at(const float* values, std::size_t size) {
    float *const lowest = least.data(), *const highest = most.data();
    std::int32_t *const zeros = at_0.data(), *const ones = at_1.data();
    for (std::size_t i = 0; i < size; ++i) {
      const float value = values[i];
      lowest[i] = value < lowest[i] ? value : lowest[i];
      highest[i] = value > highest[i] ? value : highest[i];
      zeros[i] += value == 0.0F;
      ones[i] += value == 1.0F;
    }
  }

  void add_to(std::vector<Limits>& all) {
    for (std::size_t i = 0; i < least.size(); ++i) {
      Limits& channel = all[i % all.size()];
      channel.least = std::min(channel.least, least[i]);
      channel.most = std::max(channel.most, most[i]);
      channel.at_0 += static_cast<std::size_t>(at_0[i]);
      channel.at_1 += static_cast<std::size_t>(at_1[i]);
    }
    std::fill(at_0.begin(), at_0.end(), 0);
    std::fill(at_1.begin(), at_1.end(), 0);
  }

  std::vector<float> least, most;
  std::vector<std::int32_t> at_0, at_1;
};

}  // namespace

std::vector<Limits> find_limits(const float* values, std::size_t count, std::size_t channels) {
  std::vector<Limits> all(channels, {infinity, -infinity, 0, 0});
  const std::size_t size = group * channels, total = count * channels;
  Places places(size);
  std::size_t looked = 0;
  for (std::size_t first = 0; first < total; first += size) {
    places.look_at(values + first, std::min(size, total - first));
    if (++looked % groups_per_sum == 0) places.add_to(all);
  }
  if (channels > 0) places.add_to(all);
  return all;
}

void interpolate(std::span<const float> places, std::span<const double> at, std::span<const double> table, float* values) {
  const std::size_t last = at.size() - 1;
  const double steps = static_cast<double>(last) / (at[last] - at[0]);
  for (std::size_t i = 0; i < places.size(); ++i) {
    const double place = std::clamp(static_cast<double>(places[i]), at[0], at[last]);
    std::size_t k = std::min(last - 1, static_cast<std::size_t>((place - at[0]) * steps));
    // Rounding may lead to an interval beside the one that holds the place.
    k -= k > 0 && place < at[k] ? 1 : 0;
    k += k + 2 <= last && place >= at[k + 1] ? 1 : 0;
    const double slope = (table[k + 1] - table[k]) / (at[k + 1] - at[k]);
    values[i] = static_cast<float>(slope * (place - at[k]) + table[k]);
  }
}

}  // namespace beltrami::colours
