// Compiled once for each instruction set, see instruction_set.hpp.
#include <algorithm>
#include <array>
#include <bit>

#include "lanes.hpp"
#include "patches/surface_patches.hpp"

namespace beltrami::patches::BELTRAMI_VARIANT {
namespace {

using namespace beltrami::lanes::BELTRAMI_VARIANT;

// Floats that are compared at a time: rows of patches have a multiple of them.
constexpr std::size_t width = 16;

// The groups that start in a part. A row of a patch has all nodes of the first channel, then of the next.
class Groups {
 public:
  Groups(const Part& part, const Colours& colours, bool has_pilot, PartSums& to, PartScratch& scratch)
      : part_(part), colours_(colours), has_pilot_(has_pilot), to_(to), scratch_(scratch), n_(colours.channels),
        length_((n_ * nodes + width - 1) / width * width) {}

  void sum(std::span<const Nodes> patches) {
    find_members(patches);
    mix();
    describe();
    to_.sums.assign(to_.members.size() * n_, {0, 0});
    for (std::size_t i = 0; i + 1 < part_.first.size(); ++i) {
      const std::size_t count = has_pilot_ ? part_.first[i + 1] - part_.first[i] : part_.without_pilot[i];
      choose(std::span(part_.candidates).subspan(part_.first[i], count));
      estimate();
    }
    add_to_members();
    for (const std::int32_t member : to_.members) scratch_.numbers[static_cast<std::size_t>(member)] = -1;
  }

 private:
  // Numbers the vertices of patches.
  void find_members(std::span<const Nodes> patches) {
    scratch_.numbers.resize(patches.size(), -1);
    to_.members.clear();
    scratch_.patches.resize(part_.vertices.size());
    std::int32_t* numbers = scratch_.numbers.data();
    for (std::size_t i = 0; i < part_.vertices.size(); ++i) {
      const Nodes& patch = patches[static_cast<std::size_t>(part_.vertices[i])];
      Nodes& members = scratch_.patches[i];
      for (std::size_t node = 0; node < nodes; ++node) {
        members[node] = -1;
        if (patch[node] < 0) continue;
        std::int32_t& number = numbers[patch[node]];
        if (number < 0) {
          number = static_cast<std::int32_t>(to_.members.size());
          to_.members.push_back(patch[node]);
        }
        members[node] = number;
      }
    }
  }

  void mix() {
    const std::size_t count = to_.members.size();
    scratch_.noisy.resize(n_ * count);
    scratch_.pilot.resize(n_ * count);
    scratch_.relative.resize(colours_.relative != nullptr ? count : 0);
    for (std::size_t i = 0; i < scratch_.relative.size(); ++i) scratch_.relative[i] = colours_.relative[to_.members[i]];
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t row = static_cast<std::size_t>(to_.members[i]) * n_;
      for (std::size_t to = 0; to < n_; ++to) {
        float noisy = 0, pilot = 0;
        for (std::size_t from = 0; from < n_; ++from) {
          noisy += colours_.mixing.forth[to * n_ + from] * colours_.noisy[row + from];
          pilot += colours_.mixing.forth[to * n_ + from] * colours_.pilot[row + from];
        }
        scratch_.noisy[i * n_ + to] = noisy;
        scratch_.pilot[i * n_ + to] = pilot;
      }
    }
  }

  // Writes rows of patches; nodes without a vertex are far from all colours.
  void describe() {
    const std::size_t count = part_.vertices.size();
    // Of the last channel `short_row` values are read too.
    for (auto* rows : {&scratch_.noisy_rows, &scratch_.pilot_rows, &scratch_.sum_rows})
      rows->assign(count * length_ + short_row, 0);
    scratch_.weights.assign(count * n_, 0);
    scratch_.is_chosen.assign(count, 0);
    for (std::size_t i = 0; i < count; ++i)
      for (std::size_t c = 0; c < n_; ++c) {
        const std::size_t row = i * length_ + c * nodes;
        float *noisy = scratch_.noisy_rows.data() + row, *pilot = scratch_.pilot_rows.data() + row;
        for (std::size_t node = 0; node < nodes; ++node) {
          const std::int32_t member = scratch_.patches[i][node];
          const std::size_t from = static_cast<std::size_t>(std::max(member, 0)) * n_ + c;
          noisy[node] = scratch_.noisy[from];
          pilot[node] = member < 0 ? far_away : scratch_.pilot[from];
        }
      }
  }

