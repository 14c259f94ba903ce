// Collaborative patches for Python.
#include <nanobind/stl/optional.h>

#include <array>
#include <vector>

#include "parallel.hpp"
#include "patches/blending.hpp"
#include "patches/grid_patches.hpp"
#include "patches/surface_patches.hpp"

#include "bindings/bindings.hpp"

namespace beltrami::bindings {
namespace {

using namespace beltrami::patches;

const nb::tuple& parts_of(const nb::tuple& parts, std::size_t count) {
  require(parts.size() == count, "a tuple has other parts");
  return parts;
}

template <class Stacks>
void check_shape(const Stack& like, const Stacks& other) {
  for (std::size_t axis = 0; axis < 3; ++axis)
    if (other.shape(axis) != like.shape(axis)) throw nb::value_error("all stacks must have one shape");
}

// See Mixing, and the arrays that it points to.
struct MixingArrays {
  Matrix<float> forth, back;
  Vector<float> variances, shrinkage;
  Mixing mixing;

  MixingArrays(const nb::tuple& parts, std::size_t channels)
      : forth(part<Matrix<float>>(parts_of(parts, 6)[0])), back(part<Matrix<float>>(parts[1])),
        variances(part<Vector<float>>(parts[2])), shrinkage(part<Vector<float>>(parts[3])),
        mixing{forth.data(), back.data(), variances.data(), shrinkage.data(), part<float>(parts[4]), part<float>(parts[5])} {
    require(mixing.least_ratio >= 0 && mixing.strength >= 0, "ratio and strength must be numbers, 0 or more");
    for (const auto* matrix : {&forth, &back})
      if (matrix->shape(0) != channels || matrix->shape(1) != channels) throw nb::value_error("mixing must be square");
    for (const auto* values : {&variances, &shrinkage})
      if (values->size() != channels) throw nb::value_error("one variance and one shrinkage a channel are needed");
  }
};

// See collaborate; without a pilot, patches are still compared on `pilot`. Writes to `estimates`, which may be the
// pilot.
void collaborate_on_grid(const Cells& kind, const Stack& noisy, const Stack& pilot, const nb::tuple& mixing,
                         const std::optional<Plane>& relative, bool has_pilot, OpenStack& estimates, unsigned threads,
                         const nb::object& progress) {
  const std::size_t channels = noisy.shape(0), rows = kind.shape(0), columns = kind.shape(1);
  check_shape(noisy, pilot);
  check_shape(noisy, estimates);
  if (noisy.shape(1) != rows || noisy.shape(2) != columns) throw nb::value_error("planes must have the grid's shape");
  if (relative && (relative->shape(0) != rows || relative->shape(1) != columns))
    throw nb::value_error("the relative variance must have the grid's shape");
  const MixingArrays own(mixing, channels);
  const Canvas canvas{{noisy.data(), pilot.data(), channels, own.mixing, relative ? relative->data() : nullptr},
                      rows, columns, kind.data()};
  run_polled(progress, [&](const Poll& poll) {
    collaborate(canvas, has_pilot, estimates.data(), threads, poll);
  });
}

using WritableRows = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// See SurfacePatches; edges are pairs of vertices, axes two directions.
void make_surface_patches(SurfacePatches* surface, const Matrix<double>& positions, const Matrix<std::int32_t>& edges,
                          const Matrix<double>& axes, const Vector<std::uint64_t>& priorities, unsigned threads,
                          const std::optional<Vector<std::int32_t>>& blocks) {
  if (positions.shape(1) != 3 || edges.shape(1) != 2 || axes.shape(0) != 2 || axes.shape(1) != 3)
    throw nb::value_error("positions, edges and axes need rows of 3, 2 and 3");
  if (priorities.size() != positions.shape(0)) throw nb::value_error("one priority a vertex is needed");
  if (blocks && blocks->size() != positions.shape(0)) throw nb::value_error("one block a vertex is needed");
  for (std::size_t i = 0; i < edges.size(); ++i)
    if (edges.data()[i] < 0 || static_cast<std::size_t>(edges.data()[i]) >= positions.shape(0))
      throw nb::index_error("an edge ends at no vertex");
  require_finite(positions);
  require_finite(axes);
  const auto* directions = reinterpret_cast<const Position*>(axes.data());
  const nb::object no_progress = nb::none();
  run_polled(no_progress, [&](const Poll& poll) {
    new (surface) SurfacePatches({reinterpret_cast<const Position*>(positions.data()), positions.shape(0)},
                                 {reinterpret_cast<const std::array<std::int32_t, 2>*>(edges.data()), edges.shape(0)},
                                 {directions[0], directions[1]}, {priorities.data(), priorities.size()}, threads,
                                 blocks ? blocks->data() : nullptr, poll);
  });
}

// See SurfacePatches::collaborate; a row a vertex.
void collaborate_on_surface(const SurfacePatches& surface, const Matrix<float>& noisy, const Matrix<float>& pilot,
                            const nb::tuple& mixing, const std::optional<Vector<float>>& relative, bool has_pilot,
                            WritableRows& estimates, WritableRows& weights, unsigned threads, const nb::object& progress) {
  const std::size_t channels = noisy.shape(1);
  const MixingArrays own(mixing, channels);
  if (relative && relative->size() != surface.size()) throw nb::value_error("one relative variance a vertex is needed");
  if (noisy.shape(0) != surface.size()) throw nb::value_error("one row a vertex is needed");
  for (std::size_t axis = 0; axis < 2; ++axis)
    if (pilot.shape(axis) != noisy.shape(axis) || estimates.shape(axis) != noisy.shape(axis) ||
        weights.shape(axis) != noisy.shape(axis))
      throw nb::value_error("all stacks must have one shape");
  const Colours colours{noisy.data(), pilot.data(), channels, own.mixing, relative ? relative->data() : nullptr};
  run_polled(progress, [&](const Poll& poll) {
    surface.collaborate(colours, has_pilot, {estimates.data(), weights.data()}, threads, poll);
  });
}

// Calls f with ranges of samples, on several threads.
template <class F>
void in_ranges(std::size_t count, unsigned threads, F f) {
  constexpr std::size_t samples_per_chunk = 1 << 12;
  parallel_chunks(count, samples_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) { f(Range{begin, end}); });
}

// The noise from Python: a row (variance, sigma, low, high) per channel, tables of a limit, and relative variances.
class NoiseOfBlend {
 public:
  explicit NoiseOfBlend(const nb::tuple& parts, std::size_t channels, std::size_t samples)
      : rows_(part<Matrix<float>>(parts_of(parts, 5)[0])),
        lost_(part<Vector<float>>(parts[2])),
        share_(part<Vector<float>>(parts[3])),
        relative_(part<Channels<const float>>(parts[4])) {
    if (rows_.shape(0) != channels || rows_.shape(1) != 4) throw nb::value_error("a row of 4 a channel is needed");
    if (lost_.size() < 2 || share_.size() != lost_.size()) throw nb::value_error("both tables need as many values");
    for (std::size_t k = 0; k < channels; ++k) {
      const float* row = rows_.data() + 4 * k;
      noise_.push_back({row[0], row[1], row[2] != 0, row[3] != 0});
    }
    const NormalTables tables{part<float>(parts[1]), {lost_.data(), lost_.size()}, {share_.data(), share_.size()}};
    require(tables.furthest > 0, "the tables must reach further than 0");
    blend_ = {noise_, tables, layout_of(relative_, 1, samples)};
  }

