// Triangulated manifolds for Python: both solvers, by fast marching and along segments, and orders of vertices.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <array>
#include <span>
#include <tuple>

#include "bindings/bindings.hpp"
#include "triangulated/fast_marching.hpp"
#include "triangulated/metric.hpp"
#include "triangulated/segment_kernel.hpp"
#include "triangulated/short_time_kernel.hpp"
#include "triangulated/stencils.hpp"
#include "triangulated/topology.hpp"
#include "triangulated/vertex_order.hpp"

namespace beltrami::bindings {
namespace {

using namespace beltrami::triangulated;
using Numbers = std::optional<Vector<float>>;  // one a vertex, if there are any

template <class T>
Rows<T> rows_of(const Matrix<T>& matrix) {
  return {matrix.data(), matrix.shape(1)};
}

const float* data_of(const Numbers& numbers) { return numbers ? numbers->data() : nullptr; }

std::span<const Index> corners_of(const Matrix<Index>& faces) {
  if (faces.shape(1) != 3) throw nb::value_error("faces must have three corners");
  return {faces.data(), faces.size()};
}

void require_rows(std::size_t rows, Index vertex_count) {
  if (rows != static_cast<std::size_t>(vertex_count)) throw nb::value_error("one row a vertex is needed");
}

void require_rows(const Numbers& numbers, Index vertex_count) {
  if (numbers) require_rows(numbers->shape(0), vertex_count);
}

// Kernels by fast marching, with the interface of SegmentKernel.
class MarchKernel {
 public:
  MarchKernel(std::span<const Index> face_corners, Index vertex_count)
      : topology_(make_topology(face_corners, vertex_count)), stencils_(make_stencils(topology_)) {}

  Index vertex_count() const { return topology_.vertex_count; }
  bool has_metric() const { return has_metric_; }

  void update_metric(Rows<double> positions, Rows<float> colours, double beta, const float* scales, unsigned threads) {
    has_metric_ = true;
    update_stencils(stencils_, topology_, squared_edge_lengths(topology_, positions, colours, beta, scales, threads), threads);
  }

  KernelStatistics smooth(Rows<float> colours, const float* weights, const KernelParameters& parameters, float* smoothed,
                          unsigned threads, const Poll& poll) const {
    return triangulated::smooth(stencils_, colours, weights, parameters, smoothed, threads, poll);
  }

  std::vector<Reached> distances(Index source, float radius, std::size_t max_samples) const {
    FastMarching marching(stencils_);
    const auto reached = marching.march(source, radius, max_samples);
    return {reached.begin(), reached.end()};
  }

  const std::vector<std::array<Index, 2>>& edges() const { return topology_.edges; }