  // Chooses the candidates most similar to the first in the pilot, with vertices at all of its nodes.
  void choose(std::span<const std::int32_t> candidates) {
    Group& group = scratch_.group;
    group.size = has_pilot_ ? medium : few;
    group.length = short_row;
    group.count = 0;
    scratch_.compared.assign(length_, 0);
    is_there_.fill(0);
    for (std::size_t node = 0; node < nodes; ++node) {
      if (scratch_.patches[static_cast<std::size_t>(candidates[0])][node] < 0) continue;
      is_there_[node] = 1;
      group.used[group.count++] = static_cast<std::uint8_t>(node);
      for (std::size_t c = 0; c < n_; ++c) scratch_.compared[c * nodes + node] = 1;
    }
    auto& keys = scratch_.keys;
    keys.clear();
    // Positive floats order like their bits.
    for (std::size_t k = 1; k < candidates.size(); ++k)
      if (const float distance = distance_between(candidates[0], candidates[k]); distance < too_far)
        keys.push_back(std::uint64_t{std::bit_cast<std::uint32_t>(distance)} << 32 | k);
    const std::size_t others = std::min(group.size - 1, keys.size());
    if (others < keys.size()) std::nth_element(keys.begin(), keys.begin() + static_cast<std::ptrdiff_t>(others), keys.end());
    group.found = others + 1;
    chosen_[0] = static_cast<std::size_t>(candidates[0]);
    for (std::size_t k = 0; k < others; ++k) chosen_[k + 1] = static_cast<std::size_t>(candidates[keys[k] & 0xFFFFFFFF]);
    for (std::size_t k = 0; k < group.found; ++k) scratch_.is_chosen[chosen_[k]] = 1;
  }

  // The sum of squared differences between two patches of the pilot at the compared nodes.
  float distance_between(std::int32_t a, std::int32_t b) const {
    const float* one = scratch_.pilot_rows.data() + static_cast<std::size_t>(a) * length_;
    const float* other = scratch_.pilot_rows.data() + static_cast<std::size_t>(b) * length_;
    std::array<Lanes, width / lane_count> sums{};
    for (std::size_t i = 0; i < length_; i += width)
      for (std::size_t v = 0; v < sums.size(); ++v) {
        const std::size_t at = i + v * lane_count;
        const Lanes difference = (load(other + at) - load(one + at)) * load(scratch_.compared.data() + at);
        sums[v] += difference * difference;
      }
    // As many partial sums for any number of lanes.
    alignas(64) std::array<float, width> partial;
    for (std::size_t v = 0; v < sums.size(); ++v) store(partial.data() + v * lane_count, sums[v]);
    for (std::size_t half = width / 2; half > 0; half /= 2)
      for (std::size_t i = 0; i < half; ++i) partial[i] += partial[i + half];
    return partial[0];
  }

  // Adds the estimates of the group to the sums of its patches.
  void estimate() {
    Group& group = scratch_.group;
    group.least_ratio = colours_.mixing.least_ratio;
    group.strength = colours_.mixing.strength;
    for (std::size_t channel = 0; channel < n_; ++channel) {
      const float* pilot = scratch_.pilot_rows.data() + channel * nodes;
      float mean = 0;
      for (std::size_t p = 0; p < group.count; ++p) mean += pilot[chosen_[0] * length_ + group.used[p]];
      mean /= static_cast<float>(group.count);
      group.shrinkage = colours_.mixing.shrinkage[channel];
      for (std::size_t k = 0; k < group.found; ++k) group.energy[k] = energy_of(k) * colours_.mixing.variances[channel];
      read_patches(scratch_.noisy_rows.data() + channel * nodes, mean, group.noisy.data());
      if (has_pilot_) read_patches(pilot, mean, group.pilot.data());
      estimate_group(group, has_pilot_);
      add_patches(mean, scratch_.sum_rows.data() + channel * nodes);
      for (std::size_t k = 0; k < group.found; ++k) add_weight(k, channel);
    }
  }

