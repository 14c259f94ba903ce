// Estimates of noise for Python.
#include <nanobind/stl/optional.h>

#include <array>
#include <cstdint>

#include "bindings/bindings.hpp"
#include "noise/pilot.hpp"

namespace beltrami::bindings {
namespace {

using SquareStack = nb::ndarray<const float, nb::ndim<4>, nb::c_contig, nb::device::cpu>;
using Filled = nb::ndarray<const bool, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

noise::Variances variances_of(const Vector<float>& variances, std::size_t samples) {
  require(variances.size() == 1 || variances.size() == samples, "one variance is needed, or one a sample");
  return {variances.data(), variances.size() == 1};
}

// See smooth_squares; planes of squares.
auto pilot_of_squares(const SquareStack& colours, const std::optional<Filled>& filled, const Vector<float>& variances) {
  require(colours.shape(0) == noise::channels, "three channels are needed");
  const std::size_t count = colours.shape(1), side = colours.shape(2);
  require(colours.shape(3) == side, "squares must be as wide as they are high");
  require(!filled || (filled->shape(0) == count && filled->shape(1) == side && filled->shape(2) == side),
          "filled cells must have the shape of the squares");
  const noise::PilotSquares squares{count, side, filled ? filled->data() : nullptr,
                             variances_of(variances, count * side * side)};
  std::unique_ptr<float[]> pilot(new float[colours.size()]);
  {
    const nb::gil_scoped_release unlock;
    noise::smooth_squares(squares, colours.data(), pilot.get());
  }
  return give<float, nb::ndim<4>>(std::move(pilot), {noise::channels, count, side, side});
}

// See smooth_graph; a row a channel.
auto pilot_of_graph(const Plane& colours, const Matrix<std::int64_t>& edges, const Vector<float>& variances) {
  require(colours.shape(0) == noise::channels, "three channels are needed");
  require(edges.shape(1) == 2, "each edge needs two ends");
  const std::size_t count = colours.shape(1);
  for (std::size_t i = 0; i < edges.size(); ++i)
    if (edges.data()[i] < 0 || static_cast<std::size_t>(edges.data()[i]) >= count)
      throw nb::index_error("an edge has no such sample");
  const noise::Variances own = variances_of(variances, count);
  std::unique_ptr<float[]> pilot(new float[colours.size()]);
  {
    const nb::gil_scoped_release unlock;
    noise::smooth_graph(colours.data(), count,
                 {reinterpret_cast<const std::array<std::int64_t, 2>*>(edges.data()), edges.shape(0)}, own, pilot.get());
  }
  return give<float, nb::ndim<2>>(std::move(pilot), {noise::channels, count});
}

}  // namespace

void bind_noise(nb::module_& module) {
  using namespace nb::literals;
  module.def("pilot_of_squares", &pilot_of_squares, "colours"_a, "filled"_a.none(), "variances"_a);
  module.def("pilot_of_graph", &pilot_of_graph, "colours"_a, "edges"_a, "variances"_a);
}

}  // namespace beltrami::bindings
