// The triangulated kernel for Python.
#include "bindings/triangulated.hpp"

#include <nanobind/stl/optional.h>

#include "bindings/manifold_arrays.hpp"
#include "triangulated/fast_marching.hpp"
#include "triangulated/morton_order.hpp"
#include "triangulated/neighbour_means.hpp"
#include "triangulated/short_time_kernel.hpp"
#include "triangulated/stencils.hpp"
#include "triangulated/topology.hpp"
#include "triangulated/vertex_order.hpp"

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
                     const std::optional<Vector<float>>& scales, unsigned threads, bool unfold) {
    require_rows(positions.shape(0), topology_.vertex_count);
    require_rows(colours.shape(0), topology_.vertex_count);
    if (scales) require_rows(scales->shape(0), topology_.vertex_count);
    const nb::gil_scoped_release unlock;
    const auto squared = squared_edge_lengths(topology_, rows_of(positions), rows_of(colours), beta,
                                              scales ? scales->data() : nullptr, threads);
    update_stencils(stencils_, topology_, squared, unfold ? ObtuseCorners::unfold : ObtuseCorners::edges_only, threads);
  }

  auto smooth(const Matrix<float>& colours, const std::optional<Vector<float>>& weights, float time_step, float radius,
              std::size_t max_samples, unsigned threads, const nb::object& progress) const {
    require_rows(colours.shape(0), topology_.vertex_count);
    if (weights) require_rows(weights->shape(0), topology_.vertex_count);
    const KernelParameters parameters{time_step, radius, max_samples};
    return run_kernel(colours, progress, [&](float* smoothed, const Poll& poll) {
      return triangulated::smooth(stencils_, rows_of(colours), weights ? weights->data() : nullptr, parameters, smoothed,
                                  threads, poll);
    });
  }

  auto distances(Index source, float radius, std::size_t max_samples) const {
    if (source < 0 || source >= topology_.vertex_count) throw nb::index_error("the source is not a vertex");
    FastMarching marching(stencils_);
    return give_reached(marching.march(source, radius, max_samples));
  }

  auto edges() const { return give_edges(topology_.edges); }

  std::int64_t obtuse_corners() const { return stencils_.obtuse_corners; }
  std::size_t split_corners() const { return stencils_.splits.size(); }

 private:
  Topology topology_;
  Stencils stencils_;
};

auto give_order(const std::vector<Index>& order) {
  std::unique_ptr<Index[]> copy(new Index[order.size()]);
  std::copy(order.begin(), order.end(), copy.get());
  return give<Index, nb::ndim<1>>(std::move(copy), {order.size()});
}

auto morton_order_of(const Matrix<double>& positions) {
  return give_order(morton_order(rows_of(positions), static_cast<Index>(positions.shape(0))));
}

auto vertex_order_of(const Matrix<double>& positions, const Matrix<Index>& faces) {
  if (faces.shape(1) != 3) throw nb::value_error("faces must have three corners");
  return give_order(vertex_order(rows_of(positions), {faces.data(), faces.size()}, static_cast<Index>(positions.shape(0))));
}

// See neighbour_means; a row a vertex.
auto neighbour_means_of(const Matrix<float>& values, const Matrix<Index>& edges, const Vector<float>& weights,
                        const Vector<double>& totals) {
  const std::size_t count = totals.size(), width = values.shape(1);
  require_rows(values.shape(0), static_cast<Index>(count));
  if (edges.shape(1) != 2 || edges.shape(0) != weights.size()) throw nb::value_error("each edge needs two ends and a weight");
  for (std::size_t i = 0; i < edges.size(); ++i)
    if (edges.data()[i] < 0 || static_cast<std::size_t>(edges.data()[i]) >= count) throw nb::index_error("an edge has no such vertex");
  std::unique_ptr<float[]> means(new float[count * width]);
  {
    const nb::gil_scoped_release unlock;
    neighbour_means(rows_of(values), {reinterpret_cast<const std::array<Index, 2>*>(edges.data()), edges.shape(0)},
                    weights.data(), {totals.data(), count}, means.get());
  }
  return give<float, nb::ndim<2>>(std::move(means), {count, width});
}

}  // namespace

void bind_triangulated(nb::module_& module) {
  using namespace nb::literals;
  module.def("morton_order", &morton_order_of, "positions"_a);
  module.def("neighbour_means", &neighbour_means_of, "values"_a, "edges"_a, "weights"_a, "totals"_a);
  module.def("vertex_order", &vertex_order_of, "positions"_a, "faces"_a);
  nb::class_<TriangulatedManifold>(module, "TriangulatedManifold")
      .def(nb::init<const Matrix<Index>&, Index>(), "faces"_a, "vertex_count"_a)
      .def("update_metric", &TriangulatedManifold::update_metric, "positions"_a, "colours"_a, "beta"_a, "scales"_a.none(),
           "threads"_a, "unfold"_a = true)
      .def("smooth", &TriangulatedManifold::smooth, "colours"_a, "weights"_a.none(), "time_step"_a, "radius"_a,
           "max_samples"_a, "threads"_a, "progress"_a.none())
      .def("distances", &TriangulatedManifold::distances, "source"_a, "radius"_a, "max_samples"_a)
      .def("edges", &TriangulatedManifold::edges)
      .def_prop_ro("obtuse_corners", &TriangulatedManifold::obtuse_corners)
      .def_prop_ro("split_corners", &TriangulatedManifold::split_corners);
}

}  // namespace beltrami::bindings