  // The variance of the noise in a patch, in units of that of a sample.
  float energy_of(std::size_t k) const {
    const Group& group = scratch_.group;
    if (scratch_.relative.empty()) return static_cast<float>(group.count);
    float total = 0;
    for (std::size_t p = 0; p < group.count; ++p)
      total += scratch_.relative[static_cast<std::size_t>(scratch_.patches[chosen_[k]][group.used[p]])];
    return total;
  }

  // Reads a channel of the chosen patches: their differences from `mean`, or 0 at missing nodes.
  void read_patches(const float* channel, float mean, float* patches) const {
    for (std::size_t k = 0; k < scratch_.group.found; ++k)
      for (std::size_t at = 0; at < short_row; at += lane_count)
        store(patches + k * short_row + at, (load(channel + chosen_[k] * length_ + at) - mean) * load(is_there_.data() + at));
  }

  // Adds weighted estimates to a channel of the chosen patches. Sums at missing nodes are written unchanged.
  void add_patches(float mean, float* channel) const {
    const Group& group = scratch_.group;
    for (std::size_t k = 0; k < group.found; ++k)
      for (std::size_t at = 0; at < short_row; at += lane_count) {
        const Lanes estimate = load(group.estimates.data() + k * short_row + at) + mean;
        float* sum = channel + chosen_[k] * length_ + at;
        store(sum, load(sum) + estimate * load(is_there_.data() + at) * group.weights[k]);
      }
  }

  // Weights of whole patches are added once, not at each node.
  void add_weight(std::size_t k, std::size_t channel) {
    const Group& group = scratch_.group;
    if (group.count == nodes) {
      scratch_.weights[chosen_[k] * n_ + channel] += group.weights[k];
      return;
    }
    for (std::size_t p = 0; p < group.count; ++p) {
      const auto member = static_cast<std::size_t>(scratch_.patches[chosen_[k]][group.used[p]]);
      to_.sums[member * n_ + channel][1] += group.weights[k];
    }
  }

  void add_to_members() {
    for (std::size_t i = 0; i < scratch_.patches.size(); ++i) {
      if (!scratch_.is_chosen[i]) continue;
      for (std::size_t c = 0; c < n_; ++c) {
        const float *row = scratch_.sum_rows.data() + i * length_ + c * nodes, weight = scratch_.weights[i * n_ + c];
        for (std::size_t node = 0; node < nodes; ++node) {
          if (scratch_.patches[i][node] < 0) continue;
          auto& [estimate, total] = to_.sums[static_cast<std::size_t>(scratch_.patches[i][node]) * n_ + c];
          estimate += row[node];
          total += weight;
        }
      }
    }
  }

  const Part& part_;
  const Colours& colours_;
  bool has_pilot_;
  PartSums& to_;
  PartScratch& scratch_;
  std::size_t n_, length_;                    // channels, and values in a row of a patch
  std::array<std::size_t, medium> chosen_;    // of the group: candidates, `group.found` of them
  std::array<float, short_row> is_there_{};   // of the group: 1 at nodes with a vertex, else 0
};

}  // namespace

void sum_part(std::span<const Nodes> patches, const Part& part, const Colours& colours, bool has_pilot, PartSums& to,
              PartScratch& scratch) {
  Groups(part, colours, has_pilot, to, scratch).sum(patches);
}

}  // namespace beltrami::patches::BELTRAMI_VARIANT
