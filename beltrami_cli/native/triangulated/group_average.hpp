// Averages by the kernels of one group, from the distances of its sources; compiled once for each instruction set, see
// instruction_set.hpp.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "lanes.hpp"
#include "triangulated/group_sweep.hpp"

namespace beltrami::triangulated::BELTRAMI_VARIANT {

using namespace beltrami::lanes::BELTRAMI_VARIANT;

class GroupAverage {
 public:
  GroupAverage(const GroupJob& job, std::span<const Index> sources, const Region& region, std::vector<Rank>& order)
      : job_(job), sources_(sources), region_(region), order_(order) {}

  KernelStatistics run() {
    const KernelStatistics statistics = find_kernels();
    // Several channels at once, to hide the latency of additions.
    std::size_t channel = 0;
    for (; channel + 3 <= job_.colours.width; channel += 3) average<3>(channel);
    for (; channel < job_.colours.width; ++channel) average<1>(channel);
    return statistics;
  }

 private:
  static constexpr std::size_t parts = group_size / lane_count;
  struct alignas(64) Numbers {
    std::array<float, group_size> lane;
  };

  // Computes the kernels; those with too many samples are truncated and computed again.
  KernelStatistics find_kernels() {
    Numbers counts = evaluate();
    KernelStatistics statistics;
    const auto most = static_cast<float>(job_.parameters.max_samples);
    for (std::size_t lane = 0; lane < sources_.size(); ++lane) {
      if (counts.lane[lane] > most) {
        truncate(lane);
        ++statistics.truncated;
        counts.lane[lane] = most;
      }
      statistics.samples += static_cast<std::int64_t>(counts.lane[lane]);
    }
    if (statistics.truncated > 0) evaluate();
    return statistics;
  }

  // Computes kernel values, K = exp(-d^2 / 4 t), sums them up, and counts the samples of each kernel.
  Numbers evaluate() {
    const float factor = -1 / (4 * job_.parameters.time_step);
    std::array<Lanes, parts> sums{}, samples{};
    for (std::size_t i = 0; i < region_.places.size(); ++i)
      for (std::size_t part = 0; part < parts; ++part) {
        RegionPlace& place = region_.places[i];
        const Lanes distance = load(place.distance.data() + part * lane_count);
        const auto within = distance < splat(region_.beyond);
        Lanes kernel = select(within, exponential(distance * distance * factor), Lanes{});
        if (job_.weights != nullptr) kernel = kernel * job_.weights[region_.vertices[i]];
        store(place.kernel().data() + part * lane_count, kernel);
        sums[part] += kernel;
        samples[part] += select(within, splat(1), Lanes{});
      }
    Numbers counts;
    for (std::size_t part = 0; part < parts; ++part) {
      store(totals_.lane.data() + part * lane_count, sums[part]);
      store(counts.lane.data() + part * lane_count, samples[part]);
    }
    return counts;
  }

  // Keeps max_samples of a lane's samples: the source and those nearest to it.
  void truncate(std::size_t lane) {
    const auto rank = [&](std::size_t i) {
      const Index vertex = region_.vertices[i];
      return Rank(vertex == sources_[lane] ? -1 : region_.places[i].distance[lane], vertex);
    };
    order_.clear();
    for (std::size_t i = 0; i < region_.places.size(); ++i)
      if (region_.places[i].distance[lane] < region_.beyond) order_.push_back(rank(i));
    const auto last = order_.begin() + static_cast<std::ptrdiff_t>(job_.parameters.max_samples);
    std::nth_element(order_.begin(), last, order_.end());
    for (std::size_t i = 0; i < region_.places.size(); ++i)
      if (!(rank(i) < *last)) region_.places[i].distance[lane] = region_.beyond;
  }

  // Averages differences from the sources, so that a constant is preserved exactly.
  template <std::size_t channels>
  void average(std::size_t first) {
    std::array<Numbers, channels> centres{}, averages;
    std::array<float, channels> low, high;
    for (std::size_t c = 0; c < channels; ++c) {
      for (std::size_t lane = 0; lane < sources_.size(); ++lane)
        centres[c].lane[lane] = job_.colours[sources_[lane]][first + c];
      low[c] = high[c] = centres[c].lane[0];
    }
    for (const Index vertex : region_.vertices)
      for (std::size_t c = 0; c < channels; ++c) {
        low[c] = std::min(low[c], job_.colours[vertex][first + c]);
        high[c] = std::max(high[c], job_.colours[vertex][first + c]);
      }
    for (std::size_t part = 0; part < group_size; part += lane_count) {
      std::array<Lanes, channels> sums{}, centre;
      for (std::size_t c = 0; c < channels; ++c) centre[c] = load(centres[c].lane.data() + part);
      for (std::size_t i = 0; i < region_.places.size(); ++i) {
        const float* colours = job_.colours[region_.vertices[i]] + first;
        const Lanes kernel = load(region_.places[i].kernel().data() + part);
        for (std::size_t c = 0; c < channels; ++c) sums[c] += kernel * (splat(colours[c]) - centre[c]);
      }
      const Lanes total = load(totals_.lane.data() + part);
      for (std::size_t c = 0; c < channels; ++c) {
        const Lanes average = centre[c] + select(total > splat(0), sums[c] / total, Lanes{});
        // Rounding must not move an average beyond the range of its colours.
        store(averages[c].lane.data() + part, smaller(larger(average, splat(low[c])), splat(high[c])));
      }
    }
    for (std::size_t lane = 0; lane < sources_.size(); ++lane)
      for (std::size_t c = 0; c < channels; ++c)
        job_.smoothed[static_cast<std::size_t>(sources_[lane]) * job_.colours.width + first + c] = averages[c].lane[lane];
  }

  const GroupJob& job_;
  std::span<const Index> sources_;
  Region region_;
  std::vector<Rank>& order_;
  Numbers totals_;
};

}  // namespace beltrami::triangulated::BELTRAMI_VARIANT
