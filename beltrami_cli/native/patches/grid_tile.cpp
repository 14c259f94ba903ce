// Compiled once for each instruction set, see instruction_set.hpp.
#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <numeric>

#include "lanes.hpp"
#include "patches/grid_patches.hpp"

namespace beltrami::patches::BELTRAMI_VARIANT {
namespace {

using namespace beltrami::lanes::BELTRAMI_VARIANT;
using Index = std::ptrdiff_t;

constexpr Index side = tile_side + 2 * margin, area = side * side;
constexpr Index candidate_count = (2 * rows_beside + 1) * candidate_columns;
constexpr int patch_side = 2 * patch_reach + 1, patch_cells = patch_side * patch_side;
static_assert(candidate_count <= 1024 && candidate_columns % lane_count == 0);

// Lower bound of distances, far below those of colours.
constexpr float least_distance = 1e-30F;

// The cells of a tile and its surroundings, with mixed channels.
class TilePlanes {
 public:
  TilePlanes(const Canvas& canvas, const Tile& tile, TileScratch& scratch) : canvas_(canvas), tile_(tile), scratch_(scratch) {
    const std::size_t all = canvas.channels * static_cast<std::size_t>(area);
    scratch_.kind.assign(static_cast<std::size_t>(area), grid::empty);
    scratch_.noisy.assign(all, far_away);
    scratch_.pilot.assign(all, far_away);
    scratch_.estimates.assign(all, 0);
    scratch_.weights.assign(all, 0);
    scratch_.counts.assign(static_cast<std::size_t>(area), enough_estimates);
    scratch_.distances.resize(static_cast<std::size_t>(candidate_count));
    scratch_.keys.resize(static_cast<std::size_t>(candidate_count));
    if (canvas.relative != nullptr) scratch_.relative.assign(static_cast<std::size_t>(area), 1);
    each_row([&](Index local, Index cell, Index count) { read(local, cell, count); });
  }

  // The mixed channels, one plane of `area` values after the other.
  Colours channels() const {
    const float* relative = canvas_.relative != nullptr ? scratch_.relative.data() : nullptr;
    return {scratch_.noisy.data(), scratch_.pilot.data(), canvas_.channels, canvas_.mixing, relative};
  }

  Sums sums() const { return {scratch_.estimates.data(), scratch_.weights.data()}; }

  void add_to(Band& band) const {
    each_row([&](Index local, Index cell, Index count) {
      for (std::size_t channel = 0; channel < canvas_.channels; ++channel) {
        const Index from = local + static_cast<Index>(channel) * area;
        const std::size_t to = static_cast<std::size_t>(cell) + (channel * band.rows - band.first) * canvas_.columns;
        for (Index i = 0; i < count; ++i) {
          band.estimates[to + static_cast<std::size_t>(i)] += scratch_.estimates[static_cast<std::size_t>(from + i)];
          band.weights[to + static_cast<std::size_t>(i)] += scratch_.weights[static_cast<std::size_t>(from + i)];
        }
      }
    });
  }

 private:
  // Calls f(local cell, cell, count) for each row that is on the canvas.
  template <class F>
  void each_row(F f) const {
    const Index rows = static_cast<Index>(canvas_.rows), columns = static_cast<Index>(canvas_.columns);
    const Index top = tile_.row - margin, left = tile_.column - margin;
    const Index first = std::max<Index>(0, left), last = std::min(columns, left + side);
    for (Index y = std::max<Index>(0, top); y < std::min(rows, top + side); ++y)
      f((y - top) * side + first - left, y * columns + first, last - first);
  }

  void read(Index local, Index cell, Index count) {
    const std::size_t n = canvas_.channels;
    std::copy_n(canvas_.kind + cell, count, scratch_.kind.begin() + local);
    std::transform(canvas_.kind + cell, canvas_.kind + cell + count, scratch_.counts.begin() + local,
                   [](std::uint8_t kind) { return kind == grid::empty ? enough_estimates : std::uint16_t{0}; });
    if (canvas_.relative != nullptr) std::copy_n(canvas_.relative + cell, count, scratch_.relative.begin() + local);
    for (std::size_t channel = 0; channel < n; ++channel) {
      mix(canvas_.noisy, channel, local, cell, count, scratch_.noisy);
      mix(canvas_.pilot, channel, local, cell, count, scratch_.pilot);
    }
  }