  const BlendNoise& get() const { return blend_; }

 private:
  Matrix<float> rows_;
  Vector<float> lost_, share_;
  Channels<const float> relative_;
  std::vector<ChannelNoise> noise_;
  BlendNoise blend_;
};

// See blend_terms; `estimates`: both estimates, and both after the perturbation.
void write_blend_terms(const Channels<const float>& noisy, const Channels<const float>& probe, const nb::tuple& estimates,
                       const nb::tuple& noise, const Channels<float>& terms, unsigned threads) {
  const std::size_t channels = channels_of(noisy), count = samples_of(noisy);
  const NoiseOfBlend own(noise, channels, count);
  parts_of(estimates, 4);
  std::array<Channels<const float>, 4> stacks;
  std::array<Values, 4> values;
  for (std::size_t i = 0; i < 4; ++i) {
    stacks[i] = part<Channels<const float>>(estimates[i]);
    values[i] = layout_of(stacks[i], channels, count);
  }
  const Values z = layout_of(noisy, channels, count), b = layout_of(probe, channels, count);
  const Layout<float> to = layout_of(terms, 2, count);
  const nb::gil_scoped_release unlock;
  const auto write = best_blend_terms();
  const Estimates both{values[0], values[1], values[2], values[3]};
  in_ranges(count, threads, [&](const Range& samples) { write(z, b, both, own.get(), samples, to); });
}

// See blend_residual.
void write_blend_residual(const Channels<const float>& noisy, const Channels<const float>& estimate, const nb::tuple& noise,
                          const Channels<float>& residual, unsigned threads) {
  const std::size_t channels = channels_of(noisy), count = samples_of(noisy);
  const NoiseOfBlend own(noise, channels, count);
  const Values z = layout_of(noisy, channels, count), p = layout_of(estimate, channels, count);
  const Layout<float> to = layout_of(residual, channels, count);
  const nb::gil_scoped_release unlock;
  const auto write = best_blend_residual();
  in_ranges(count, threads, [&](const Range& samples) { write(z, p, own.get(), samples, to); });
}

// See blend_share_within.
void write_blend_share_within(const Channels<const float>& estimate, const nb::tuple& noise, const Channels<float>& share,
                              unsigned threads) {
  const std::size_t channels = channels_of(estimate), count = samples_of(estimate);
  const NoiseOfBlend own(noise, channels, count);
  const Values p = layout_of(estimate, channels, count);
  const Layout<float> to = layout_of(share, channels, count);
  const nb::gil_scoped_release unlock;
  const auto write = best_blend_share_within();
  in_ranges(count, threads, [&](const Range& samples) { write(p, own.get(), samples, to); });
}

}  // namespace