 private:
  Topology topology_;
  Stencils stencils_;
  bool has_metric_ = false;
};

template <class Kernel>
void make_kernel(Kernel* kernel, const Matrix<Index>& faces, Index vertex_count) {
  const auto corners = corners_of(faces);
  require(vertex_count >= 0, "the number of vertices must be 0 or more");
  const nb::gil_scoped_release unlock;
  new (kernel) Kernel(corners, vertex_count);
}

template <class Kernel>
void update_metric(Kernel& kernel, const Matrix<double>& positions, const Matrix<float>& colours, double beta,
                   const Numbers& scales, unsigned threads) {
  require_rows(positions.shape(0), kernel.vertex_count());
  require_rows(colours.shape(0), kernel.vertex_count());
  require_rows(scales, kernel.vertex_count());
  require_finite(positions);
  require_metric(beta);
  const nb::gil_scoped_release unlock;
  kernel.update_metric(rows_of(positions), rows_of(colours), beta, data_of(scales), threads);
}

template <class Kernel>
void require_march(const Kernel& kernel, float radius, std::size_t max_samples) {
  require(kernel.has_metric() || kernel.vertex_count() == 0, "update_metric comes first");
  require_radius(radius);
  require(max_samples > 0, "a kernel has at least one sample");
}

// Returns the rows of smoothed colours (undefined for vertices outside [first, last)), the number of samples in all
// kernels, and the number of truncated kernels.
template <class Kernel>
auto smooth_manifold(Kernel& kernel, const Matrix<float>& colours, const Numbers& weights, float time_step,
                     float radius, std::size_t max_samples, unsigned threads, const nb::object& progress, Index first,
                     std::optional<Index> last) {
  require_rows(colours.shape(0), kernel.vertex_count());
  require_rows(weights, kernel.vertex_count());
  require_time_step(time_step);
  require_march(kernel, radius, max_samples);
  const KernelParameters parameters{time_step, radius, max_samples, first, last.value_or(kernel.vertex_count())};
  require(0 <= first && first <= parameters.last && parameters.last <= kernel.vertex_count(), "there are no such vertices");
  std::unique_ptr<float[]> smoothed(new float[colours.size()]);
  KernelStatistics statistics;
  run_polled(progress, [&](const Poll& poll) {
    statistics = kernel.smooth(rows_of(colours), data_of(weights), parameters, smoothed.get(), threads, poll);
  });
  return std::make_tuple(give<float, nb::ndim<2>>(std::move(smoothed), {colours.shape(0), colours.shape(1)}),
                         statistics.samples, statistics.truncated);
}

// Vertices, and their distances.
template <class Kernel>
auto manifold_distances(const Kernel& kernel, Index source, float radius, std::size_t max_samples) {
  if (source < 0 || source >= kernel.vertex_count()) throw nb::index_error("the source is not a vertex");
  require_march(kernel, radius, max_samples);
  const auto reached = kernel.distances(source, radius, max_samples);
  std::vector<Index> vertices;
  std::vector<float> distances;
  for (const auto& [vertex, distance] : reached) {
    vertices.push_back(vertex);
    distances.push_back(distance);
  }
  return std::make_tuple(give_copy(vertices), give_copy(distances));
}

auto morton_order_of(const Matrix<double>& positions) {
  require_finite(positions);
  return give_copy(morton_order(rows_of(positions), static_cast<Index>(positions.shape(0))));
}

auto vertex_order_of(const Matrix<double>& positions, const Matrix<Index>& faces) {
  require_finite(positions);
  return give_copy(vertex_order(rows_of(positions), corners_of(faces), static_cast<Index>(positions.shape(0))));
}

// See neighbour_means; a row a vertex.
auto neighbour_means_of(const Matrix<float>& values, const Matrix<Index>& edges, const Vector<float>& weights,
                        const Vector<double>& totals, unsigned threads) {
  const std::size_t count = totals.size(), width = values.shape(1);
  require_rows(values.shape(0), static_cast<Index>(count));
  if (edges.shape(1) != 2 || edges.shape(0) != weights.size())
    throw nb::value_error("each edge needs two ends and a weight");
  for (std::size_t i = 0; i < edges.size(); ++i)
    if (edges.data()[i] < 0 || static_cast<std::size_t>(edges.data()[i]) >= count)
      throw nb::index_error("an edge has no such vertex");
  std::unique_ptr<float[]> means(new float[count * width]);
  {
    const nb::gil_scoped_release unlock;
    neighbour_means(rows_of(values), {reinterpret_cast<const std::array<Index, 2>*>(edges.data()), edges.shape(0)},
                    weights.data(), {totals.data(), count}, means.get(), threads);
  }
  return give<float, nb::ndim<2>>(std::move(means), {count, width});
}

template <class Kernel>
void bind_manifold(nb::module_& module, const char* name) {
  using namespace nb::literals;
  nb::class_<Kernel>(module, name)
      .def("__init__", &make_kernel<Kernel>, "faces"_a, "vertex_count"_a)
      .def("update_metric", &update_metric<Kernel>, "positions"_a, "colours"_a, "beta"_a, "scales"_a.none(), "threads"_a)
      .def("smooth", &smooth_manifold<Kernel>, "colours"_a, "weights"_a.none(), "time_step"_a, "radius"_a,
           "max_samples"_a, "threads"_a, "progress"_a.none(), "first"_a = 0, "last"_a = nb::none())
      .def("distances", &manifold_distances<Kernel>, "source"_a, "radius"_a, "max_samples"_a)
      .def("edges", [](const Kernel& kernel) { return give_rows(kernel.edges()); });
}

}  // namespace

void bind_triangulated(nb::module_& module) {
  using namespace nb::literals;
  module.def("morton_order", &morton_order_of, "positions"_a);
  module.def("neighbour_means", &neighbour_means_of, "values"_a, "edges"_a, "weights"_a, "totals"_a,
             "threads"_a);
  module.def("vertex_order", &vertex_order_of, "positions"_a, "faces"_a);
  bind_manifold<MarchKernel>(module, "TriangulatedManifold");
  bind_manifold<SegmentKernel>(module, "SegmentManifold");
}

}  // namespace beltrami::bindings