  // Writes some cells of a mixed channel.
  void mix(const float* planes, std::size_t channel, Index local, Index cell, Index count, std::vector<float>& all) const {
    const std::size_t cells = canvas_.rows * canvas_.columns, n = canvas_.channels;
    std::array<float, side> sums{};
    for (std::size_t from = 0; from < n; ++from) {
      const float factor = canvas_.mixing.forth[channel * n + from], *plane = planes + from * cells + cell;
      for (Index i = 0; i < count; ++i) sums[static_cast<std::size_t>(i)] += factor * plane[i];
    }
    const std::uint8_t* kind = scratch_.kind.data() + local;
    float* mixed = all.data() + static_cast<Index>(channel) * area + local;
    for (Index i = 0; i < count; ++i) mixed[i] = kind[i] == grid::empty ? far_away : sums[static_cast<std::size_t>(i)];
  }

  const Canvas& canvas_;
  Tile tile_;
  TileScratch& scratch_;
};

// The existing cells of the patch at a centre; patches have rows of `row_length` cells, the last of them padding.
constexpr Index row_length = 8;
static_assert(patch_side * row_length <= Index{long_row} && patch_side <= row_length);

struct Shape {
  alignas(64) std::array<float, long_row> is_there{};  // 1 or 0
  std::array<std::uint16_t, long_row> ones{};                        // the same, to count estimates
  std::array<std::int32_t, patch_cells> offsets;                     // relative to the centre
  std::array<std::uint8_t, long_row> used;                           // places in the rows, one after the other
  std::array<std::int32_t, patch_cells> every_second;                // of the offsets, like black on a chessboard
  std::size_t count = 0, half_count = 0;

