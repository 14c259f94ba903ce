// Distances of the sources of one group, side by side in the lanes; part of each variant of the group sweep.
//
// What does not help: to list the segments within a region once for all iterations, to pass on several vertices at a time
// without branches, to take vertices in the order in which they change. All were slower.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <utility>

#include "parametric/lanes.hpp"
#include "triangulated/group_sweep.hpp"

namespace beltrami::triangulated::BELTRAMI_VARIANT {
namespace {

using namespace beltrami::parametric::BELTRAMI_VARIANT;

constexpr std::size_t parts = group_size / lane_count;

// Where the kernels of a group reach more vertices than this, their distances do not fit the caches.
constexpr std::size_t largest_region = 16384;

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

class GroupDistances {
 public:
  GroupDistances(const Segments& segments, float radius, GroupScratch& scratch)
      : segments_(segments), scratch_(scratch),
        beyond_(std::nextafter(radius, std::numeric_limits<float>::infinity())) {}

  // Distances that are not known, or beyond the radius, stand just beyond it, so that no path leads further.
  float beyond() const { return beyond_; }
  // How many places the sources reach.
  std::size_t size() const { return size_; }

  // Passes changes on, vertex by vertex, until there are none: then every distance is that of the shortest path, whatever
  // the order, as sums along a path are rounded in the same way for all. Returns whether there was room.
  bool find(std::span<const Index> sources) {
    make_room(group_size);
    for (std::size_t lane = 0; lane < sources.size(); ++lane) {
      add(sources[lane]);
      RegionPlace& source = scratch_.region[lane];
      source.lane[lane] = 0;
      source.least = 0;
      source.changed = 1;
    }
    for (std::size_t place = size_; place-- > 0;) pass_on(place);
    for (bool any = true; any;) {
      any = false;
      for (std::size_t place = 0; place < size_; ++place) any |= pass_on(place);
    }
    for (std::size_t place = 0; place < size_; ++place) scratch_.place[static_cast<std::size_t>(scratch_.region[place].vertex)] = 0;
    return fits_;
  }

 private:
  void make_room(std::size_t size) {
    if (scratch_.region.size() >= size) return;
    scratch_.region.resize(std::max(size, 2 * scratch_.region.size()));
  }

  // Gives a vertex a place.
  std::uint32_t add(Index vertex) {
    RegionPlace& place = scratch_.region[size_++];
    place.vertex = vertex;
    place.least = beyond_;
    place.changed = 0;
    for (std::size_t part = 0; part < group_size; part += lane_count) store(place.lane.data() + part, splat(beyond_));
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

  bool pass_on(std::size_t place) {
    if (std::exchange(scratch_.region[place].changed, 0U) == 0 || !fits_) return false;
    const std::uint32_t* offset = segments_.offsets.data() + scratch_.region[place].vertex;
    const std::uint32_t begin = offset[0], end = offset[1];
    fits_ = size_ + (end - begin) <= largest_region;
    if (!fits_) return false;
    make_room(size_ + (end - begin));
    // Kept at hand: what is stored might change these pointers, for all that the compiler knows.
    RegionPlace* const region = scratch_.region.data();
    const std::uint16_t* const places = scratch_.place.data();
    std::array<Lanes, parts> here;
    for (std::size_t part = 0; part < parts; ++part) here[part] = load(region[place].lane.data() + part * lane_count);
    // A longer segment leads out of all kernels; rounding must not make that of one that does not.
    const float least = region[place].least, limit = (beyond_ - least) * 1.000001F;
    for (std::uint32_t first = begin; first < end; first += 64) {
      const float* lengths = segments_.lengths.data() + first;
      const Index* targets = segments_.targets.data() + first;
      for (std::uint64_t within = find_within(lengths, std::min(end - first, 64U), limit); within != 0; within &= within - 1) {
        const int i = std::countr_zero(within);
        const Index target = targets[i];
        const float length = lengths[i];
        std::size_t number = places[target];
        if (number == 0) number = add(target);
        RegionPlace& to = region[number - 1];
        std::uint32_t nearer = 0;
        for (std::size_t part = 0; part < parts; ++part) {
          float* distances = to.lane.data() + part * lane_count;
          const Lanes before = load(distances), through = here[part] + length;
          nearer |= where_smaller(through, before);
          store(distances, smaller(through, before));
        }
        to.least = std::min(to.least, least + length);
        to.changed |= nearer;
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
  std::size_t size_ = 0;
  bool fits_ = true;
};

}  // namespace
}  // namespace beltrami::triangulated::BELTRAMI_VARIANT
