// Distances of the sources of one group, side by side in the lanes; compiled once for each instruction set, see
// instruction_set.hpp.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>

#include "lanes.hpp"
#include "triangulated/group_sweep.hpp"

namespace beltrami::triangulated::BELTRAMI_VARIANT {

using namespace beltrami::lanes::BELTRAMI_VARIANT;

// Maximum number of vertices that the kernels of a group reach: with more, their distances do not fit the caches.
constexpr std::size_t largest_region = 16384;

// Maximum number of reached vertices relative to the maximum number of samples of a kernel: above it, a march that ends
// at the latter is faster. Small regions are always swept.
constexpr std::size_t reached_for_held = 10, always_swept = 2048;

// Number of sweeps in both directions after which a march is faster.
constexpr int most_sweeps_at_hub = 20;

// Slower alternatives that were tried: listing the segments of a region once for all iterations, propagating several
// vertices at a time without branches, and taking vertices in the order of their changes.
class GroupDistances {
 public:
  GroupDistances(const Segments& segments, const KernelParameters& parameters, GroupScratch& scratch)
      : segments_(segments), scratch_(scratch),
        beyond_(std::nextafter(parameters.radius, std::numeric_limits<float>::infinity())),
        most_(std::clamp(reached_for_held * std::min(parameters.max_samples, largest_region), always_swept, largest_region)) {}

  // Propagates changes, vertex by vertex, until there are none. Every distance is then that of the shortest path, in
  // any order, since sums along a path are always rounded the same. Returns nothing if that takes too long.
  std::optional<Region> find(const VertexGroup& group) {
    reserve(group_size);
    for (std::size_t lane = 0; lane < group.sources.size(); ++lane) {
      add(group.sources[lane]);
      scratch_.region[lane].nearest[lane] = 0;
    }
    // Distances between the sources come first; otherwise all would be propagated twice.
    for (const InnerSegment& segment : group.inner) join(segment);
    bool any = true;
    for (int sweep = 0; any && fits_; ++sweep) {
      any = false;
      for (std::size_t place = 0; place < size_; ++place) any |= pass_on(place);
      // Around a hub distances may run against the order of slots, and then advance by one slot per sweep.
      if (!any || !at_hub_) continue;
      for (std::size_t place = size_; place-- > 0;) any |= pass_on(place);
      fits_ &= sweep < most_sweeps_at_hub;
    }
    for (std::size_t place = 0; place < size_; ++place) scratch_.place[static_cast<std::size_t>(scratch_.vertices[place])] = 0;
    if (!fits_) return std::nullopt;
    return Region{{scratch_.vertices.data(), size_}, {scratch_.region.data(), size_}, beyond_};
  }

 private:
  void reserve(std::size_t size) {
    if (scratch_.region.size() >= size) return;
    size = std::max(size, 2 * scratch_.region.size());
    scratch_.region.resize(size);
    scratch_.vertices.resize(size);
  }

  // Assigns a slot to a vertex.
  std::uint32_t add(Index vertex) {
    scratch_.vertices[size_] = vertex;
    RegionPlace& place = scratch_.region[size_++];
    for (std::size_t part = 0; part < group_size; part += lane_count) {
      store(place.nearest.data() + part, splat(beyond_));
      store(place.distance.data() + part, splat(beyond_));
    }
    prefetch_segments(vertex);
    return scratch_.place[static_cast<std::size_t>(vertex)] = static_cast<std::uint16_t>(size_);
  }

  // Prefetches the list of segments from a vertex.
  void prefetch_segments(Index vertex) const {
    const std::uint32_t* offset = segments_.offsets.data() + vertex;
    for (std::uint32_t i = offset[0]; i < offset[1]; i += 64 / sizeof(float)) {
      prefetch(segments_.lengths.data() + i);
      prefetch(segments_.targets.data() + i);
    }
  }

  // Propagates distances between two sources, in both directions.
  void join(const InnerSegment& segment) {
    const float length = segments_.lengths[segment.place];
    float* one = scratch_.region[segment.from].nearest.data();
    float* other = scratch_.region[segment.to].nearest.data();
    for (std::size_t part = 0; part < group_size; part += lane_count) {
      const Lanes at_one = load(one + part), at_other = load(other + part);
      store(one + part, smaller(at_other + length, at_one));
      store(other + part, smaller(at_one + length, at_other));
    }
  }

  bool pass_on(std::size_t place) {
    RegionPlace& from = scratch_.region[place];
    std::array<Lanes, group_size / lane_count> here;
    Lanes fallen{};
    std::uint32_t nearer = 0;
    for (std::size_t part = 0; part < here.size(); ++part) {
      here[part] = load(from.nearest.data() + part * lane_count);
      const Lanes passed = load(from.distance.data() + part * lane_count);
      nearer |= where_smaller(here[part], passed);
      const Lanes lower = select(here[part] < passed, here[part], splat(beyond_));
      fallen = part == 0 ? lower : smaller(fallen, lower);
    }
    if (nearer == 0 || !fits_) return false;
    for (std::size_t part = 0; part < here.size(); ++part) store(from.distance.data() + part * lane_count, here[part]);
    const std::uint32_t* offset = segments_.offsets.data() + scratch_.vertices[place];
    const std::uint32_t begin = offset[0], end = offset[1];
    at_hub_ |= end - begin > most_segments;
    fits_ = size_ + (end - begin) <= most_;
    if (!fits_) return false;
    reserve(size_ + (end - begin));
    // Local copies, since the compiler must assume that stores change these pointers.
    RegionPlace* const region = scratch_.region.data();
    const std::uint16_t* const places = scratch_.place.data();
    // A longer segment leaves all kernels in which the distance has decreased; rounding must not exclude one that does
    // not.
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
        float* distances = region[number - 1].nearest.data();
        for (std::size_t part = 0; part < group_size; part += lane_count)
          store(distances + part, smaller(here[part / lane_count] + length, load(distances + part)));
      }
    }
    return true;
  }

  // One bit for each of up to 64 lengths: whether it is below the limit.
  static std::uint64_t find_within(const float* lengths, std::uint32_t count, float limit) {
    std::uint64_t within = 0;
    for (std::uint32_t k = 0; k < count; k += lane_count)
      within |= std::uint64_t{where_smaller(load(lengths + k), splat(limit))} << k;
    return within & ~std::uint64_t{0} >> (64 - count);
  }

  const Segments& segments_;
  GroupScratch& scratch_;
  float beyond_;  // where distances stand that are not known, or longer than the radius: no path leads further
  std::size_t most_;  // places
  std::size_t size_ = 0;
  bool fits_ = true, at_hub_ = false;
};

}  // namespace beltrami::triangulated::BELTRAMI_VARIANT
