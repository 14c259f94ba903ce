// The kernel along segments for Python.
#include "bindings/segments.hpp"

#include <nanobind/stl/optional.h>

#include "bindings/manifold_arrays.hpp"
#include "triangulated/segment_kernel.hpp"

namespace beltrami::bindings {
namespace {

using namespace beltrami::triangulated;

class SegmentManifold {
 public:
  SegmentManifold(const Matrix<Index>& faces, Index vertex_count) {
    if (faces.shape(1) != 3) throw nb::value_error("faces must have three corners");
    const nb::gil_scoped_release unlock;
    kernel_.emplace(std::span(faces.data(), faces.size()), vertex_count);
  }

  void update_metric(const Matrix<double>& positions, const Matrix<float>& colours, double beta,
                     const std::optional<Vector<float>>& scales, unsigned threads) {
    require_rows(positions.shape(0), count());
    require_rows(colours.shape(0), count());
    if (scales) require_rows(scales->shape(0), count());
    const nb::gil_scoped_release unlock;
    kernel_->update_metric(rows_of(positions), rows_of(colours), beta, scales ? scales->data() : nullptr, threads);
  }

  auto smooth(const Matrix<float>& colours, const std::optional<Vector<float>>& weights, float time_step, float radius,
              std::size_t max_samples, unsigned threads, const nb::object& progress) {
    require_rows(colours.shape(0), count());
    if (weights) require_rows(weights->shape(0), count());
    return run_kernel(colours, progress, [&](float* smoothed, const Poll& poll) {
      return kernel_->smooth(rows_of(colours), weights ? weights->data() : nullptr, {time_step, radius, max_samples},
                             smoothed, threads, poll);
    });
  }

  auto distances(Index source, float radius, std::size_t max_samples) const {
    if (source < 0 || source >= count()) throw nb::index_error("the source is not a vertex");
    return give_reached(kernel_->distances(source, radius, max_samples));
  }

  auto edges() const { return give_edges(kernel_->edges()); }

 private:
  Index count() const { return kernel_->vertex_count(); }

  std::optional<SegmentKernel> kernel_;
};

}  // namespace

void bind_segments(nb::module_& module) {
  using namespace nb::literals;
  nb::class_<SegmentManifold>(module, "SegmentManifold")
      .def(nb::init<const Matrix<Index>&, Index>(), "faces"_a, "vertex_count"_a)
      .def("update_metric", &SegmentManifold::update_metric, "positions"_a, "colours"_a, "beta"_a, "scales"_a.none(), "threads"_a)
      .def("smooth", &SegmentManifold::smooth, "colours"_a, "weights"_a.none(), "time_step"_a, "radius"_a,
           "max_samples"_a, "threads"_a, "progress"_a.none())
      .def("distances", &SegmentManifold::distances, "source"_a, "radius"_a, "max_samples"_a)
      .def("edges", &SegmentManifold::edges);
}

}  // namespace beltrami::bindings
