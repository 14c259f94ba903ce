#include <algorithm>
#include <bit>
#include <span>
#include <vector>

#include "patches/patch_rows.hpp"
#include "patches/surface_patches.hpp"

namespace beltrami::patches {
namespace {

// Number of parts whose sums are added at a time.
constexpr std::size_t parts_in_wave = 32;

struct Variant {
  EstimateGroup estimate_group;
  CompareRows compare_rows;
  TakeRows take_rows;
  AddRows add_rows;
};

// Values per row of a patch, a multiple of those compared at a time.
std::size_t row_length(std::size_t channels) { return (channels * nodes + 15) / 16 * 16; }

// Sums of a part's groups, with vertices renumbered so that little memory is accessed at a time.
struct PartSums {
  std::vector<std::int32_t> members;
  std::vector<std::array<float, 2>> sums;  // of estimates and of their weights, a row of channels a member

  // Adds the sums to the sums of the whole surface, which have a row per vertex.
  void add_to(const Sums& whole, std::size_t channels) const {
    for (std::size_t i = 0; i < members.size(); ++i)
      for (std::size_t c = 0; c < channels; ++c) {
        const std::size_t to = static_cast<std::size_t>(members[i]) * channels + c;
        const auto [estimate, weight] = sums[i * channels + c];
        whole.estimates[to] += estimate;
        whole.weights[to] += weight;
      }
  }
};

}  // namespace

// Processes one part after another; one object per thread.
class SurfacePatches::Worker {
 public:
  void run(const SurfacePatches& surface, const Colours& colours, bool has_pilot, const Part& part, const Variant& variant,
           PartSums& to) {
    find_members(surface, part.vertices, to.members);
    mix(colours, to.members);
    describe(colours, part.vertices.size());
    to.sums.assign(to.members.size() * colours.channels, {0, 0});
    for (std::size_t i = 0; i + 1 < part.first.size(); ++i) {
      const std::size_t count = has_pilot ? part.first[i + 1] - part.first[i] : part.without_pilot[i];
      const auto candidates = std::span(part.candidates).subspan(part.first[i], count);
      choose(candidates, has_pilot ? medium : few, colours.channels, variant);
      estimate(colours, has_pilot, variant, to);
    }
    add_to_members(colours.channels, to);
    for (const std::int32_t member : to.members) number_[static_cast<std::size_t>(member)] = -1;
  }

 private:
  using Numbers = Nodes;  // of members

  // Numbers the vertices of patches.
  void find_members(const SurfacePatches& surface, std::span<const std::int32_t> vertices, std::vector<std::int32_t>& members) {
    number_.resize(surface.patches_.size(), -1);
    members.clear();
    patches_.resize(vertices.size());
    std::int32_t* numbers = number_.data();
    for (std::size_t i = 0; i < vertices.size(); ++i) {
      const Nodes& patch = surface.patches_[static_cast<std::size_t>(vertices[i])];
      Numbers& patch_members = patches_[i];
      for (std::size_t node = 0; node < nodes; ++node) {
        patch_members[node] = -1;
        if (patch[node] < 0) continue;
        std::int32_t& number = numbers[patch[node]];
        if (number < 0) {
          number = static_cast<std::int32_t>(members.size());
          members.push_back(patch[node]);
        }
        patch_members[node] = number;
      }
    }
  }

  void mix(const Colours& colours, const std::vector<std::int32_t>& members) {
    const std::size_t n = colours.channels, count = members.size();
    noisy_.resize(n * count);
    pilot_.resize(n * count);
    relative_.resize(colours.relative != nullptr ? count : 0);
    for (std::size_t i = 0; i < relative_.size(); ++i) relative_[i] = colours.relative[members[i]];
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t row = static_cast<std::size_t>(members[i]) * n;
      for (std::size_t to = 0; to < n; ++to) {
        float noisy = 0, pilot = 0;
        for (std::size_t from = 0; from < n; ++from) {
          noisy += colours.mixing.forth[to * n + from] * colours.noisy[row + from];
          pilot += colours.mixing.forth[to * n + from] * colours.pilot[row + from];
        }
        noisy_[i * n + to] = noisy;
        pilot_[i * n + to] = pilot;
      }
    }
  }

