// Compiled once for each instruction set, see instruction_set.hpp.
#include "triangulated/group_sweep.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "lanes.hpp"

namespace beltrami::triangulated::BELTRAMI_VARIANT {
namespace {

using namespace beltrami::lanes::BELTRAMI_VARIANT;

constexpr std::size_t parts = group_size / lane_count;

// Where the kernels of a group reach more vertices than this, their distances do not fit the caches.
constexpr std::size_t largest_region = 16384;

// Where they reach more than this many times the samples that a kernel may hold, a march that ends at these is faster. Small
// regions are swept at any rate.
constexpr std::size_t reached_for_held = 10, always_swept = 2048;

// Sweeps there and back after which a march is faster.
constexpr int most_sweeps_at_hub = 20;

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

// Distances of the sources of one group, side by side in the lanes.
//
// What does not help: to list the segments within a region once for all iterations, to pass on several vertices at a time
// without branches, to take vertices in the order in which they change. All were slower.
class GroupDistances {
 public:
  GroupDistances(const Segments& segments, const KernelParameters& parameters, GroupScratch& scratch)
      : segments_(segments), scratch_(scratch),
        beyond_(std::nextafter(parameters.radius, std::numeric_limits<float>::infinity())),
        most_(std::clamp(reached_for_held * std::min(parameters.max_samples, largest_region), always_swept, largest_region)) {}

  // Distances that are not known, or beyond the radius, stand just beyond it, so that no path leads further.
  float beyond() const { return beyond_; }
  // How many places the sources reach.
  std::size_t size() const { return size_; }

  // Passes changes on, vertex by vertex, until there are none: then every distance is that of the shortest path, whatever
  // the order, as sums along a path are rounded in the same way for all. Returns false if that takes too long.
  bool find(const VertexGroup& group) {
    reserve(group_size);
    for (std::size_t lane = 0; lane < group.sources.size(); ++lane) {
      add(group.sources[lane]);
      scratch_.region[lane].lane[lane] = 0;
    }
    // What the sources are from each other comes first, or else they would all be passed on twice.
    for (const InnerSegment& segment : group.inner) join(segment);
    bool any = true;
    for (int sweep = 0; any && fits_; ++sweep) {
      any = false;
      for (std::size_t place = 0; place < size_; ++place) any |= pass_on(place);
      // Around a hub distances may run against the order of the places, and then move by one place a sweep.
      if (!any || !at_hub_) continue;
      for (std::size_t place = size_; place-- > 0;) any |= pass_on(place);
      fits_ &= sweep < most_sweeps_at_hub;
    }
    for (std::size_t place = 0; place < size_; ++place) scratch_.place[static_cast<std::size_t>(scratch_.vertices[place])] = 0;
    return fits_;
  }

 private:
  void reserve(std::size_t size) {
    if (scratch_.region.size() >= size) return;
    size = std::max(size, 2 * scratch_.region.size());
    scratch_.region.resize(size);
    scratch_.vertices.resize(size);
  }

  // Gives a vertex a place.
  std::uint32_t add(Index vertex) {
    scratch_.vertices[size_] = vertex;
    RegionPlace& place = scratch_.region[size_++];
    for (std::size_t part = 0; part < group_size; part += lane_count) {
      store(place.lane.data() + part, splat(beyond_));
      store(place.passed.data() + part, splat(beyond_));
    }
    prefetch(vertex);
    return scratch_.place[static_cast<std::size_t>(vertex)] = static_cast<std::uint16_t>(size_);
  }

  // The list of segments from a vertex is about to be read.
  void prefetch([[maybe_unused]] Index vertex) const {
#if defined(__GNUC__)
    const std::uint32_t* offset = segments_.offsets.data() + vertex;
    for (std::uint32_t i = offset[0]; i < offset[1]; i += 64 / sizeof(float)) {
      __builtin_prefetch(segments_.lengths.data() + i);
      __builtin_prefetch(segments_.targets.data() + i);
    }
#endif
  }

