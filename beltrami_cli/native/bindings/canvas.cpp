// Colours on a canvas, for Python: put there, taken from there, smoothed for the metric, and looked at for noise.
#include "bindings/canvas.hpp"

#include <nanobind/stl/tuple.h>

#include <cstdint>

#include "bindings/arrays.hpp"
#include "colours/moving.hpp"
#include "parametric/gaussian_means.hpp"
#include "parametric/haar_tiles.hpp"

namespace beltrami::bindings {
namespace {

using Stack = nb::ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Filled = nb::ndarray<const bool, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using OpenStack = nb::ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using OpenMatrix = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// Throws if there is not a row a cell, or a cell lies outside.
template <class Index, class Planes, class Rows>
void check(const Planes& planes, const Vector<Index>& cells, const Rows& rows) {
  if (rows.shape(0) != cells.size() || rows.shape(1) != planes.shape(0))
    throw nb::value_error("a row a cell, and a colour a plane, are needed");
  const std::size_t size = planes.shape(1) * planes.shape(2);
  bool outside = false;
  for (std::size_t i = 0; i < cells.size(); ++i)
    outside |= cells.data()[i] < 0 || static_cast<std::size_t>(cells.data()[i]) >= size;
  if (outside) throw nb::index_error("a cell lies outside the canvas");
}

template <class Value, class Planes>
colours::Planes<Value> planes_of(const Planes& planes) {
  return {planes.data(), planes.shape(1) * planes.shape(2), planes.shape(0)};
}

// No cell may be named twice.
template <class Index>
void put_colours(const OpenStack& planes, const Vector<Index>& cells, const Matrix<float>& rows, unsigned threads) {
  check(planes, cells, rows);
  const nb::gil_scoped_release unlock;
  colours::put<Index>(planes_of<float>(planes), {cells.data(), cells.size()}, rows.data(), threads);
}

template <class Index>
void take_colours(const Stack& planes, const Vector<Index>& cells, const OpenMatrix& rows, unsigned threads) {
  check(planes, cells, rows);
  const nb::gil_scoped_release unlock;
  colours::take<Index>(planes_of<const float>(planes), {cells.data(), cells.size()}, rows.data(), threads);
}

auto convolve_planes(const Stack& planes, const Vector<float>& taps, unsigned threads) {
  if (taps.size() % 2 == 0) throw nb::value_error("an odd number of taps is needed");
  std::unique_ptr<float[]> result(new float[planes.size()]);
  {
    const nb::gil_scoped_release unlock;
    parametric::convolve(planes.data(), planes.shape(0), planes.shape(1), planes.shape(2), {taps.data(), taps.size()},
                         result.get(), threads);
  }
  return give<float, nb::ndim<3>>(std::move(result), {planes.shape(0), planes.shape(1), planes.shape(2)});
}

// See measure_tiles; returns counts, shape (bands, tiles), and measures, shape (measures, planes, bands, tiles).
auto measure_haar_tiles(const Stack& planes, const Filled& filled, const Vector<std::int64_t>& first_rows) {
  const parametric::FilledPlanes all{planes.data(), planes.shape(0), planes.shape(1), planes.shape(2), filled.data()};
  if (filled.shape(0) != all.rows || filled.shape(1) != all.columns) throw nb::value_error("planes must have the grid's shape");
  for (std::size_t i = 0; i < first_rows.size(); ++i)
    if (first_rows.data()[i] < 0 || static_cast<std::size_t>(first_rows.data()[i]) >= all.rows)
      throw nb::index_error("a band starts outside the grid");
  const std::size_t bands = first_rows.size(), tiles = parametric::tiles_across(all.columns);
  std::unique_ptr<std::int32_t[]> counts(new std::int32_t[bands * tiles]);
  std::unique_ptr<double[]> measures(new double[parametric::tile_measures * all.count * bands * tiles]);
  {
    const nb::gil_scoped_release unlock;
    parametric::measure_tiles(all, {first_rows.data(), bands}, counts.get(), measures.get());
  }
  return std::make_tuple(give<std::int32_t, nb::ndim<2>>(std::move(counts), {bands, tiles}),
                         give<double, nb::ndim<4>>(std::move(measures), {parametric::tile_measures, all.count, bands, tiles}));
}

template <class Index>
void bind_moves(nb::module_& module) {
  using namespace nb::literals;
  module.def("put_colours", &put_colours<Index>, "planes"_a.noconvert(), "cells"_a.noconvert(), "colours"_a, "threads"_a);
  module.def("take_colours", &take_colours<Index>, "planes"_a, "cells"_a.noconvert(), "colours"_a.noconvert(), "threads"_a);
}

}  // namespace

void bind_canvas(nb::module_& module) {
  using namespace nb::literals;
  bind_moves<std::int32_t>(module);
  bind_moves<std::int64_t>(module);
  module.attr("HAAR_TILE") = parametric::tile_side;
  module.def("measure_haar_tiles", &measure_haar_tiles, "planes"_a, "filled"_a, "first_rows"_a);
  module.def("convolve", &convolve_planes, "planes"_a, "taps"_a, "threads"_a);
}

}  // namespace beltrami::bindings
