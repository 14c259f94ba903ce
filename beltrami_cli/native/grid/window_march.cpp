#include "grid/window_march.hpp"

#include <algorithm>
#include <limits>
#include <vector>

#include "triangulated/fast_marching.hpp"
#include "triangulated/short_time_kernel.hpp"

namespace beltrami::grid {
namespace {

using triangulated::GridPlace;

std::vector<GridPlace> places_of(const CellNumbers& numbers, std::size_t columns) {
  std::vector<GridPlace> places(numbers.cell_of.size());
  std::transform(numbers.cell_of.begin(), numbers.cell_of.end(), places.begin(), [&](std::size_t cell) {
    return GridPlace{static_cast<std::int32_t>(cell / columns), static_cast<std::int32_t>(cell % columns)};
  });
  return places;
}

}  // namespace

std::int64_t smooth_by_marching(const Grid& grid, Planes metric, Planes colours, const SweepParameters& parameters,
                                int window_radius, Scheme scheme, float* smoothed, unsigned threads, const Poll& poll) {
  const CellNumbers numbers = number_cells(grid);
  const auto stencils = make_grid_stencils(grid, numbers, metric, parameters.beta, scheme, threads);
  const std::size_t count = numbers.cell_of.size();
  std::vector<float> rows(count * colours.channels), result(rows.size());
  std::vector<std::uint8_t> wanted(count);
  std::vector<float> shares(grid.repeats != nullptr ? count : 0);
  const auto places = window_radius > 0 ? places_of(numbers, grid.columns) : std::vector<GridPlace>();
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t cell = numbers.cell_of[i];
    wanted[i] = grid.kind[cell] == owned;
    if (!shares.empty()) shares[i] = 1 / static_cast<float>(grid.repeats[cell]);
    for (std::size_t channel = 0; channel < colours.channels; ++channel)
      rows[i * colours.channels + channel] = colours[channel][cell];
  }
  const Poll cell_poll = poll ? Poll([&](std::size_t done) { return poll(done * grid.cells() / count); }) : Poll();
  const triangulated::Selection selection{wanted.data(), window_radius > 0 ? places.data() : nullptr, window_radius};
  const triangulated::KernelParameters kernel{parameters.time_step, std::min(parameters.radius, longest_radius), count};
  const auto statistics =
      triangulated::smooth(stencils, {rows.data(), colours.channels}, shares.empty() ? nullptr : shares.data(), kernel,
                           result.data(), threads, cell_poll, selection);
  copy_planes(colours, grid.cells(), planes_of(smoothed, grid, colours.channels).data(), threads);
  for (std::size_t i = 0; i < count; ++i)
    if (wanted[i])
      for (std::size_t channel = 0; channel < colours.channels; ++channel)
        smoothed[channel * grid.cells() + numbers.cell_of[i]] = result[i * colours.channels + channel];
  return statistics.samples;
}

void distances_by_marching(const Grid& grid, Planes metric, const SweepParameters& parameters, int window_radius,
                           Scheme scheme, std::size_t cell, float* distances) {
  const CellNumbers numbers = number_cells(grid);
  const auto stencils = make_grid_stencils(grid, numbers, metric, parameters.beta, scheme, 1);
  const auto places = places_of(numbers, grid.columns);
  const Index source = numbers.number_of[cell];
  triangulated::FastMarching marching(stencils, {nullptr, places.data(), window_radius});
  const std::ptrdiff_t side = 2 * window_radius + 1;
  std::fill(distances, distances + side * side, std::numeric_limits<float>::infinity());
  for (const auto& [number, distance] : marching.march(source, std::min(parameters.radius, longest_radius), places.size())) {
    const GridPlace here = places[static_cast<std::size_t>(number)], centre = places[static_cast<std::size_t>(source)];
    distances[(here.row - centre.row + window_radius) * side + here.column - centre.column + window_radius] = distance;
  }
}

}  // namespace beltrami::grid
