// Local triangulation of points for Python.
#include <algorithm>
#include <span>

#include "bindings/bindings.hpp"
#include "points/local_triangulation.hpp"

namespace beltrami::bindings {
namespace {

using namespace beltrami::points;

void make(LocalTriangulation* triangulation, const Matrix<double>& positions) {
  if (positions.shape(1) != 3) throw nb::value_error("positions must have three columns");
  require_finite(positions);
  new (triangulation) LocalTriangulation({positions.data(), positions.size()});
}

void require_points(std::span<const Index> points, Index count) {
  if (std::any_of(points.begin(), points.end(), [count](Index point) { return point < 0 || point >= count; }))
    throw nb::index_error("not a point of the cloud");
}

auto add_stars(LocalTriangulation& triangulation, const Vector<Index>& rows, const Matrix<Index>& neighbours,
               bool complete, bool keep_unsettled, unsigned threads) {
  if (neighbours.shape(0) != rows.size()) throw nb::value_error("one row of neighbours a point is needed");
  const Neighbours given{{rows.data(), rows.size()}, neighbours.data(), neighbours.shape(1), complete};
  require_points(given.rows, triangulation.point_count());
  require_points({neighbours.data(), neighbours.size()}, triangulation.point_count());
  std::vector<Index> unsettled;
  {
    const nb::gil_scoped_release unlock;
    unsettled = triangulation.add_stars(given, keep_unsettled, threads);
  }
  return give_copy(unsettled);
}

auto faces(LocalTriangulation& triangulation) {
  std::vector<Triangle> found;
  {
    const nb::gil_scoped_release unlock;
    found = triangulation.faces();
  }
  return give_rows(std::move(found));
}

}  // namespace

void bind_points(nb::module_& module) {
  using namespace nb::literals;
  nb::class_<LocalTriangulation>(module, "LocalTriangulation")
      .def("__init__", &make, "positions"_a.noconvert(), nb::keep_alive<1, 2>())
      .def("add_stars", &add_stars, "rows"_a, "neighbours"_a, "complete"_a, "keep_unsettled"_a, "threads"_a)
      .def("faces", &faces);
}

}  // namespace beltrami::bindings