void bind_patches(nb::module_& module) {
  using namespace nb::literals;
  module.attr("PATCH_REACH") = patch_reach;
  module.attr("PATCH_BLOCK_SIZE") = block_size;
  module.attr("PATCH_TILE_SIDE") = beltrami::patches::tile_side;
  module.attr("PATCH_TILE_MARGIN") = margin;
  module.def("blend_terms", &write_blend_terms, "noisy"_a, "probe"_a, "estimates"_a, "noise"_a, "terms"_a.noconvert(),
             "threads"_a);
  module.def("blend_residual", &write_blend_residual, "noisy"_a, "estimate"_a, "noise"_a, "residual"_a.noconvert(),
             "threads"_a);
  module.def("blend_share_within", &write_blend_share_within, "estimate"_a, "noise"_a, "share"_a.noconvert(), "threads"_a);
  module.def("collaborate_on_grid", &collaborate_on_grid, "kind"_a, "noisy"_a, "pilot"_a, "mixing"_a,
             "relative"_a.none(), "has_pilot"_a, "estimates"_a, "threads"_a, "progress"_a.none());
  nb::class_<SurfacePatches>(module, "SurfacePatches")
      .def("__init__", &make_surface_patches, "positions"_a, "edges"_a, "axes"_a, "priorities"_a, "threads"_a,
           "blocks"_a = nb::none())
      .def("collaborate", &collaborate_on_surface, "noisy"_a, "pilot"_a, "mixing"_a,
           "relative"_a.none(), "has_pilot"_a, "estimates"_a, "weights"_a, "threads"_a, "progress"_a.none());
}

}  // namespace beltrami::bindings
