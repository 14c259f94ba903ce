// Compiled several times, with BELTRAMI_VARIANT naming the namespace and the compiler's flags the instruction set.
// Contraction to fused multiply-add is off for all, so that every variant gives the same bits.
#include "parametric/sweep_tile.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "parametric/lanes.hpp"

namespace beltrami::parametric::BELTRAMI_VARIANT {
namespace {

// Larger than any distance in a window, and far below where adding lengths would round to itself wrongly.
constexpr float unreached = 1e8F;

// Planes of the tile and its border: lengths of the four edges, then three coefficients for each stencil class.
constexpr std::size_t coefficient_planes = 3 * stencil_classes.size();
constexpr std::size_t plane_count = 2 * direction_count + coefficient_planes;

struct Layout {
  Layout(const Tile& tile, int window_radius)
      : border(static_cast<std::size_t>(window_radius) + 1),
        rows(tile.rows + 2 * border),
        // Whole blocks of lanes, and room for the loads of the last one.
        columns(((tile.columns + lane_count - 1) / lane_count) * lane_count + 2 * border),
        size(rows * columns + lane_count) {}
  std::size_t border, rows, columns, size;
  std::ptrdiff_t at(Offset offset) const { return offset.y * static_cast<std::ptrdiff_t>(columns) + offset.x; }
};

// Copies a plane of the grid to the tile and its border, each value converted; `fill` stands outside the grid.
template <class T, class Convert>
void copy_plane(const Grid& grid, const T* plane, const Tile& tile, const Layout& layout, float fill, float* out,
                Convert convert) {
  std::fill(out, out + layout.size, fill);
  // The grid's rectangle in the tile's planes.
  const auto first = [&](std::size_t begin) { return begin < layout.border ? layout.border - begin : 0; };
  const std::size_t left = first(tile.column), top = first(tile.row);
  const std::size_t right_end = std::min(layout.columns, grid.columns + layout.border - tile.column);
  const std::size_t bottom = std::min(layout.rows, grid.rows + layout.border - tile.row);
  for (std::size_t y = top; y < bottom; ++y) {
    const T* row = plane + (tile.row + y - layout.border) * grid.columns + (tile.column + left - layout.border);
    std::transform(row, row + (right_end - left), out + y * layout.columns + left, convert);
  }
}

void copy_plane(const Grid& grid, const float* plane, const Tile& tile, const Layout& layout, float fill, float* out) {
  copy_plane(grid, plane, tile, layout, fill, out, [](float value) { return value; });
}

void copy_planes(const Grid& grid, Planes planes, const Tile& tile, const Layout& layout, float* out) {
  for (std::size_t channel = 0; channel < planes.channels; ++channel)
    copy_plane(grid, planes.data + channel * grid.cells(), tile, layout, 0, out + channel * layout.size);
}

// |dX|^2 + beta^2 |dI|^2 of every edge in the tile and its border; no_edge where there is none.
void measure_edges(const TileJob& job, const Tile& tile, const Layout& layout, const float* metric,
                   const float* scale, float* blocked, float* squared, float* lengths) {
  const Grid& grid = *job.grid;
  const float squared_beta = job.parameters->beta * job.parameters->beta;
  copy_plane(grid, grid.kind, tile, layout, no_edge, blocked,
             [](std::uint8_t kind) { return kind == empty ? no_edge : 0.0F; });
  const std::array<std::size_t, direction_count> steps{1, layout.columns, layout.columns + 1, layout.columns - 1};
  for (std::size_t direction = 0; direction < direction_count; ++direction) {
    float* __restrict total = squared + direction * layout.size;
    copy_plane(grid, grid.squared_lengths + direction * grid.cells(), tile, layout, no_edge, total);
    if (scale != nullptr)
      for (std::size_t i = 0; i < layout.size; ++i) total[i] *= scale[i];
    const std::size_t last = layout.size - steps[direction];
    const float* __restrict blocked_there = blocked + steps[direction];
    for (std::size_t i = 0; i < last; ++i) total[i] += blocked[i] + blocked_there[i];
    for (std::size_t channel = 0; channel < job.metric.channels; ++channel) {
      const float* __restrict from = metric + channel * layout.size;
      const float* __restrict to = from + steps[direction];
      for (std::size_t i = 0; i < last; ++i) total[i] += squared_beta * ((to[i] - from[i]) * (to[i] - from[i]));
    }
    float* __restrict length = lengths + direction * layout.size;
    for (std::size_t i = 0; i < layout.size; ++i) {
      total[i] = total[i] < no_edge ? total[i] : no_edge;
      length[i] = std::sqrt(total[i]);
    }
  }
}

void make_class(const Layout& layout, const float* squared, const StencilClass& stencil, float* out) {
  const auto plane = [&](EdgePlace place) { return squared + place.plane * layout.size + layout.at(place.cell); };
  const float* __restrict a = plane(edge_place({0, 0}, stencil.diagonal));
  const float* __restrict b = plane(edge_place({0, 0}, stencil.axis));
  const float* __restrict c = plane(edge_place(stencil.axis, stencil.diagonal - stencil.axis));
  float* __restrict k = out;
  float* __restrict height = out + layout.size;
  float* __restrict n = out + 2 * layout.size;
  // One cell in from every side, where all neighbours are at hand; further out no window reaches.
  const std::size_t first = layout.columns + 1, last = (layout.rows - 1) * layout.columns - 1;
  for (std::size_t i = first; i < last; ++i) {
    const float inverse = 1 / c[i];
    const float slope = (b[i] + c[i] - a[i]) * 0.5F * inverse;
    const float squared_height = b[i] - slope * slope * c[i];
    const bool usable = (a[i] + b[i] >= c[i]) & (a[i] < no_edge) & (b[i] < no_edge) & (c[i] < no_edge) & (c[i] > 0) &
                        (squared_height > 0);
    k[i] = usable ? slope : 0;
    height[i] = usable ? squared_height : 0;
    n[i] = usable ? squared_height * inverse : 0;
  }
}

// The pass over one list of targets for the centres that begin at `centre` in the tile's planes.
void pass(const std::vector<Target>& targets, const Layout& layout, const float* lengths, const float* coefficients,
          std::size_t centre, float* window) {
  for (const Target& target : targets) {
    float* phi = window + static_cast<std::size_t>(target.slot) * lane_count;
    Lanes best = load(phi);
    for (const EdgeStep& edge : target.edges) {
      const float* length = lengths + edge.plane * layout.size + centre + layout.at(edge.cell);
      best = smaller(load(window + static_cast<std::size_t>(edge.from) * lane_count) + load(length), best);
    }
    const float* cell = coefficients + centre + layout.at(target.offset);
    for (const TriangleStep& triangle : target.triangles) {
      const float* k_plane = cell + 3 * triangle.stencil_class * layout.size;
      const Lanes axis = load(window + static_cast<std::size_t>(triangle.axis) * lane_count);
      const Lanes u = load(window + static_cast<std::size_t>(triangle.diagonal) * lane_count) - axis;
      const Lanes k = load(k_plane), nu = load(k_plane + 2 * layout.size) * u;
      const Lanes radicand = load(k_plane + layout.size) - nu * u;
      const Lanes s = square_root(larger(radicand, Lanes{}));
      const Lanes through = axis + k * u + s;
      const Mask from_within = (k * s > nu) & (k * s - s < nu);
      best = select(from_within, smaller(through, best), best);
    }
    store(phi, best);
  }
}

struct Averages {
  Lanes held, total;
  float* sums;  // lane_count a channel
};

// Sums over the window's cells within the radius, as differences from the centres, so that a constant stays. `shares`
// is what each cell of the tile counts for, if it is not 1 for all.
template <bool shared>
Averages average(const TileJob& job, const Layout& layout, const float* window, const float* colours,
                 const float* shares, std::size_t centre, float* sums) {
  const float factor = -1 / (4 * job.parameters->time_step);
  const float reach = std::min(job.parameters->radius, longest_radius);
  Averages averages{splat(1), splat(1), sums};
  std::fill(sums, sums + job.colours.channels * lane_count, 0.0F);
  for (const Target& target : job.program->outward) {
    const Lanes phi = load(window + static_cast<std::size_t>(target.slot) * lane_count);
    const Mask within = phi <= reach;
    const Lanes distance = select(within, phi, Lanes{});
    const std::ptrdiff_t step = layout.at(target.offset);
    Lanes kernel = select(within, exponential(distance * distance * factor), Lanes{});
    if constexpr (shared) kernel = kernel * load(shares + centre + step);
    averages.held += select(within, splat(1), Lanes{});
    averages.total += kernel;
    const float* here = colours + centre;
    for (float* sum = sums; sum != sums + job.colours.channels * lane_count; sum += lane_count, here += layout.size)
      store(sum, load(sum) + kernel * (load(here + step) - load(here)));
  }
  return averages;
}

// Writes the owned ones of `count` centres, which are those from `cell` on in the grid; returns their samples.
std::int64_t write_owned(const TileJob& job, const Averages& averages, std::size_t cell, std::size_t count) {
  const Grid& grid = *job.grid;
  std::int64_t samples = 0;
  for (std::size_t l = 0; l < count; ++l) {
    if (grid.kind[cell + l] != owned) continue;
    samples += static_cast<std::int64_t>(averages.held[l]);
    for (std::size_t channel = 0; channel < job.colours.channels; ++channel) {
      const std::size_t place = channel * grid.cells() + cell + l;
      job.smoothed[place] = job.colours.data[place] + averages.sums[channel * lane_count + l] / averages.total[l];
    }
  }
  return samples;
}

// Writes the distances from the first centre.
void write_window(const float* window, int slots, float* distances) {
  for (int slot = 0; slot < slots; ++slot) distances[slot] = window[static_cast<std::size_t>(slot) * lane_count];
}

bool any_owned(const std::uint8_t* kind, std::size_t count) {
  return std::find(kind, kind + count, owned) != kind + count;
}

}  // namespace

std::int64_t sweep_tile(const TileJob& job, const Tile& tile, TileScratch& scratch) {
  const Grid& grid = *job.grid;
  const Layout layout(tile, job.program->radius);
  const int side = 2 * job.program->radius + 1;
  // Besides the colours, what is blocked, the scale and the shares.
  const std::size_t colour_planes = job.metric.channels + job.colours.channels + 3;
  scratch.planes.resize((plane_count + colour_planes) * layout.size);
  scratch.window.resize(static_cast<std::size_t>(side * side) * lane_count);
  scratch.sums.resize(job.colours.channels * lane_count);
  float* squared = scratch.planes.data();
  float* lengths = squared + direction_count * layout.size;
  float* coefficients = lengths + direction_count * layout.size;
  float* metric = coefficients + coefficient_planes * layout.size;
  float* colours = metric + job.metric.channels * layout.size;
  copy_planes(grid, job.metric, tile, layout, metric);
  copy_planes(grid, job.colours, tile, layout, colours);
  float* blocked = colours + job.colours.channels * layout.size;
  float* scale = grid.scale != nullptr ? blocked + layout.size : nullptr;
  if (scale != nullptr) copy_plane(grid, grid.scale, tile, layout, 1, scale);
  float* shares = grid.repeats != nullptr ? blocked + 2 * layout.size : nullptr;
  if (shares != nullptr)
    copy_plane(grid, grid.repeats, tile, layout, 1, shares,
               [](std::uint8_t repeats) { return 1 / static_cast<float>(repeats); });
  measure_edges(job, tile, layout, metric, scale, blocked, squared, lengths);
  for (std::size_t i = 0; i < stencil_classes.size(); ++i)
    make_class(layout, squared, stencil_classes[i], coefficients + 3 * i * layout.size);

  std::int64_t samples = 0;
  float* window = scratch.window.data();
  const auto origin = static_cast<std::size_t>(side * side / 2) * lane_count;
  for (std::size_t y = 0; y < tile.rows; ++y)
    for (std::size_t x = 0; x < tile.columns; x += lane_count) {
      const std::size_t cell = (tile.row + y) * grid.columns + tile.column + x;
      const std::size_t count = std::min(lane_count, tile.columns - x);
      if (!any_owned(grid.kind + cell, count)) continue;
      const std::size_t centre = (y + layout.border) * layout.columns + layout.border + x;
      std::fill(scratch.window.begin(), scratch.window.end(), unreached);
      std::fill(window + origin, window + origin + lane_count, 0.0F);
      pass(job.program->outward, layout, lengths, coefficients, centre, window);
      for (int repair = 0; repair < job.parameters->repairs; ++repair)
        pass(job.program->repair, layout, lengths, coefficients, centre, window);
      if (job.distances != nullptr) write_window(window, side * side, job.distances);
      const Averages averages =
          shares != nullptr ? average<true>(job, layout, window, colours, shares, centre, scratch.sums.data())
                            : average<false>(job, layout, window, colours, shares, centre, scratch.sums.data());
      samples += write_owned(job, averages, cell, count);
    }
  return samples;
}

}  // namespace beltrami::parametric::BELTRAMI_VARIANT
