// Compiled several times, with BELTRAMI_VARIANT naming the namespace and the compiler's flags the instruction set.
// Contraction to fused multiply-add is off for all, so that every variant gives the same bits.
#include "triangulated/group_sweep.hpp"

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "triangulated/group_distances.hpp"

namespace beltrami::triangulated::BELTRAMI_VARIANT {
namespace {

// What is left to do once distances are known.
class GroupAverage {
 public:
  GroupAverage(const GroupJob& job, std::span<const Index> sources, GroupScratch& scratch, const GroupDistances& distances)
      : job_(job), sources_(sources), scratch_(scratch), size_(distances.size()), beyond_(distances.beyond()) {}

  KernelStatistics run() {
    const KernelStatistics statistics = find_held();
    find_kernels();
    // Several channels at once, since each sum waits for its last addition.
    std::size_t channel = 0;
    for (; channel + 3 <= job_.colours.width; channel += 3) average<3>(channel);
    for (; channel < job_.colours.width; ++channel) average<1>(channel);
    return statistics;
  }

 private:
  struct alignas(64) Numbers {
    std::array<float, group_size> lane;
  };

  float* row(std::size_t place) { return scratch_.region[place].lane.data(); }
  Index vertex(std::size_t place) const { return scratch_.region[place].vertex; }

  // Lists the places that any kernel holds.
  KernelStatistics find_held() {
    Numbers counts;
    std::array<Lanes, parts> held{};
    scratch_.held.resize(size_);
    std::size_t end = 0;
    for (std::size_t place = 0; place < size_; ++place) {
      std::uint32_t within = 0;
      for (std::size_t part = 0; part < parts; ++part) {
        const Lanes distance = load(row(place) + part * lane_count);
        within |= where_smaller(distance, splat(beyond_));
        held[part] += select(distance < splat(beyond_), splat(1), Lanes{});
      }
      scratch_.held[end] = static_cast<std::uint32_t>(place);
      end += within != 0;
    }
    scratch_.held.resize(end);
    for (std::size_t part = 0; part < parts; ++part) store(counts.lane.data() + part * lane_count, held[part]);
    KernelStatistics statistics;
    const auto most = static_cast<float>(job_.parameters.max_samples);
    for (std::size_t lane = 0; lane < sources_.size(); ++lane) {
      if (counts.lane[lane] > most) {
        cut_short(lane);
        ++statistics.truncated;
        counts.lane[lane] = most;
      }
      statistics.samples += static_cast<std::int64_t>(counts.lane[lane]);
    }
    return statistics;
  }

  // Leaves max_samples of a lane's samples, the source and those nearest to it.
  void cut_short(std::size_t lane) {
    std::vector<std::pair<float, Index>> order;
    for (const std::uint32_t place : scratch_.held)
      if (row(place)[lane] < beyond_)
        order.emplace_back(vertex(place) == sources_[lane] ? -1 : row(place)[lane], vertex(place));
    const auto last = order.begin() + static_cast<std::ptrdiff_t>(job_.parameters.max_samples);
    std::nth_element(order.begin(), last, order.end());
    for (const std::uint32_t place : scratch_.held)
      if (vertex(place) != sources_[lane] && !(std::pair(row(place)[lane], vertex(place)) < *last))
        row(place)[lane] = beyond_;
  }

  // Turns distances into kernel values, K = exp(-d^2 / 4 t), and sums these up.
  void find_kernels() {
    const float factor = -1 / (4 * job_.parameters.time_step);
    std::array<Lanes, parts> sums{};
    for (const std::uint32_t place : scratch_.held)
      for (std::size_t part = 0; part < parts; ++part) {
        float* values = row(place) + part * lane_count;
        const Lanes distance = load(values);
        Lanes kernel = select(distance < splat(beyond_), exponential(distance * distance * factor), Lanes{});
        if (job_.weights != nullptr) kernel = kernel * job_.weights[vertex(place)];
        store(values, kernel);
        sums[part] += kernel;
      }
    for (std::size_t part = 0; part < parts; ++part) store(totals_.lane.data() + part * lane_count, sums[part]);
  }

  // Averages differences from the sources, so that a constant is a fixed point to the last bit.
  template <std::size_t channels>
  void average(std::size_t first) {
    std::array<Numbers, channels> centres{}, changes;
    std::array<float, channels> low, high;
    for (std::size_t c = 0; c < channels; ++c) {
      for (std::size_t lane = 0; lane < sources_.size(); ++lane) centres[c].lane[lane] = job_.colours[sources_[lane]][first + c];
      low[c] = high[c] = centres[c].lane[0];
    }
    for (std::size_t part = 0; part < group_size; part += lane_count) {
      std::array<Lanes, channels> sums{}, centre;
      for (std::size_t c = 0; c < channels; ++c) centre[c] = load(centres[c].lane.data() + part);
      for (const std::uint32_t place : scratch_.held) {
        const float* colours = job_.colours[vertex(place)] + first;
        const Lanes kernel = load(row(place) + part);
        for (std::size_t c = 0; c < channels; ++c) {
          low[c] = std::min(low[c], colours[c]);
          high[c] = std::max(high[c], colours[c]);
          sums[c] += kernel * (splat(colours[c]) - centre[c]);
        }
      }
      for (std::size_t c = 0; c < channels; ++c) store(changes[c].lane.data() + part, sums[c]);
    }
    for (std::size_t lane = 0; lane < sources_.size(); ++lane) {
      float* smoothed = job_.smoothed + static_cast<std::size_t>(sources_[lane]) * job_.colours.width + first;
      for (std::size_t c = 0; c < channels; ++c) {
        const float change = totals_.lane[lane] > 0 ? changes[c].lane[lane] / totals_.lane[lane] : 0;
        // Rounding must not take a colour out of the range of those that it is an average of.
        smoothed[c] = std::clamp(centres[c].lane[lane] + change, low[c], high[c]);
      }
    }
  }

  const GroupJob& job_;
  std::span<const Index> sources_;
  GroupScratch& scratch_;
  std::size_t size_;
  float beyond_;
  Numbers totals_;
};

}  // namespace

std::optional<KernelStatistics> sweep_group(const GroupJob& job, const VertexGroup& group, GroupScratch& scratch) {
  GroupDistances distances(*job.segments, job.parameters.radius, scratch);
  if (!distances.find(group)) return std::nullopt;
  return GroupAverage(job, group.sources, scratch, distances).run();
}

}  // namespace beltrami::triangulated::BELTRAMI_VARIANT