  // Writes rows of patches; nodes without a vertex are far from all colours.
  void describe(const Colours& colours, std::size_t count) {
    const std::size_t n = colours.channels;
    length_ = row_length(n);
    // Of the last channel `short_row` values are read too.
    for (auto* rows : {&noisy_rows_, &pilot_rows_, &sum_rows_}) rows->assign(count * length_ + short_row, 0);
    weights_.assign(count * n, 0);
    is_chosen_.assign(count, false);
    for (std::size_t i = 0; i < count; ++i) {
      const Numbers patch_members = patches_[i];
      for (std::size_t c = 0; c < n; ++c) {
        const float *noisy = noisy_.data() + c, *pilot = pilot_.data() + c;
        float *noisy_row = noisy_rows_.data() + i * length_ + c * nodes, *pilot_row = pilot_rows_.data() + i * length_ + c * nodes;
        for (std::size_t node = 0; node < nodes; ++node) {
          const std::size_t from = static_cast<std::size_t>(std::max(patch_members[node], 0)) * n;
          noisy_row[node] = noisy[from];
          pilot_row[node] = patch_members[node] < 0 ? far_away : pilot[from];
        }
      }
    }
  }

  // Finds the candidates most similar to the first in the pilot, with vertices at all of its nodes.
  void choose(std::span<const std::int32_t> candidates, std::size_t size, std::size_t channels, const Variant& variant) {
    const Numbers& patch_members = patches_[static_cast<std::size_t>(candidates[0])];
    compared_.assign(length_, 0);
    node_mask_.fill(0);
    group_.count = 0;
    for (std::size_t node = 0; node < nodes; ++node) {
      if (patch_members[node] < 0) continue;
      node_mask_[node] = 1;
      group_.used[group_.count++] = static_cast<std::uint8_t>(node);
      for (std::size_t c = 0; c < channels; ++c) compared_[c * nodes + node] = 1;
    }
    distances_.resize(candidates.size());
    variant.compare_rows(pilot_rows_.data(), length_, compared_.data(), candidates, distances_.data());
    keys_.clear();
    // Positive floats order like their bits.
    for (std::size_t k = 1; k < candidates.size(); ++k)
      if (distances_[k] < too_far) keys_.push_back(std::uint64_t{std::bit_cast<std::uint32_t>(distances_[k])} << 32 | k);
    const std::size_t others = std::min(size - 1, keys_.size());
    const auto wanted = keys_.begin() + static_cast<std::ptrdiff_t>(others);
    if (others < keys_.size()) std::nth_element(keys_.begin(), wanted, keys_.end());
    chosen_.assign(1, static_cast<std::size_t>(candidates[0]));
    for (auto key = keys_.begin(); key != wanted; ++key)
      chosen_.push_back(static_cast<std::size_t>(candidates[*key & 0xFFFFFFFF]));
    group_.size = size;
    group_.length = short_row;
    group_.found = chosen_.size();
    rows_.clear();
    for (const std::size_t patch : chosen_) {
      rows_.push_back(patch * length_);
      is_chosen_[patch] = true;
    }
  }

  // Adds the estimates of the group to the sums of its patches.
  void estimate(const Colours& colours, bool has_pilot, const Variant& variant, PartSums& to) {
    const auto count = static_cast<float>(group_.count);
    group_.least_ratio = colours.mixing.least_ratio;
    group_.strength = colours.mixing.strength;
    for (std::size_t channel = 0; channel < colours.channels; ++channel) {
      const float *noisy = noisy_rows_.data() + channel * nodes, *pilot = pilot_rows_.data() + channel * nodes;
      float mean = 0;
      for (std::size_t p = 0; p < group_.count; ++p) mean += pilot[rows_[0] + group_.used[p]];
      mean /= count;
      group_.shrinkage = colours.mixing.shrinkage[channel];
      for (std::size_t k = 0; k < group_.found; ++k) group_.energy[k] = energy_of(k) * colours.mixing.variances[channel];
      variant.take_rows(noisy, rows_, node_mask_, mean, group_.noisy.data());
      variant.take_rows(pilot, rows_, node_mask_, mean, group_.pilot.data());
      variant.estimate_group(group_, has_pilot);
      variant.add_rows(group_, rows_, node_mask_, mean, sum_rows_.data() + channel * nodes);
      for (std::size_t k = 0; k < group_.found; ++k) add_weight(k, channel, colours.channels, to);
    }
  }

