// Compiled once for each instruction set, see instruction_set.hpp.
#include <algorithm>
#include <array>
#include <bit>

#include "lanes.hpp"
#include "patches/grid_patches.hpp"

namespace beltrami::patches::BELTRAMI_VARIANT {
namespace {

using namespace beltrami::lanes::BELTRAMI_VARIANT;
using Index = std::ptrdiff_t;

constexpr Index side = tile_side + 2 * margin, area = side * side;
constexpr Index candidates = (2 * rows_beside + 1) * candidate_columns;
constexpr int patch_side = 2 * patch_reach + 1, patch_cells = patch_side * patch_side;
static_assert(candidates <= 1024 && candidate_columns % lane_count == 0);

// Empty cells are this far from all colours, so that no candidate has one where the first patch has none.
constexpr float far_away = 1e9F, too_far = 1e17F;

// The cells of a tile and around it, with mixed channels.
class TilePlanes {
 public:
  TilePlanes(const Canvas& canvas, const Tile& tile, TileScratch& scratch) : canvas_(canvas), tile_(tile), own_(scratch) {
    const std::size_t all = canvas.channels * static_cast<std::size_t>(area);
    own_.kind.assign(static_cast<std::size_t>(area), grid::empty);
    own_.noisy.assign(all, far_away);
    own_.pilot.assign(all, far_away);
    own_.estimates.assign(all, 0);
    own_.weights.assign(all, 0);
    own_.distances.resize(static_cast<std::size_t>(candidates));
    own_.keys.resize(static_cast<std::size_t>(candidates));
    if (canvas.relative != nullptr) own_.relative.assign(static_cast<std::size_t>(area), 1);
    each_row([&](Index local, Index cell, Index count) { read(local, cell, count); });
  }

  Channels channels() const {
    const float* relative = canvas_.relative != nullptr ? own_.relative.data() : nullptr;
    return {own_.noisy.data(), own_.pilot.data(), canvas_.variances,
            relative,          canvas_.channels,  static_cast<std::size_t>(area)};
  }

  Sums sums() const { return {own_.estimates.data(), own_.weights.data()}; }