  // Passes on distances between two sources, both ways.
  void join(const InnerSegment& segment) {
    const float length = segments_.lengths[segment.place];
    float* one = scratch_.region[segment.from].lane.data();
    float* other = scratch_.region[segment.to].lane.data();
    for (std::size_t part = 0; part < group_size; part += lane_count) {
      const Lanes at_one = load(one + part), at_other = load(other + part);
      store(one + part, smaller(at_other + length, at_one));
      store(other + part, smaller(at_one + length, at_other));
    }
  }

  bool pass_on(std::size_t place) {
    RegionPlace& from = scratch_.region[place];
    std::array<Lanes, parts> here;
    Lanes fallen{};
    std::uint32_t nearer = 0;
    for (std::size_t part = 0; part < parts; ++part) {
      here[part] = load(from.lane.data() + part * lane_count);
      const Lanes passed = load(from.passed.data() + part * lane_count);
      nearer |= where_smaller(here[part], passed);
      const Lanes lower = select(here[part] < passed, here[part], splat(beyond_));
      fallen = part == 0 ? lower : smaller(fallen, lower);
    }
    if (nearer == 0 || !fits_) return false;
    for (std::size_t part = 0; part < parts; ++part) store(from.passed.data() + part * lane_count, here[part]);
    const std::uint32_t* offset = segments_.offsets.data() + scratch_.vertices[place];
    const std::uint32_t begin = offset[0], end = offset[1];
    at_hub_ |= end - begin > most_segments;
    fits_ = size_ + (end - begin) <= most_;
    if (!fits_) return false;
    reserve(size_ + (end - begin));
    // Local copies: for all that the compiler knows, stores might change these pointers.
    RegionPlace* const region = scratch_.region.data();
    const std::uint16_t* const places = scratch_.place.data();
    // A longer segment leads out of all kernels in which the distance has fallen; rounding must not make that of one that
    // does not.
    const float limit = (beyond_ - least_lane(fallen)) * 1.000001F;
    for (std::uint32_t first = begin; first < end; first += 64) {
      const float* lengths = segments_.lengths.data() + first;
      const Index* targets = segments_.targets.data() + first;
      for (std::uint64_t within = find_within(lengths, std::min(end - first, 64U), limit); within != 0; within &= within - 1) {
        const int i = std::countr_zero(within);
        const Index target = targets[i];
        const float length = lengths[i];
        std::size_t number = places[target];
        if (number == 0) number = add(target);
        float* distances = region[number - 1].lane.data();
        for (std::size_t part = 0; part < group_size; part += lane_count)
          store(distances + part, smaller(here[part / lane_count] + length, load(distances + part)));
      }
    }
    return true;
  }

  // One bit for each of up to 64 lengths that is below the limit.
  static std::uint64_t find_within(const float* lengths, std::uint32_t count, float limit) {
    std::uint64_t within = 0;
    for (std::uint32_t k = 0; k < count; k += lane_count)
      within |= std::uint64_t{where_smaller(load(lengths + k), splat(limit))} << k;
    return within & ~std::uint64_t{0} >> (64 - count);
  }

  const Segments& segments_;
  GroupScratch& scratch_;
  float beyond_;
  std::size_t most_;  // places
  std::size_t size_ = 0;
  bool fits_ = true, at_hub_ = false;
};

// The averages, once distances are known.
class GroupAverage {
 public:
  GroupAverage(const GroupJob& job, std::span<const Index> sources, GroupScratch& scratch, const GroupDistances& distances)
      : job_(job), sources_(sources), scratch_(scratch), size_(distances.size()), beyond_(distances.beyond()) {}

