// Compiled once for each instruction set, see instruction_set.hpp.
#include "grid/sweep_tile.hpp"

#include <algorithm>
#include <array>
#include <cstdint>

#include "grid/tile.hpp"

namespace beltrami::grid::BELTRAMI_VARIANT {
namespace {

// Larger than any distance in a window, and small enough that sums with lengths keep their precision.
constexpr float unreached = 1e8F;

struct Totals {
  Lanes samples, kernel;
};

// Converts the window's distances to kernel values, 0 beyond the radius, and sums them with that of the centre.
// `shares` is the weight of each cell of the tile, if not 1 for all.
template <bool shared>
Totals weigh(const TileJob& job, const TileLayout& layout, const float* shares, std::size_t centre, float* window) {
  const float factor = -1 / (4 * job.parameters->time_step);
  const float reach = std::min(job.parameters->radius, longest_radius);
  Totals totals{splat(1), splat(1)};
  for (const Target& target : job.program->targets) {
    float* slot = window + static_cast<std::size_t>(target.slot) * centre_count;
    const Lanes phi = load(slot);
    const Mask within = phi <= reach;
    const Lanes distance = select(within, phi, Lanes{});
    Lanes kernel = select(within, exponential(distance * distance * factor), Lanes{});
    if constexpr (shared) kernel = kernel * load(shares + centre + layout.at(target.offset));
    totals.samples += select(within, splat(1), Lanes{});
    totals.kernel += kernel;
    store(slot, kernel);
  }
  return totals;
}

// Sums channels over the window by its weights, as differences from the centres, so that a constant is preserved.
template <std::size_t channels>
void sum_up(const TileJob& job, const TileLayout& layout, const float* window, const float* colours, float* sums) {
  std::array<Lanes, channels> sum{}, here;
  for (std::size_t channel = 0; channel < channels; ++channel) here[channel] = load(colours + channel * layout.size);
  for (const Target& target : job.program->targets) {
    const Lanes kernel = load(window + static_cast<std::size_t>(target.slot) * centre_count);
    const float* there = colours + layout.at(target.offset);
    for (std::size_t channel = 0; channel < channels; ++channel)
      sum[channel] += kernel * (load(there + channel * layout.size) - here[channel]);
  }
  for (std::size_t channel = 0; channel < channels; ++channel) store(sums + channel * lane_count, sum[channel]);
}

// Sums all channels, three at a time as long as possible.
void sum_up_all(const TileJob& job, const TileLayout& layout, const float* window, const float* colours, float* sums) {
  std::size_t channel = 0;
  for (; channel + 3 <= job.colours.channels; channel += 3)
    sum_up<3>(job, layout, window, colours + channel * layout.size, sums + channel * lane_count);
  for (; channel < job.colours.channels; ++channel)
    sum_up<1>(job, layout, window, colours + channel * layout.size, sums + channel * lane_count);
}

// Writes the averages of the owned centres, `count` of them from `cell` on in the grid and from `colours` on in the
// tile; returns their number of samples.
std::int64_t write_owned(const TileJob& job, const TileLayout& layout, const Totals& totals, const float* colours,
                         const float* sums, std::size_t cell, std::size_t count) {
  const Grid& grid = *job.grid;
  const std::uint8_t* kind = grid.kind + cell;
  const bool whole = count == lane_count && std::all_of(kind, kind + count, [](std::uint8_t k) { return k == owned; });
  for (std::size_t channel = 0; channel < job.colours.channels; ++channel) {
    const Lanes mean = load(colours + channel * layout.size) + load(sums + channel * lane_count) / totals.kernel;
    float* smoothed = job.smoothed + channel * grid.cells() + cell;
    if (whole) {
      store(smoothed, mean);
    } else {
      for (std::size_t l = 0; l < count; ++l)
        if (kind[l] == owned) smoothed[l] = mean[l];
    }
  }
  std::int64_t samples = 0;
  for (std::size_t l = 0; l < count; ++l) samples += kind[l] == owned ? static_cast<std::int64_t>(totals.samples[l]) : 0;
  return samples;
}

// Writes the distances from the first centre.
void write_window(const float* window, int slots, float* distances) {
  for (int slot = 0; slot < slots; ++slot) distances[slot] = window[static_cast<std::size_t>(slot) * centre_count];
}

bool any_owned(const std::uint8_t* kind, std::size_t count) {
  return std::find(kind, kind + count, owned) != kind + count;
}

}  // namespace

std::int64_t sweep_tile(const TileJob& job, const Tile& tile, TileScratch& scratch) {
  const Grid& grid = *job.grid;
  const TileLayout layout(tile, job.program->radius);
  const int side = 2 * job.program->radius + 1;
  // Besides the colours: blocked cells, the scale and the shares.
  const std::size_t colour_planes = job.metric.channels + job.colours.channels + 3;
  scratch.planes.resize((plane_count + colour_planes) * layout.size);
  scratch.window.resize(static_cast<std::size_t>(side * side) * centre_count);
  scratch.sums.resize(job.colours.channels * lane_count);
  float* squared = scratch.planes.data();
  float* lengths = squared + direction_count * layout.size;
  float* coefficients = lengths + direction_count * layout.size;
  float* metric = coefficients + coefficient_planes * layout.size;
  float* colours = metric + job.metric.channels * layout.size;
  copy_to_tile(grid, job.metric, tile, layout, metric);
  copy_to_tile(grid, job.colours, tile, layout, colours);
  float* blocked = colours + job.colours.channels * layout.size;
  float* scale = grid.scale != nullptr ? blocked + layout.size : nullptr;
  if (scale != nullptr) copy_to_tile(grid, grid.scale, tile, layout, 1, scale);
  float* shares = grid.repeats != nullptr ? blocked + 2 * layout.size : nullptr;
  if (shares != nullptr) {
    copy_to_tile(grid, grid.repeats, tile, layout, 1, shares,
               [](std::uint8_t repeats) { return 1 / static_cast<float>(repeats); });
    if (std::all_of(shares, shares + layout.size, [](float share) { return share == 1; })) shares = nullptr;
  }
  measure_edges(job, tile, layout, metric, scale, blocked, squared, lengths);
  for (std::size_t i = 0; i < stencil_classes.size(); ++i)
    make_class(layout, squared, stencil_classes[i], coefficients + 3 * i * layout.size);

  const Course course(job.program->targets, layout);
  std::int64_t samples = 0;
  float* window = scratch.window.data();
  const auto origin = static_cast<std::size_t>(side * side / 2) * centre_count;
  for (std::size_t y = 0; y < tile.rows; ++y)
    for (std::size_t x = 0; x < tile.columns; x += centre_count) {
      const std::size_t cell = (tile.row + y) * grid.columns + tile.column + x;
      const std::size_t count = std::min(centre_count, tile.columns - x);
      if (!any_owned(grid.kind + cell, count)) continue;
      const std::size_t centre = (y + layout.border) * layout.columns + layout.border + x;
      std::fill(scratch.window.begin(), scratch.window.end(), unreached);
      std::fill(window + origin, window + origin + centre_count, 0.0F);
      course.run(lengths + centre, coefficients + centre, window);
      if (job.distances != nullptr) write_window(window, side * side, job.distances);
      for (std::size_t lane = 0; lane < count; lane += lane_count) {
        const Totals totals = shares != nullptr ? weigh<true>(job, layout, shares, centre + lane, window + lane)
                                                : weigh<false>(job, layout, shares, centre + lane, window + lane);
        sum_up_all(job, layout, window + lane, colours + centre + lane, scratch.sums.data());
        samples += write_owned(job, layout, totals, colours + centre + lane, scratch.sums.data(), cell + lane,
                               std::min(lane_count, count - lane));
      }
    }
  return samples;
}

}  // namespace beltrami::grid::BELTRAMI_VARIANT