  // The variance of the noise in a patch, in units of that of a sample.
  float energy_of(std::size_t k) const {
    if (relative_.empty()) return static_cast<float>(group_.count);
    float total = 0;
    for (std::size_t p = 0; p < group_.count; ++p) total += relative_[static_cast<std::size_t>(patches_[chosen_[k]][group_.used[p]])];
    return total;
  }

  // Weights of whole patches are added once, not at each node.
  void add_weight(std::size_t k, std::size_t channel, std::size_t channels, PartSums& to) {
    const std::size_t patch = chosen_[k];
    if (group_.count == nodes) {
      weights_[patch * channels + channel] += group_.weights[k];
      return;
    }
    for (std::size_t p = 0; p < group_.count; ++p)
      to.sums[static_cast<std::size_t>(patches_[patch][group_.used[p]]) * channels + channel][1] += group_.weights[k];
  }

  void add_to_members(std::size_t channels, PartSums& to) const {
    for (std::size_t i = 0; i < patches_.size(); ++i) {
      if (!is_chosen_[i]) continue;
      const Numbers& patch_members = patches_[i];
      for (std::size_t c = 0; c < channels; ++c) {
        std::array<float, 2>* sums = to.sums.data() + c;
        const float *row = sum_rows_.data() + i * length_ + c * nodes, weight = weights_[i * channels + c];
        for (std::size_t node = 0; node < nodes; ++node) {
          if (patch_members[node] < 0) continue;
          auto& [estimate, total] = sums[static_cast<std::size_t>(patch_members[node]) * channels];
          estimate += row[node];
          total += weight;
        }
      }
    }
  }

  std::vector<std::int32_t> number_;
  std::vector<Numbers> patches_;           // of the candidates of a part
  std::vector<float> noisy_, pilot_, relative_;  // of members
  // For candidates: values and sums of estimates at all nodes, and sums of weights.
  std::vector<float> noisy_rows_, pilot_rows_, sum_rows_, weights_;
  std::vector<bool> is_chosen_;
  std::size_t length_ = 0;
  std::vector<float> compared_, distances_;
  std::vector<std::uint64_t> keys_;
  std::vector<std::size_t> chosen_, rows_;
  NodeMask node_mask_{};
  Group group_{};
};

void SurfacePatches::collaborate(const Colours& colours, bool has_pilot, const Sums& sums, unsigned threads,
                                 const Poll& poll) const {
  const InstructionSet set = choose_instruction_set();
  const Variant variant{BELTRAMI_VARIANT_OF(estimate_group, set), BELTRAMI_VARIANT_OF(compare_rows, set),
                        BELTRAMI_VARIANT_OF(take_rows, set), BELTRAMI_VARIANT_OF(add_rows, set)};
  const std::size_t n = colours.channels, count = patches_.size(), parts = parts_.size();
  std::vector<PartSums> wave(std::min(parts, parts_in_wave));
  std::vector<Worker> workers(std::max(1U, threads));
  for (std::size_t first = 0; first < parts; first += wave.size()) {
    const std::size_t here = std::min(wave.size(), parts - first);
    const Poll counted = poll ? Poll([&](std::size_t done) { return poll((first + done) * count / parts); }) : Poll();
    parallel_chunks(
        here, 1, threads,
        [&](std::size_t begin, std::size_t end, unsigned worker) {
          for (std::size_t i = begin; i < end; ++i)
            workers[worker].run(*this, colours, has_pilot, parts_[first + i], variant, wave[i]);
        },
        counted);
    // In the order of the parts, so that sums do not depend on the threads.
    for (std::size_t i = 0; i < here; ++i) wave[i].add_to(sums, n);
  }
}

}  // namespace beltrami::patches