  KernelStatistics run() {
    const KernelStatistics statistics = find_kernels();
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

  std::span<RegionPlace> region() { return {scratch_.region.data(), size_}; }
  // Of the places of the region.
  std::span<const Index> vertices() const { return {scratch_.vertices.data(), size_}; }

  // Computes the kernels, and those with too many samples again without the surplus.
  KernelStatistics find_kernels() {
    Numbers counts = evaluate();
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
    if (statistics.truncated > 0) evaluate();
    return statistics;
  }

  // Puts kernel values, K = exp(-d^2 / 4 t), in the place of distances, which are left among those passed on; sums the
  // values up, and counts the samples of each kernel.
  Numbers evaluate() {
    const float factor = -1 / (4 * job_.parameters.time_step);
    std::array<Lanes, parts> sums{}, held{};
    for (std::size_t i = 0; i < size_; ++i)
      for (std::size_t part = 0; part < parts; ++part) {
        RegionPlace& place = region()[i];
        const Lanes distance = load(place.passed.data() + part * lane_count);
        const auto within = distance < splat(beyond_);
        Lanes kernel = select(within, exponential(distance * distance * factor), Lanes{});
        if (job_.weights != nullptr) kernel = kernel * job_.weights[vertices()[i]];
        store(place.lane.data() + part * lane_count, kernel);
        sums[part] += kernel;
        held[part] += select(within, splat(1), Lanes{});
      }
    Numbers counts;
    for (std::size_t part = 0; part < parts; ++part) {
      store(totals_.lane.data() + part * lane_count, sums[part]);
      store(counts.lane.data() + part * lane_count, held[part]);
    }
    return counts;
  }

  // Leaves max_samples of a lane's samples, the source and those nearest to it.
  void cut_short(std::size_t lane) {
    const auto rank = [&](std::size_t i) {
      return std::pair(vertices()[i] == sources_[lane] ? -1 : region()[i].passed[lane], vertices()[i]);
    };
    auto& order = scratch_.order;
    order.clear();
    for (std::size_t i = 0; i < size_; ++i)
      if (region()[i].passed[lane] < beyond_) order.push_back(rank(i));
    const auto last = order.begin() + static_cast<std::ptrdiff_t>(job_.parameters.max_samples);
    std::nth_element(order.begin(), last, order.end());
    for (std::size_t i = 0; i < size_; ++i)
      if (!(rank(i) < *last)) region()[i].passed[lane] = beyond_;
  }

  // Averages differences from the sources, so that a constant is a fixed point to the last bit.
  template <std::size_t channels>
  void average(std::size_t first) {
    std::array<Numbers, channels> centres{}, averages;
    std::array<float, channels> low, high;
    for (std::size_t c = 0; c < channels; ++c) {
      for (std::size_t lane = 0; lane < sources_.size(); ++lane)
        centres[c].lane[lane] = job_.colours[sources_[lane]][first + c];
      low[c] = high[c] = centres[c].lane[0];
    }
    for (const Index vertex : vertices())
      for (std::size_t c = 0; c < channels; ++c) {
        low[c] = std::min(low[c], job_.colours[vertex][first + c]);
        high[c] = std::max(high[c], job_.colours[vertex][first + c]);
      }
    for (std::size_t part = 0; part < group_size; part += lane_count) {
      std::array<Lanes, channels> sums{}, centre;
      for (std::size_t c = 0; c < channels; ++c) centre[c] = load(centres[c].lane.data() + part);
      for (std::size_t i = 0; i < size_; ++i) {
        const float* colours = job_.colours[vertices()[i]] + first;
        const Lanes kernel = load(region()[i].lane.data() + part);
        for (std::size_t c = 0; c < channels; ++c) sums[c] += kernel * (splat(colours[c]) - centre[c]);
      }
      const Lanes total = load(totals_.lane.data() + part);
      for (std::size_t c = 0; c < channels; ++c) {
        const Lanes average = centre[c] + select(total > splat(0), sums[c] / total, Lanes{});
        // Rounding must not take an average out of the range of its colours.
        store(averages[c].lane.data() + part, smaller(larger(average, splat(low[c])), splat(high[c])));
      }
    }
    for (std::size_t lane = 0; lane < sources_.size(); ++lane)
      for (std::size_t c = 0; c < channels; ++c)
        job_.smoothed[static_cast<std::size_t>(sources_[lane]) * job_.colours.width + first + c] = averages[c].lane[lane];
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
  GroupDistances distances(*job.segments, job.parameters, scratch);
  if (!distances.find(group)) return std::nullopt;
  return GroupAverage(job, group.sources, scratch, distances).run();
}

}  // namespace beltrami::triangulated::BELTRAMI_VARIANT