  void add_to(const Sums& whole) const {
    each_row([&](Index local, Index cell, Index count) {
      for (std::size_t channel = 0; channel < canvas_.channels; ++channel) {
        const Index from = local + static_cast<Index>(channel) * area;
        const std::size_t to = static_cast<std::size_t>(cell) + channel * canvas_.rows * canvas_.columns;
        for (Index i = 0; i < count; ++i) {
          whole.estimates[to + static_cast<std::size_t>(i)] += own_.estimates[static_cast<std::size_t>(from + i)];
          whole.weights[to + static_cast<std::size_t>(i)] += own_.weights[static_cast<std::size_t>(from + i)];
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
    const std::size_t cells = canvas_.rows * canvas_.columns, n = canvas_.channels;
    std::copy_n(canvas_.kind + cell, count, own_.kind.begin() + local);
    if (canvas_.relative != nullptr) std::copy_n(canvas_.relative + cell, count, own_.relative.begin() + local);
    for (std::size_t to = 0; to < n; ++to)
      for (Index i = 0; i < count; ++i) {
        if (canvas_.kind[cell + i] == grid::empty) continue;
        float noisy = 0, pilot = 0;
        for (std::size_t from = 0; from < n; ++from) {
          const std::size_t at = from * cells + static_cast<std::size_t>(cell + i);
          noisy += canvas_.mixing[to * n + from] * canvas_.noisy[at];
          pilot += canvas_.mixing[to * n + from] * canvas_.pilot[at];
        }
        const std::size_t at = to * static_cast<std::size_t>(area) + static_cast<std::size_t>(local + i);
        own_.noisy[at] = noisy;
        own_.pilot[at] = pilot;
      }
  }

  const Canvas& canvas_;
  Tile tile_;
  TileScratch& own_;
};

// The cells of a patch that are there, relative to its centre.
struct Shape {
  std::array<std::int32_t, patch_cells> offsets;
  std::size_t count = 0;

  Shape(const std::uint8_t* kind, Index centre) {
    for (Index y = -patch_reach; y <= patch_reach; ++y)
      for (Index x = -patch_reach; x <= patch_reach; ++x)
        if (kind[centre + y * side + x] != grid::empty) offsets[count++] = static_cast<std::int32_t>(y * side + x);
  }
};

// Sums of squared differences of the pilot between the patch at `centre` and those of all candidates.
void compare(const float* pilot, std::size_t channels, const Shape& shape, Index centre, float* distances) {
  constexpr std::size_t packs = candidate_columns / lane_count;
  for (Index y = -rows_beside; y <= rows_beside; ++y) {
    const Index first = centre + y * side - columns_before;
    std::array<Lanes, packs> sums{};
    for (std::size_t channel = 0; channel < channels; ++channel) {
      const float* plane = pilot + static_cast<Index>(channel) * area;
      for (std::size_t p = 0; p < shape.count; ++p) {
        const Lanes own = splat(plane[centre + shape.offsets[p]]);
        const float* other = plane + first + shape.offsets[p];
        for (std::size_t v = 0; v < packs; ++v) {
          const Lanes difference = load(other + v * lane_count) - own;
          sums[v] += difference * difference;
        }
      }
    }
    for (std::size_t v = 0; v < packs; ++v)
      store(distances + (y + rows_beside) * candidate_columns + static_cast<Index>(v * lane_count), sums[v]);
  }
}

// Chooses the nearest candidates; returns how many there are. Keys hold a distance, and in their last bits a candidate.
std::size_t choose(std::vector<float>& distances, std::vector<std::uint32_t>& keys, std::size_t size) {
  constexpr std::uint32_t low = 1023;
  constexpr std::size_t itself = rows_beside * candidate_columns + columns_before;
  distances[itself] = 0;
  std::size_t found = 0;
  for (std::uint32_t i = 0; i < candidates; ++i)
    if (distances[i] < too_far)
      keys[found++] = (std::bit_cast<std::uint32_t>(distances[i]) & ~low) | (i == itself ? 0 : i + 1);
  const std::size_t wanted = std::min(size, found);
  const auto begin = keys.begin();
  if (wanted < found) std::nth_element(begin, begin + static_cast<Index>(wanted), begin + static_cast<Index>(found));
  std::sort(begin, begin + static_cast<Index>(wanted));
  for (std::size_t k = 0; k < wanted; ++k) {
    const std::uint32_t number = keys[k] & low;
    keys[k] = number == 0 ? static_cast<std::uint32_t>(itself) : number - 1;
  }
  return wanted;
}

// Estimates the patches that look like the one at `centre`.
void add_one(const Canvas& canvas, const TilePlanes& planes, Index centre, bool has_pilot, TileScratch& scratch) {
  const std::size_t size = has_pilot ? many : few;
  const Shape shape(scratch.kind.data(), centre);
  compare(scratch.pilot.data(), canvas.channels, shape, centre, scratch.distances.data());
  const std::size_t found = choose(scratch.distances, scratch.keys, size);
  std::array<std::int32_t, many> at{};
  for (std::size_t k = 0; k < size; ++k) {
    const Index number = scratch.keys[k < found ? k : 0];
    at[k] = static_cast<std::int32_t>(centre + (number / candidate_columns - rows_beside) * side +
                                      number % candidate_columns - columns_before);
  }
  scratch.places.resize(shape.count * size);
  for (std::size_t p = 0; p < shape.count; ++p)
    for (std::size_t k = 0; k < size; ++k) scratch.places[p * size + k] = at[k] + shape.offsets[p];
  add_group(planes.channels(), scratch.places.data(), shape.count, size, found, has_pilot, planes.sums(), scratch.group);
}

// Calls f(cell) for the centres of a block of cells: its own, and others until each owned cell is in a patch.
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

void add_tile(const Canvas& canvas, const Tile& tile, bool has_pilot, const Sums& sums, TileScratch& scratch) {
  const TilePlanes planes(canvas, tile, scratch);
  for (Index y = 0; y < tile_side; y += spacing)
    for (Index x = 0; x < tile_side; x += spacing)
      each_centre(scratch.kind.data(), (margin + y) * side + margin + x,
                  [&](Index centre) { add_one(canvas, planes, centre, has_pilot, scratch); });
  planes.add_to(sums);
}

}  // namespace beltrami::patches::BELTRAMI_VARIANT
