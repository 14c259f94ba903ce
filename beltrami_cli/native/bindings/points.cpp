// Local triangulation of points for Python.
#include "bindings/points.hpp"

#include <algorithm>
#include <span>

#include "bindings/arrays.hpp"
#include "points/agreement.hpp"
#include "points/local_stars.hpp"

namespace beltrami::bindings {
namespace {

using namespace beltrami::points;

// Gathers the stars of a cloud, which are asked for in any portions, and makes them agree.
class LocalTriangulation {
 public:
  explicit LocalTriangulation(const Matrix<double>& positions) {
    if (positions.shape(1) != 3) throw nb::value_error("positions must have three columns");
    positions_.assign(positions.data(), positions.data() + positions.size());
    spacing_.assign(positions.shape(0), 0);
    flatness_ = distance_ = spacing_;
  }

  // Returns the rows that are to be asked for again with more neighbours.
  auto add_stars(const Vector<Index>& rows, const Matrix<Index>& neighbours, bool complete, bool last, unsigned threads) {
    if (neighbours.shape(0) != rows.size()) throw nb::value_error("one row of neighbours a point is needed");
    const std::span<const Index> points{rows.data(), rows.size()};
    require_points(points);
    require_points({neighbours.data(), neighbours.size()});
    std::vector<Index> unsettled;
    {
      const nb::gil_scoped_release unlock;
      Stars stars =
          find_stars(positions_.data(), {points, neighbours.data(), neighbours.shape(1), complete}, last, threads);
      keep(points, stars);
      unsettled = std::move(stars.unsettled);
      std::sort(unsettled.begin(), unsettled.end());
    }
    std::unique_ptr<Index[]> copy(new Index[unsettled.size()]);
    std::copy(unsettled.begin(), unsettled.end(), copy.get());
    return give<Index, nb::ndim<1>>(std::move(copy), {unsettled.size()});
  }

  auto faces() const {
    std::vector<Triangle> agreed;
    {
      const nb::gil_scoped_release unlock;
      auto spacing = spacing_;
      discard_outliers(spacing, flatness_, distance_);
      agreed = agreed_triangles(positions_.data(), spacing, triangles_);
    }
    std::unique_ptr<Index[]> corners(new Index[3 * agreed.size()]);
    for (std::size_t i = 0; i < agreed.size(); ++i) std::copy(agreed[i].begin(), agreed[i].end(), corners.get() + 3 * i);
    return give<Index, nb::shape<-1, 3>>(std::move(corners), {agreed.size(), 3});
  }

 private:
  void require_points(std::span<const Index> points) const {
    const auto count = static_cast<Index>(spacing_.size());
    if (std::any_of(points.begin(), points.end(), [count](Index point) { return point < 0 || point >= count; }))
      throw nb::index_error("not a point of the cloud");
  }

  void keep(std::span<const Index> points, const Stars& stars) {
    for (std::size_t row = 0; row < points.size(); ++row) {
      const auto point = static_cast<std::size_t>(points[row]);
      spacing_[point] = stars.spacing[row];
      flatness_[point] = stars.flatness[row];
      distance_[point] = stars.distance[row];
    }
    triangles_.insert(triangles_.end(), stars.triangles.begin(), stars.triangles.end());
  }

  std::vector<double> positions_, spacing_, flatness_, distance_;
  std::vector<Triangle> triangles_;
};

}  // namespace

void bind_points(nb::module_& module) {
  using namespace nb::literals;
  nb::class_<LocalTriangulation>(module, "LocalTriangulation")
      .def(nb::init<const Matrix<double>&>(), "positions"_a)
      .def("add_stars", &LocalTriangulation::add_stars, "rows"_a, "neighbours"_a, "complete"_a, "last"_a, "threads"_a)
      .def("faces", &LocalTriangulation::faces);
}

}  // namespace beltrami::bindings
