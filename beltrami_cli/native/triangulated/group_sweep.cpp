// Compiled several times, with BELTRAMI_VARIANT naming the namespace and the compiler's flags the instruction set.
// Contraction to fused multiply-add is off for all, so that every variant gives the same bits.
#include "triangulated/group_sweep.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "parametric/lanes.hpp"
#include "triangulated/vertex_groups.hpp"

namespace beltrami::triangulated::BELTRAMI_VARIANT {
namespace {

using namespace beltrami::parametric::BELTRAMI_VARIANT;

constexpr std::size_t parts = group_size / lane_count;

// One bit for every lane in which a < b.
inline std::uint32_t where_smaller(Lanes a, Lanes b) {
#if defined(__AVX512F__)
  return _mm512_cmp_ps_mask(reinterpret_cast<__m512>(a), reinterpret_cast<__m512>(b), _CMP_LT_OQ);
#elif defined(__AVX__)
  return static_cast<std::uint32_t>(
      _mm256_movemask_ps(_mm256_cmp_ps(reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b), _CMP_LT_OQ)));
#elif defined(__SSE__)
  return static_cast<std::uint32_t>(_mm_movemask_ps(_mm_cmplt_ps(reinterpret_cast<__m128>(a), reinterpret_cast<__m128>(b))));
#else
  const Mask mask = a < b;
  std::uint32_t bits = 0;
  for (std::size_t i = 0; i < lane_count; ++i) bits |= mask[i] != 0 ? 1U << i : 0U;
  return bits;
#endif
}

class Group {
 public:
  Group(const GroupJob& job, std::span<const Index> sources, std::span<const Index> region, GroupScratch& scratch)
      : job_(job), sources_(sources), region_(region), scratch_(scratch),
        beyond_(std::nextafter(job.parameters.radius, std::numeric_limits<float>::infinity())) {}

  KernelStatistics run() {
    begin();
    find_distances();
    for (const Index vertex : region_) scratch_.place[static_cast<std::size_t>(vertex)] = 0;
    const KernelStatistics statistics = find_kernels();
    average();
    return statistics;
  }

 private:
  float* row(std::size_t place) { return scratch_.lanes.data() + place * group_size; }

  // Distances that are not known stand just beyond the radius, so that no path leads further.
  void begin() {
    const std::size_t size = region_.size();
    if (scratch_.lanes.size() < size * group_size) scratch_.lanes.resize(size * group_size);
    std::fill_n(scratch_.lanes.begin(), size * group_size, beyond_);
    scratch_.changed.assign(size, 0);
    scratch_.steps_of.assign(size, {0, 0});
    steps_end_ = 0;
    for (std::size_t i = 0; i < size; ++i) {
      scratch_.place[static_cast<std::size_t>(region_[i])] = static_cast<std::uint16_t>(i + 1);
      prefetch(region_[i]);
    }
    for (std::size_t lane = 0; lane < sources_.size(); ++lane) {
      const std::size_t place = scratch_.place[static_cast<std::size_t>(sources_[lane])] - 1U;
      row(place)[lane] = 0;
      scratch_.changed[place] = 1;
    }
  }

  // The lists of segments from a vertex are about to be read.
  void prefetch([[maybe_unused]] Index vertex) const {
#if defined(__GNUC__)
    const std::uint64_t* offset = job_.segments->offsets.data() + vertex;
    for (std::uint64_t i = offset[0]; i < offset[1]; i += 64 / sizeof(Segment))
      __builtin_prefetch(job_.segments->from.data() + i);
#endif
  }

  // Passes changes on, vertex by vertex, until there are none: then every distance is that of the shortest path, whatever
  // the order, as sums along a path are rounded in the same way for all.
  void find_distances() {
    for (std::size_t place = std::min(region_.size(), group_size); place-- > 0;) pass_on(place);
    for (bool any = true; any;) {
      any = false;
      for (std::size_t place = 0; place < region_.size(); ++place) any |= pass_on(place);
    }
  }

  bool pass_on(std::size_t place) {
    if (std::exchange(scratch_.changed[place], 0U) == 0) return false;
    GroupScratch::Steps& steps = scratch_.steps_of[place];
    if (steps.end == 0) steps = list_steps(region_[place]);
    float* lanes = scratch_.lanes.data();
    std::uint32_t* changed = scratch_.changed.data();
    std::array<Lanes, parts> here;
    for (std::size_t part = 0; part < parts; ++part) here[part] = load(row(place) + part * lane_count);
    const GroupScratch::Step* last = scratch_.steps.data() + steps.end;
    for (const GroupScratch::Step* step = scratch_.steps.data() + steps.begin; step != last; ++step) {
      float* target = lanes + step->place * group_size;
      std::uint32_t nearer = 0;
      for (std::size_t part = 0; part < parts; ++part) {
        const Lanes before = load(target + part * lane_count), through = here[part] + step->length;
        nearer |= where_smaller(through, before);
        store(target + part * lane_count, smaller(through, before));
      }
      changed[step->place] |= nearer;
    }
    return true;
  }

