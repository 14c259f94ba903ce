// Compiled several times, with BELTRAMI_VARIANT naming the namespace and the compiler's flags the instruction set.
// Contraction to fused multiply-add is off for all, so that every variant gives the same bits.
#include "triangulated/group_sweep.hpp"

#include <algorithm>
#include <array>
#include <bit>
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
  Group(const GroupJob& job, std::span<const Index> sources, GroupScratch& scratch)
      : job_(job), sources_(sources), scratch_(scratch),
        beyond_(std::nextafter(job.parameters.radius, std::numeric_limits<float>::infinity())) {}

  std::optional<KernelStatistics> run() {
    begin();
    const bool fits = find_distances();
    for (std::size_t place = 0; place < size_; ++place)
      scratch_.place[static_cast<std::size_t>(scratch_.region[place])] = 0;
    if (!fits) return std::nullopt;
    const KernelStatistics statistics = find_kernels();
    average();
    return statistics;
  }

 private:
  float* row(std::size_t place) { return scratch_.lanes.data() + place * group_size; }

  void begin() {
    grow(group_size);
    for (const Index source : sources_) prefetch(source);
    for (std::size_t lane = 0; lane < sources_.size(); ++lane) {
      add(sources_[lane]);
      row(lane)[lane] = 0;
      scratch_.least[lane] = 0;
      scratch_.changed[lane] = 1;
    }
  }

  void grow(std::size_t size) {
    if (scratch_.region.size() >= size) return;
    size = std::max(size, 2 * scratch_.region.size());
    scratch_.region.resize(size);
    scratch_.changed.resize(size);
    scratch_.least.resize(size);
    scratch_.lanes.resize(size * group_size);
  }

  // Gives a vertex a place. Distances that are not known stand just beyond the radius, so that no path leads further.
  std::uint32_t add(Index vertex) {
    const std::size_t place = size_++;
    scratch_.region[place] = vertex;
    scratch_.changed[place] = 0;
    scratch_.least[place] = beyond_;
    for (std::size_t part = 0; part < parts; ++part) store(row(place) + part * lane_count, splat(beyond_));
    prefetch(vertex);
    return scratch_.place[static_cast<std::size_t>(vertex)] = static_cast<std::uint16_t>(size_);
  }

  // The lists of segments from a vertex are about to be read.
  void prefetch([[maybe_unused]] Index vertex) const {
#if defined(__GNUC__)
    const std::uint32_t* offset = job_.segments->offsets.data() + vertex;
    for (std::uint32_t i = offset[0]; i < offset[1]; i += 64 / sizeof(float)) {
      __builtin_prefetch(job_.segments->lengths.data() + i);
      __builtin_prefetch(job_.segments->targets.data() + i);
    }
#endif
  }

  // Passes changes on, vertex by vertex, until there are none: then every distance is that of the shortest path, whatever
  // the order, as sums along a path are rounded in the same way for all. Returns whether there was room.
  bool find_distances() {
    for (std::size_t place = sources_.size(); place-- > 0;) pass_on(place);
    for (bool any = true; any;) {
      any = false;
      for (std::size_t place = 0; place < size_; ++place) any |= pass_on(place);
      if (size_ > largest_region) return false;
    }
    return true;
  }

  bool pass_on(std::size_t place) {
    if (std::exchange(scratch_.changed[place], 0U) == 0) return false;
    const Segments& segments = *job_.segments;
    const std::uint32_t* offset = segments.offsets.data() + scratch_.region[place];
    const std::uint32_t begin = offset[0], end = offset[1];
    grow(size_ + (end - begin));
    std::array<Lanes, parts> here;
    for (std::size_t part = 0; part < parts; ++part) here[part] = load(row(place) + part * lane_count);
    // A longer segment leads out of all kernels; rounding must not make that of one that does not.
    const float least = scratch_.least[place], limit = (beyond_ - least) * 1.000001F;
    const float* lengths = segments.lengths.data();
    const Index* targets = segments.targets.data();
    for (std::uint32_t chunk = begin; chunk < end; chunk += 64) {
      const std::uint32_t count = std::min(end - chunk, 64U);
      std::uint64_t within = 0;
      for (std::uint32_t k = 0; k < count; k += lane_count)
        within |= std::uint64_t{where_smaller(load(lengths + chunk + k), splat(limit))} << k;
      within &= ~std::uint64_t{0} >> (64 - count);
      for (; within != 0; within &= within - 1) {
        const std::uint32_t i = chunk + static_cast<std::uint32_t>(std::countr_zero(within));
        relax(targets[i], lengths[i], here, least);
      }
    }
    return true;
  }

  void relax(Index target, float length, const std::array<Lanes, parts>& here, float from) {
    std::uint32_t place = scratch_.place[static_cast<std::size_t>(target)];
    if (place == 0) place = add(target);
    --place;
    float* distances = row(place);
    std::uint32_t nearer = 0;
    for (std::size_t part = 0; part < parts; ++part) {
      const Lanes before = load(distances + part * lane_count), through = here[part] + length;
      nearer |= where_smaller(through, before);
      store(distances + part * lane_count, smaller(through, before));
    }
    scratch_.least[place] = std::min(scratch_.least[place], from + length);
    scratch_.changed[place] |= nearer;
  }

  // Turns distances into kernel values, K = exp(-d^2 / 4 t), and lists the places that any kernel holds.
  KernelStatistics find_kernels() {
    const float factor = -1 / (4 * job_.parameters.time_step);
    std::array<float, group_size> counts{};
    scratch_.held.clear();
    for (std::size_t place = 0; place < size_; ++place) {
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
        if (job_.weights != nullptr) kernel = kernel * job_.weights[scratch_.region[place]];
        store(values, kernel);
      }
    return statistics;
  }

  // Leaves max_samples of a lane's samples, the source and those nearest to it.
  void cut_short(std::size_t lane) {
    std::vector<std::pair<float, Index>> order;
    for (const std::uint32_t place : scratch_.held)
      if (row(place)[lane] < beyond_)
        order.emplace_back(scratch_.region[place] == sources_[lane] ? -1 : row(place)[lane], scratch_.region[place]);
    const auto last = order.begin() + static_cast<std::ptrdiff_t>(job_.parameters.max_samples);
    std::nth_element(order.begin(), last, order.end());
    for (const std::uint32_t place : scratch_.held)
      if (scratch_.region[place] != sources_[lane] && !(std::pair(row(place)[lane], scratch_.region[place]) < *last))
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
        const float colour = job_.colours[scratch_.region[place]][channel];
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
  std::span<const Index> sources_;
  GroupScratch& scratch_;
  float beyond_;
  std::size_t size_ = 0;  // of the region
};

}  // namespace

std::optional<KernelStatistics> sweep_group(const GroupJob& job, std::span<const Index> sources, GroupScratch& scratch) {
  return Group(job, sources, scratch).run();
}

}  // namespace beltrami::triangulated::BELTRAMI_VARIANT
