// Grids for Python: the kernel and its preparation.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <cmath>

#include "bindings/bindings.hpp"
#include "grid/local_means.hpp"
#include "grid/repeats.hpp"
#include "grid/squares.hpp"
#include "grid/window_march.hpp"
#include "grid/window_sweep.hpp"
#include "instruction_set.hpp"

namespace beltrami::bindings {
namespace {

using namespace beltrami::grid;

// The planes of a grid: one array, or a list of arrays.
class PlanesOfGrid {
 public:
  PlanesOfGrid(const nb::object& planes, const Cells& like) {
    for (const nb::handle plane : planes) {
      arrays_.push_back(part<Plane>(plane));
      if (arrays_.back().shape(0) != like.shape(0) || arrays_.back().shape(1) != like.shape(1))
        throw nb::value_error("planes must have the grid's shape");
      pointers_.push_back(arrays_.back().data());
    }
  }

  Planes get() const { return {pointers_.data(), pointers_.size()}; }

 private:
  std::vector<Plane> arrays_;
  std::vector<const float*> pointers_;
};

Grid grid_of(const Cells& kind, const Planes& squared_lengths, const std::optional<Plane>& scale,
             const std::optional<Cells>& repeats = {}) {
  if (squared_lengths.channels != direction_count) throw nb::value_error("four planes of lengths are needed");
  Grid grid{kind.shape(0), kind.shape(1), kind.data(), {}, scale ? scale->data() : nullptr, repeats ? repeats->data() : nullptr};
  std::copy_n(squared_lengths.data, direction_count, grid.squared_lengths.begin());
  if (repeats && (repeats->shape(0) != grid.rows || repeats->shape(1) != grid.columns))
    throw nb::value_error("the repeats must have the grid's shape");
  if (scale && (scale->shape(0) != grid.rows || scale->shape(1) != grid.columns))
    throw nb::value_error("the scale must have the grid's shape");
  return grid;
}

// No scheme: sweeps.
std::optional<Scheme> march_of(const std::string& scheme) {
  if (scheme == "sweep") return {};
  require(scheme == "metric" || scheme == "triangles", "a scheme is sweep, triangles or metric");
  return scheme == "metric" ? Scheme::metric : Scheme::triangles;
}

// One kernel iteration on a grid. scheme: "sweep" (window of the given radius), "triangles" or "metric" (heap march).
auto smooth_grid(const Cells& kind, const nb::object& squared_lengths, const std::optional<Plane>& scale,
                 const std::optional<Cells>& repeats, const nb::object& metric, const nb::object& colours, float beta,
                 float time_step, float radius, int window_radius, const std::string& scheme, unsigned threads,
                 const nb::object& progress) {
  const PlanesOfGrid lengths(squared_lengths, kind), of_metric(metric, kind), of_colours(colours, kind);
  const Grid grid = grid_of(kind, lengths.get(), scale, repeats);
  const Planes metric_planes = of_metric.get(), colour_planes = of_colours.get();
  const auto march = march_of(scheme);
  require_metric(beta);
  require_radius(radius);
  require_time_step(time_step);
  require_window(window_radius);
  const SweepParameters parameters{time_step, radius, beta};
  std::unique_ptr<float[]> smoothed(new float[colour_planes.channels * grid.cells()]);
  std::int64_t samples = 0;
  run_polled(progress, [&](const Poll& poll) {
    if (!march)
      samples = smooth_by_sweeps(grid, metric_planes, colour_planes, parameters, make_window_program(window_radius),
                                 smoothed.get(), threads, poll);
    else
      samples = smooth_by_marching(grid, metric_planes, colour_planes, parameters, window_radius, *march,
                                   smoothed.get(), threads, poll);
  });
  return std::make_tuple(give<float, nb::ndim<3>>(std::move(smoothed), {colour_planes.channels, grid.rows, grid.columns}), samples);
}

// The distances of one kernel over its window, with the arguments of smooth_grid; the cell is a flat index.
auto grid_distances(const Cells& kind, const nb::object& squared_lengths, const std::optional<Plane>& scale,
                    const nb::object& metric, float beta, float radius, int window_radius, const std::string& scheme, std::size_t cell) {
  const PlanesOfGrid lengths(squared_lengths, kind), of_metric(metric, kind);
  const Grid grid = grid_of(kind, lengths.get(), scale);
  const Planes metric_planes = of_metric.get();
  if (cell >= grid.cells() || grid.kind[cell] != owned) throw nb::index_error("the cell holds no sample");
  require_window(window_radius);
  require(window_radius > 0, "the window must have a radius");
  require_metric(beta);
  require_radius(radius);
  const auto march = march_of(scheme);
  const SweepParameters parameters{1, radius, beta};
  const auto side = 2 * static_cast<std::size_t>(window_radius) + 1;
  std::unique_ptr<float[]> distances(new float[side * side]);
  {
    const nb::gil_scoped_release unlock;
    if (!march)
      distances_by_sweeps(grid, metric_planes, parameters, make_window_program(window_radius), cell, distances.get());
    else
      distances_by_marching(grid, metric_planes, parameters, window_radius, *march, cell, distances.get());
  }
  return give<float, nb::ndim<2>>(std::move(distances), {side, side});
}

// Planes with contiguous rows, such as some rows of a larger stack.
using Bands = nb::ndarray<const float, nb::ndim<3>, nb::device::cpu>;

// See convolve.
auto convolve_planes(const Bands& planes, const Vector<float>& taps, unsigned threads) {
  if (taps.size() % 2 == 0) throw nb::value_error("an odd number of taps is needed");
  const std::size_t count = planes.shape(0), rows = planes.shape(1), columns = planes.shape(2);
  if ((columns > 1 && planes.stride(2) != 1) || (rows > 1 && planes.stride(1) != static_cast<std::int64_t>(columns)))
    throw nb::value_error("rows must follow each other");
  std::vector<const float*> from;
  for (std::size_t k = 0; k < count; ++k) from.push_back(planes.data() + static_cast<std::int64_t>(k) * planes.stride(0));
  std::unique_ptr<float[]> result(new float[count * rows * columns]);
  {
    const nb::gil_scoped_release unlock;
    convolve({from.data(), count}, rows, columns, {taps.data(), taps.size()}, result.get(), threads);
  }
  return give<float, nb::ndim<3>>(std::move(result), {count, rows, columns});
}

// Factors from squared lengths to the right and below to local units, see local_scale.
auto local_scale_of(const Plane& right, const Plane& below, int window_radius) {
  const std::size_t rows = right.shape(0), columns = right.shape(1);
  if (below.shape(0) != rows || below.shape(1) != columns) throw nb::value_error("both planes must have one shape");
  require_window(window_radius);
  std::unique_ptr<float[]> scale(new float[rows * columns]);
  {
    const nb::gil_scoped_release unlock;
    local_scale(rows, columns, right.data(), below.data(), window_radius, scale.get());
  }
  return give<float, nb::ndim<2>>(std::move(scale), {rows, columns});
}

// Number of halo cells that show the same sample, see count_repeats; cells, sources and seams have one row per halo
// cell.
auto halo_repeats(std::size_t rows, std::size_t columns, const Vector<std::int64_t>& cells,
                  const Vector<std::int64_t>& sources, const Vector<std::int32_t>& seams, int reach, unsigned threads) {
  if (sources.size() != cells.size() || seams.size() != cells.size())
    throw nb::value_error("one row a halo cell is needed");
  require_window(reach);
  require(std::max(rows, columns) < std::size_t{1} << 31, "the grid is too large");  // their product is a size, too
  for (std::size_t i = 0; i < cells.size(); ++i)
    if (cells.data()[i] < 0 || static_cast<std::size_t>(cells.data()[i]) >= rows * columns)
      throw nb::index_error("a halo cell lies outside the grid");
  if (!std::is_sorted(cells.data(), cells.data() + cells.size())) throw nb::value_error("the cells must ascend");
  std::unique_ptr<std::uint8_t[]> repeats(new std::uint8_t[rows * columns]);
  {
    const nb::gil_scoped_release unlock;
    count_repeats(rows, columns, {cells.data(), sources.data(), seams.data(), cells.size()}, reach, repeats.get(), threads);
  }
  return give<std::uint8_t, nb::ndim<2>>(std::move(repeats), {rows, columns});
}

Squares squares_of(const Cells& kind, std::size_t side) {
  if (side == 0) throw nb::value_error("squares must have a side");
  return {kind.shape(0), kind.shape(1), side, kind.data()};
}

template <class Planes>
void check_squares(const Squares& squares, const Cells& kinds, const Planes& planes) {
  if (kinds.shape(0) != squares.down() || kinds.shape(1) != squares.across())
    throw nb::value_error("one kind a square is needed");
  if (planes.shape(1) != squares.rows || planes.shape(2) != squares.columns)
    throw nb::value_error("planes must have the grid's shape");
}

auto means_of_squares_of(const Cells& kind, const Cells& kinds, const Stack& planes, std::size_t side, unsigned threads) {
  const Squares squares = squares_of(kind, side);
  check_squares(squares, kinds, planes);
  std::unique_ptr<float[]> means(new float[planes.shape(0) * kinds.size()]);
  {
    const nb::gil_scoped_release unlock;
    means_of_squares(squares, kinds.data(), planes.data(), planes.shape(0), means.get(), threads);
  }
  return give<float, nb::ndim<3>>(std::move(means), {planes.shape(0), squares.down(), squares.across()});
}

void add_enlarged_to(const Cells& kind, const Cells& kinds, const Stack& changes, const OpenStack& planes, std::size_t side,
                     unsigned threads) {
  const Squares squares = squares_of(kind, side);
  check_squares(squares, kinds, planes);
  if (changes.shape(0) != planes.shape(0) || changes.shape(1) != squares.down() || changes.shape(2) != squares.across())
    throw nb::value_error("one change a square and plane is needed");
  const nb::gil_scoped_release unlock;
  add_enlarged(squares, kinds.data(), changes.data(), changes.shape(0), planes.data(), threads);
}

}  // namespace

void bind_grid(nb::module_& module) {
  using namespace nb::literals;
  module.attr("FURTHEST_SUPPORT") = furthest_support;
  module.attr("SWEEP_TILE_ROWS") = tile_rows;
  module.def("smooth_grid", &smooth_grid, "kind"_a, "squared_lengths"_a, "scale"_a.none(), "repeats"_a.none(),
             "metric"_a, "colours"_a, "beta"_a, "time_step"_a, "radius"_a, "window_radius"_a, "scheme"_a, "threads"_a,
             "progress"_a.none());
  module.def("grid_distances", &grid_distances, "kind"_a, "squared_lengths"_a, "scale"_a.none(), "metric"_a, "beta"_a,
             "radius"_a, "window_radius"_a, "scheme"_a, "cell"_a);
  module.def("halo_repeats", &halo_repeats, "rows"_a, "columns"_a, "cells"_a, "sources"_a, "seams"_a, "reach"_a,
             "threads"_a);
  module.def("local_scale", &local_scale_of, "right"_a, "below"_a, "window_radius"_a);
  module.def("convolve", &convolve_planes, "planes"_a, "taps"_a, "threads"_a);
  module.def("means_of_squares", &means_of_squares_of, "kind"_a, "kinds"_a, "planes"_a, "side"_a, "threads"_a);
  module.def("add_enlarged", &add_enlarged_to, "kind"_a, "kinds"_a, "changes"_a, "planes"_a.noconvert(), "side"_a,
             "threads"_a);
  module.def("sweep_instruction_set", [] { return name_of(choose_instruction_set()); });
}

}  // namespace beltrami::bindings