  Shape(const std::uint8_t* kind, Index centre) {
    for (Index y = 0; y < patch_side; ++y)
      for (Index x = 0; x < patch_side; ++x) {
        const Index offset = (y - patch_reach) * side + x - patch_reach;
        if (kind[centre + offset] == grid::empty) continue;
        is_there[static_cast<std::size_t>(y * row_length + x)] = 1;
        ones[static_cast<std::size_t>(y * row_length + x)] = 1;
        used[count] = static_cast<std::uint8_t>(y * row_length + x);
        offsets[count++] = static_cast<std::int32_t>(offset);
        if ((x + y) % 2 == 0) every_second[half_count++] = static_cast<std::int32_t>(offset);
      }
  }
};

// Rows of the window whose squared differences are summed at a time. The first channel is compared on all cells, so
// that candidates have all cells of the patch; of the others every second cell suffices, since neighbours are similar.
constexpr Index rows_at_once = 5;
static_assert((2 * rows_beside + 1) % rows_at_once == 0 && (2 * rows_beside_few + 1) % rows_at_once == 0);

// Sums of squared differences of the pilot between the patch at `centre` and all candidates; large beyond the window.
void compare(const float* pilot, std::size_t channels, const Shape& shape, Index centre, bool has_pilot, float* distances) {
  const Index rows = has_pilot ? rows_beside : rows_beside_few;
  if (!has_pilot) std::fill_n(distances, candidate_count, 2 * too_far);
  for (Index y = -rows; y <= rows; y += rows_at_once)
    for (Index x = 0; x < candidate_columns; x += Index{lane_count}) {
      const Index first = centre + y * side + x - columns_before;
      std::array<Lanes, rows_at_once> sums{};
      for (std::size_t channel = 0; channel < channels; ++channel) {
        const float* plane = pilot + static_cast<Index>(channel) * area;
        const auto& offsets = channel == 0 ? shape.offsets : shape.every_second;
        const std::size_t count = channel == 0 ? shape.count : shape.half_count;
        for (std::size_t p = 0; p < count; ++p) {
          const Lanes here = splat(plane[centre + offsets[p]]);
          const float* other = plane + first + offsets[p];
          for (Index row = 0; row < rows_at_once; ++row) {
            const Lanes difference = load(other + row * side) - here;
            sums[static_cast<std::size_t>(row)] += difference * difference;
          }
        }
      }
      for (Index row = 0; row < rows_at_once; ++row)
        store(distances + (y + rows_beside + row) * candidate_columns + x, sums[static_cast<std::size_t>(row)]);
    }
}

// The mean of a patch.
float mean_of(const float* plane, const Shape& shape, Index centre) {
  float sum = 0;
  for (std::size_t p = 0; p < shape.count; ++p) sum += plane[centre + shape.offsets[p]];
  return sum / static_cast<float>(shape.count);
}

// Patches of the pilot that differ by less than this, in units of the noise, count as equal.
constexpr float least_difference = 0.08F;

// The energy of the noise in the summed differences of the patch at `centre`.
float noise_of(const Colours& colours, const Shape& shape, Index centre) {
  float energy = 0;
  for (std::size_t channel = 0; channel < colours.channels; ++channel)
    energy += colours.mixing.variances[channel] * static_cast<float>(channel == 0 ? shape.count : shape.half_count);
  return colours.relative == nullptr ? energy : energy * mean_of(colours.relative, shape, centre);
}

// Number of candidates whose key, the bits of a positive float, is below a bound.
std::size_t count_below(const float* keys, std::uint32_t bound) {
  Lanes counts{};
  for (std::size_t first = 0; first < candidate_count; first += lane_count)
    counts += select(load(keys + first) < splat(std::bit_cast<float>(bound)), splat(1), splat(0));
  std::array<float, lane_count> each;
  store(each.data(), counts);
  return static_cast<std::size_t>(std::accumulate(each.begin(), each.end(), 0.0F));
}

// Chooses the nearest candidates, in their order in the window, always including the patch itself; returns their
// number. Candidates nearer than `near` are equivalent, and are chosen pseudo-randomly all over the window: a choice by
// the noise of the pilot would prefer those that share it. Keys consist of a distance and, in the last bits, the
// shuffled number of a candidate.
std::size_t choose(std::vector<float>& distances, std::vector<std::uint32_t>& chosen, std::size_t size, float near) {
  // Multiplication by any odd number is a permutation of the 1024 numbers.
  constexpr std::uint32_t low = 1023, shuffling = 599;
  constexpr std::uint32_t itself = rows_beside * candidate_columns + columns_before;
  // Keys are normal numbers, which order like their bits on any processor, unlike subnormal ones.
  near = std::max(near, least_distance);
  for (std::uint32_t i = 0; i < candidate_count; ++i) {
    const auto bits = std::bit_cast<std::uint32_t>(std::max(distances[i], near));
    distances[i] = std::bit_cast<float>((bits & ~low) | ((i - itself) * shuffling & low));
  }
  distances[itself] = 0;
  // The least bound above `size` keys, or that of all candidates that are near enough: keys are distinct.
  std::uint32_t least = 0, bound = std::bit_cast<std::uint32_t>(too_far);
  for (std::size_t below = count_below(distances.data(), bound); below > size;) {
    const std::uint32_t middle = least + (bound - least) / 2;
    const std::size_t here = count_below(distances.data(), middle);
    (here < size ? least : bound) = middle;
    if (here >= size) below = here;
  }
  std::size_t found = 0;
  for (std::uint32_t first = 0; first < candidate_count; first += lane_count) {
    if (std::bit_cast<std::uint32_t>(least_lane(load(distances.data() + first))) >= bound) continue;
    for (std::uint32_t i = first; i < first + lane_count; ++i) {
      chosen[found] = i;
      found += std::bit_cast<std::uint32_t>(distances[i]) < bound ? 1 : 0;
    }
  }
  return found;
}

// A row of a patch in registers.
using Row = Pack<float, static_cast<std::size_t>(row_length)>;

inline void read_row(const float* from, Row& row) { std::memcpy(&row, from, sizeof row); }

inline void write_row(const Row& row, float* to) { std::memcpy(to, &row, sizeof row); }

inline void add_to_row(const Row& values, float* to) {
  Row sums;
  read_row(to, sums);
  write_row(sums + values, to);
}

// Reads the patches with centres at `places`: their differences from `mean`, or 0 for missing cells.
void read_patches(const float* plane, const Shape& shape, const std::int32_t* places, std::size_t found, float mean,
                  float* patches) {
  for (std::size_t k = 0; k < found; ++k) {
    const float* corner = plane + places[k] - patch_reach * side - patch_reach;
    for (Index y = 0; y < patch_side; ++y) {
      Row row, is_there;
      read_row(corner + y * side, row);
      read_row(shape.is_there.data() + y * row_length, is_there);
      write_row((row + -mean) * is_there, patches + static_cast<Index>(k * long_row) + y * row_length);
    }
  }
}

// Adds patch k of a group, whose centre is at `place`, to the sums of a channel.
void add_patch(const Group& group, std::size_t k, const Shape& shape, std::int32_t place, float mean, const Sums& sums) {
  for (Index y = 0; y < patch_side; ++y) {
    Row values, is_there;
    read_row(group.estimates.data() + static_cast<Index>(k * long_row) + y * row_length, values);
    read_row(shape.is_there.data() + y * row_length, is_there);
    const Row weights = is_there * group.weights[k];
    const Index to = place + (y - patch_reach) * side - patch_reach;
    add_to_row((values + mean) * weights, sums.estimates + to);
    add_to_row(weights, sums.weights + to);
  }
}

// Counts one more estimate of the cells of a patch.
void count_patch(const Shape& shape, std::int32_t place, std::uint16_t* __restrict counts) {
  const Index corner = place - patch_reach * side - patch_reach;
  for (Index y = 0; y < patch_side; ++y)
    for (Index x = 0; x < row_length; ++x)
      counts[corner + y * side + x] =
          static_cast<std::uint16_t>(counts[corner + y * side + x] + shape.ones[static_cast<std::size_t>(y * row_length + x)]);
}

// Whether each cell of the patch at a centre has enough estimates, or is empty.
bool has_enough(Index centre, const std::uint16_t* counts) {
  const std::uint16_t* corner = counts + centre - patch_reach * side - patch_reach;
  std::uint16_t least = enough_estimates;
  for (Index y = 0; y < patch_side && least == enough_estimates; ++y)
    for (Index x = 0; x < patch_side; ++x) least = std::min(least, corner[y * side + x]);
  return least == enough_estimates;
}

// Estimates the patches similar to the one at `centre`, unless its cells have enough estimates.
void add_one(const Colours& colours, Index centre, bool has_pilot, const Sums& sums, TileScratch& scratch) {
  if (has_enough(centre, scratch.counts.data())) return;
  const Shape shape(scratch.kind.data(), centre);
  compare(colours.pilot, colours.channels, shape, centre, has_pilot, scratch.distances.data());
  Group& group = scratch.group;
  group.size = has_pilot ? many : few;
  group.length = long_row;
  const float near = has_pilot ? least_difference * noise_of(colours, shape, centre) : 0;
  group.found = choose(scratch.distances, scratch.keys, group.size, near);
  group.count = shape.count;
  group.used = shape.used;
  std::array<std::int32_t, many> places;
  std::array<float, many> relative{};
  for (std::size_t k = 0; k < group.found; ++k) {
    const Index number = scratch.keys[k];
    places[k] = static_cast<std::int32_t>(centre + (number / candidate_columns - rows_beside) * side +
                                          number % candidate_columns - columns_before);
    relative[k] = static_cast<float>(shape.count);
    if (colours.relative != nullptr) relative[k] *= mean_of(colours.relative, shape, places[k]);
    count_patch(shape, places[k], scratch.counts.data());
  }
  for (std::size_t channel = 0; channel < colours.channels; ++channel) {
    const std::size_t plane = channel * static_cast<std::size_t>(area);
    const float mean = mean_of(colours.pilot + plane, shape, centre);
    group.shrinkage = colours.mixing.shrinkage[channel];
    group.least_ratio = colours.mixing.least_ratio;
    group.strength = colours.mixing.strength;
    for (std::size_t k = 0; k < many; ++k) group.energy[k] = relative[k] * colours.mixing.variances[channel];
    read_patches(colours.noisy + plane, shape, places.data(), group.found, mean, group.noisy.data());
    if (has_pilot) read_patches(colours.pilot + plane, shape, places.data(), group.found, mean, group.pilot.data());
    estimate_group(group, has_pilot);
    for (std::size_t k = 0; k < group.found; ++k)
      add_patch(group, k, shape, places[k], mean, {sums.estimates + plane, sums.weights + plane});
  }
}

// Calls f(cell) for the centre of a block of cells, and for further cells until each owned cell is in a patch.
template <class F>
void each_centre(const std::uint8_t* kind, Index first, F f) {
  std::array<Index, spacing * spacing> ys, xs;
  std::size_t count = 0;
  const auto visit = [&](Index y, Index x) {
    if (kind[first + y * side + x] != grid::owned) return;
    for (std::size_t i = 0; i < count; ++i)
      if (std::abs(ys[i] - y) <= patch_reach && std::abs(xs[i] - x) <= patch_reach) return;
    ys[count] = y;
    xs[count++] = x;
    f(first + y * side + x);
  };
  visit(spacing / 2, spacing / 2);
  for (Index y = 0; y < spacing; ++y)
    for (Index x = 0; x < spacing; ++x) visit(y, x);
}

}  // namespace

void add_tile(const Canvas& canvas, const Tile& tile, bool has_pilot, Band& band, TileScratch& scratch) {
  const TilePlanes planes(canvas, tile, scratch);
  for (Index y = 0; y < tile_side; y += spacing)
    for (Index x = 0; x < tile_side; x += spacing)
      each_centre(scratch.kind.data(), (margin + y) * side + margin + x,
                  [&](Index centre) { add_one(planes.channels(), centre, has_pilot, planes.sums(), scratch); });
  planes.add_to(band);
}

}  // namespace beltrami::patches::BELTRAMI_VARIANT
