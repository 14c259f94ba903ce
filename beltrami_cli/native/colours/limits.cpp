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

void interpolate(std::span<float> places, const Table& table) {
  for (float& place : places) place = table(place);
}

}  // namespace beltrami::colours