  // The segments from a vertex that stay in the region and are straight; without branches, as that is hard to predict.
  GroupScratch::Steps list_steps(Index vertex) {
    const Segments& segments = *job_.segments;
    const Segment* first = segments.from.data() + segments.offsets[static_cast<std::size_t>(vertex)];
    const Segment* last = segments.from.data() + segments.offsets[static_cast<std::size_t>(vertex) + 1];
    const std::uint32_t begin = steps_end_;
    const auto most = begin + static_cast<std::size_t>(last - first);
    if (scratch_.steps.size() < most) scratch_.steps.resize(2 * most);
    GroupScratch::Step* next = scratch_.steps.data() + begin;
    const std::uint16_t* places = scratch_.place.data();
    const float beyond = beyond_;
    for (const Segment* segment = first; segment != last; ++segment) {
      const std::uint32_t place = places[static_cast<std::size_t>(segment->target)];
      *next = {place - 1, segment->length};
      next += static_cast<std::ptrdiff_t>((place != 0) & (segment->length < beyond));
    }
    steps_end_ = static_cast<std::uint32_t>(next - scratch_.steps.data());
    return {begin, steps_end_};
  }

  // Turns distances into kernel values, K = exp(-d^2 / 4 t), and lists the places that any kernel holds.
  KernelStatistics find_kernels() {
    const float factor = -1 / (4 * job_.parameters.time_step);
    std::array<float, group_size> counts{};
    scratch_.held.clear();
    for (std::size_t place = 0; place < region_.size(); ++place) {
      std::uint32_t within = 0;
      for (std::size_t part = 0; part < parts; ++part)
        within |= where_smaller(load(row(place) + part * lane_count), splat(beyond_));
      if (within != 0) scratch_.held.push_back(static_cast<std::uint32_t>(place));
    }
    for (std::size_t part = 0; part < parts; ++part) {
      Lanes held{};
      for (const std::uint32_t place : scratch_.held)
        held += select(load(row(place) + part * lane_count) < splat(beyond_), splat(1), Lanes{});
      store(counts.data() + part * lane_count, held);
    }
    KernelStatistics statistics;
    const auto most = static_cast<float>(job_.parameters.max_samples);
    for (std::size_t lane = 0; lane < sources_.size(); ++lane) {
      if (counts[lane] > most) {
        cut_short(lane);
        ++statistics.truncated;
        counts[lane] = most;
      }
      statistics.samples += static_cast<std::int64_t>(counts[lane]);
    }
    for (const std::uint32_t place : scratch_.held)
      for (std::size_t part = 0; part < parts; ++part) {
        float* values = row(place) + part * lane_count;
        const Lanes distance = load(values);
        Lanes kernel = select(distance < splat(beyond_), exponential(distance * distance * factor), Lanes{});
        if (job_.weights != nullptr) kernel = kernel * job_.weights[region_[place]];
        store(values, kernel);
      }
    return statistics;
  }

  // Leaves max_samples of a lane's samples, the source and those nearest to it.
  void cut_short(std::size_t lane) {
    std::vector<std::pair<float, Index>> order;
    for (const std::uint32_t place : scratch_.held)
      if (row(place)[lane] < beyond_)
        order.emplace_back(region_[place] == sources_[lane] ? -1 : row(place)[lane], region_[place]);
    const auto last = order.begin() + static_cast<std::ptrdiff_t>(job_.parameters.max_samples);
    std::nth_element(order.begin(), last, order.end());
    for (const std::uint32_t place : scratch_.held)
      if (region_[place] != sources_[lane] && !(std::pair(row(place)[lane], region_[place]) < *last))
        row(place)[lane] = beyond_;
  }

  // Averages differences from the sources, so that a constant is a fixed point to the last bit.
  void average() {
    alignas(64) std::array<float, group_size> totals{}, centres{}, changes{};
    for (std::size_t part = 0; part < parts; ++part) {
      Lanes total{};
      for (const std::uint32_t place : scratch_.held) total += load(row(place) + part * lane_count);
      store(totals.data() + part * lane_count, total);
    }
    for (std::size_t channel = 0; channel < job_.colours.width; ++channel) {
      for (std::size_t lane = 0; lane < sources_.size(); ++lane) centres[lane] = job_.colours[sources_[lane]][channel];
      // Rounding must not take a colour out of the range of those that it is an average of.
      float low = centres[0], high = centres[0];
      std::array<Lanes, parts> sums{}, centre;
      for (std::size_t part = 0; part < parts; ++part) centre[part] = load(centres.data() + part * lane_count);
      for (const std::uint32_t place : scratch_.held) {
        const float colour = job_.colours[region_[place]][channel];
        low = std::min(low, colour);
        high = std::max(high, colour);
        for (std::size_t part = 0; part < parts; ++part)
          sums[part] += load(row(place) + part * lane_count) * (splat(colour) - centre[part]);
      }
      for (std::size_t part = 0; part < parts; ++part) store(changes.data() + part * lane_count, sums[part]);
      for (std::size_t lane = 0; lane < sources_.size(); ++lane) {
        const float change = totals[lane] > 0 ? changes[lane] / totals[lane] : 0;
        job_.smoothed[static_cast<std::size_t>(sources_[lane]) * job_.colours.width + channel] =
            std::clamp(centres[lane] + change, low, high);
      }
    }
  }

  const GroupJob& job_;
  std::span<const Index> sources_, region_;
  GroupScratch& scratch_;
  float beyond_;
  std::uint32_t steps_end_ = 0;
};

}  // namespace

KernelStatistics sweep_group(const GroupJob& job, std::span<const Index> sources, std::span<const Index> region,
                             GroupScratch& scratch) {
  return Group(job, sources, region, scratch).run();
}

}  // namespace beltrami::triangulated::BELTRAMI_VARIANT
