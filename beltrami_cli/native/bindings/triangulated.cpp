// The triangulated kernel for Python.
#include "bindings/triangulated.hpp"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <tuple>

#include "bindings/arrays.hpp"
#include "triangulated/fast_marching.hpp"
#include "triangulated/morton_order.hpp"
#include "triangulated/short_time_kernel.hpp"
#include "triangulated/stencils.hpp"
#include "triangulated/topology.hpp"

namespace beltrami::bindings {
namespace {

using namespace beltrami::triangulated;

class TriangulatedManifold {
 public:
  TriangulatedManifold(const Matrix<Index>& faces, Index vertex_count) {
    if (faces.shape(1) != 3) throw nb::value_error("faces must have three corners");
    const nb::gil_scoped_release unlock;
    topology_ = make_topology({faces.data(), faces.size()}, vertex_count);
    stencils_ = make_stencils(topology_);
  }

  void update_metric(const Matrix<double>& positions, const Matrix<float>& colours, double beta,
                     const std::optional<Vector<float>>& scales, bool unfold, unsigned threads) {
    require_rows(positions.shape(0));
    require_rows(colours.shape(0));
    if (scales) require_rows(scales->shape(0));
    const nb::gil_scoped_release unlock;
    const auto squared = squared_edge_lengths(topology_, rows_of(positions), rows_of(colours), beta,
                                              scales ? scales->data() : nullptr, threads);
    update_stencils(stencils_, topology_, squared, unfold ? ObtuseCorners::unfold : ObtuseCorners::edges_only, threads);
  }

  auto smooth(const Matrix<float>& colours, const std::optional<Vector<float>>& weights, float time_step, float radius,
              std::size_t max_samples, unsigned threads, const nb::object& progress) const {
    require_rows(colours.shape(0));
    if (weights) require_rows(weights->shape(0));
    const KernelParameters parameters{time_step, radius, max_samples};
    std::unique_ptr<float[]> smoothed(new float[colours.size()]);
    PythonPoll python_poll(progress);
    KernelStatistics statistics;
    try {
      const nb::gil_scoped_release unlock;
      statistics = triangulated::smooth(stencils_, rows_of(colours), weights ? weights->data() : nullptr, parameters,
                                        smoothed.get(), threads, python_poll.poll());
    } catch (const Cancelled&) {
      python_poll.rethrow();
      throw;
    }
    return std::make_tuple(
        give<float, nb::ndim<2>>(std::move(smoothed), {colours.shape(0), colours.shape(1)}),
        statistics.samples, statistics.truncated);
  }

  auto distances(Index source, float radius, std::size_t max_samples) const {
    if (source < 0 || source >= topology_.vertex_count) throw nb::index_error("the source is not a vertex");
    FastMarching marching(stencils_);
    const auto reached = marching.march(source, radius, max_samples);
    std::unique_ptr<Index[]> vertices(new Index[reached.size()]);
    std::unique_ptr<float[]> distances(new float[reached.size()]);
    for (std::size_t i = 0; i < reached.size(); ++i) {
      vertices[i] = reached[i].vertex;
      distances[i] = reached[i].distance;
    }
    return std::make_tuple(give<Index, nb::ndim<1>>(std::move(vertices), {reached.size()}),
                           give<float, nb::ndim<1>>(std::move(distances), {reached.size()}));
  }

  auto edges() const {
    const auto count = topology_.edges.size();
    std::unique_ptr<Index[]> copy(new Index[2 * count]);
    for (std::size_t i = 0; i < count; ++i) {
      copy[2 * i] = topology_.edges[i][0];
      copy[2 * i + 1] = topology_.edges[i][1];
    }
    return give<Index, nb::shape<-1, 2>>(std::move(copy), {count, 2});
  }

  std::int64_t obtuse_corners() const { return stencils_.obtuse_corners; }
  std::size_t split_corners() const { return stencils_.splits.size(); }

 private:
  void require_rows(std::size_t rows) const {
    if (rows != static_cast<std::size_t>(topology_.vertex_count)) throw nb::value_error("one row a vertex is needed");
  }

  Topology topology_;
  Stencils stencils_;
};

auto morton_order_of(const Matrix<double>& positions) {
  const auto order = morton_order(rows_of(positions), static_cast<Index>(positions.shape(0)));
  std::unique_ptr<Index[]> copy(new Index[order.size()]);
  std::copy(order.begin(), order.end(), copy.get());
  return give<Index, nb::ndim<1>>(std::move(copy), {order.size()});
}

}  // namespace

void bind_triangulated(nb::module_& module) {
  using namespace nb::literals;
  module.def("morton_order", &morton_order_of, "positions"_a);
  nb::class_<TriangulatedManifold>(module, "TriangulatedManifold")
      .def(nb::init<const Matrix<Index>&, Index>(), "faces"_a, "vertex_count"_a)
      .def("update_metric", &TriangulatedManifold::update_metric, "positions"_a, "colours"_a, "beta"_a, "scales"_a.none(), "unfold"_a,
           "threads"_a)
      .def("smooth", &TriangulatedManifold::smooth, "colours"_a, "weights"_a.none(), "time_step"_a, "radius"_a,
           "max_samples"_a, "threads"_a, "progress"_a.none())
      .def("distances", &TriangulatedManifold::distances, "source"_a, "radius"_a, "max_samples"_a)
      .def("edges", &TriangulatedManifold::edges)
      .def_prop_ro("obtuse_corners", &TriangulatedManifold::obtuse_corners)
      .def_prop_ro("split_corners", &TriangulatedManifold::split_corners);
}

}  // namespace beltrami::bindings
