// Colours for Python: stored among the pixels of an image, and cut off at limits.
#include <nanobind/stl/tuple.h>

#include <cstdint>
#include <tuple>
#include <vector>

#include "bindings/bindings.hpp"
#include "colours/clipping.hpp"
#include "colours/storing.hpp"

namespace beltrami::bindings {
namespace {

template <class Sample>
using Pixels = nb::ndarray<Sample, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

template <class Sample, class Index>
auto store_colours(const Pixels<Sample>& table, const Vector<Index>& pixels, const Matrix<float>& colours,
                   const Vector<std::int32_t>& channels, unsigned threads) {
  if (colours.shape(0) != pixels.size() || colours.shape(1) != channels.size())
    throw nb::value_error("a row a pixel, and a column a channel, are needed");
  for (std::size_t i = 0; i < channels.size(); ++i)
    if (channels.data()[i] < 0 || static_cast<std::size_t>(channels.data()[i]) >= table.shape(1))
      throw nb::index_error("a pixel has no such channel");
  bool outside = false;
  colours::Moved moved;
  {
    const nb::gil_scoped_release unlock;
    for (std::size_t row = 0; row < pixels.size(); ++row)
      outside |= pixels.data()[row] < 0 || static_cast<std::size_t>(pixels.data()[row]) >= table.shape(0);
    if (!outside)
      moved = colours::store<Sample, Index>({colours.data(), {channels.data(), channels.size()}},
                                            {pixels.data(), pixels.size()}, table.shape(1), table.data(), threads);
  }
  if (outside) throw nb::index_error("a pixel lies outside the image");
  return std::make_tuple(moved.total, moved.squares, moved.largest);
}

colours::Table table_of(const Vector<double>& at, const Vector<double>& values) {
  if (at.size() < 2 || values.size() != at.size()) throw nb::value_error("a table needs two places, and a value at each");
  for (std::size_t i = 1; i < at.size(); ++i) require(at.data()[i - 1] < at.data()[i], "the places of a table must ascend");
  return {{at.data(), at.size()}, {values.data(), values.size()}};
}

// Replaces places by the values there.
void interpolate(nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>& places, const Vector<double>& at,
                 const Vector<double>& table) {
  const colours::Table found = table_of(at, table);
  const nb::gil_scoped_release unlock;
  for (std::size_t i = 0; i < places.size(); ++i) places.data()[i] = found(places.data()[i]);
}

// How a channel was clipped: its noise, and whether at 0 and at 1.
using ClippingParts = std::tuple<float, bool, bool>;

colours::Clipping clipping_of(const ClippingParts& parts) {
  require(std::get<0>(parts) >= 0, "the noise must be a number, 0 or more");
  return {std::get<0>(parts), std::get<1>(parts), std::get<2>(parts)};
}

// See restore; all arrays hold one channel, and `at` the places of both tables.
void restore_clipped(const Channels<float>& averages, const Channels<const float>& share, const ClippingParts& clipping,
                     float trusted, const Vector<double>& at, const Vector<double>& alpha, const Vector<double>& gap,
                     const Channels<const float>& relative, unsigned threads) {
  const std::size_t count = samples_of(averages);
  const auto to = layout_of(averages, 1, count);
  const auto own = layout_of(share, 1, count), variances = layout_of(relative, 1, count);
  require(trusted >= 0, "the trusted noise must be a number, 0 or more");
  const colours::Clipping how = clipping_of(clipping);
  const colours::Table alphas = table_of(at, alpha), gaps = table_of(at, gap);
  const nb::gil_scoped_release unlock;
  colours::restore(to, own, how, trusted, alphas, gaps, {variances, count}, threads);
}

// See impute.
void impute_clipped(const Channels<float>& colours, const Channels<const float>& estimate,
                    const ClippingParts& clipping, const Vector<double>& at, const Vector<double>& beyond,
                    const Channels<const float>& relative, unsigned threads) {
  const std::size_t count = samples_of(colours);
  const auto to = layout_of(colours, 1, count);
  const auto own = layout_of(estimate, 1, count), variances = layout_of(relative, 1, count);
  const colours::Table table = table_of(at, beyond);
  const colours::Clipping how = clipping_of(clipping);
  const nb::gil_scoped_release unlock;
  colours::impute(to, own, how, table, {variances, count}, threads);
}

template <class Sample, class Index>
void bind_store(nb::module_& module) {
  using namespace nb::literals;
  module.def("store_colours", &store_colours<Sample, Index>, "table"_a.noconvert(), "pixels"_a.noconvert(), "colours"_a,
             "channels"_a, "threads"_a);
}

}  // namespace

void bind_colours(nb::module_& module) {
  using namespace nb::literals;
  bind_store<std::uint8_t, std::int32_t>(module);
  bind_store<std::uint8_t, std::int64_t>(module);
  bind_store<std::uint16_t, std::int32_t>(module);
  bind_store<std::uint16_t, std::int64_t>(module);
  module.def("restore_clipped", &restore_clipped, "averages"_a.noconvert(), "share"_a, "clipping"_a, "trusted"_a,
             "at"_a, "alpha"_a, "gap"_a, "relative"_a, "threads"_a);
  module.def("impute_clipped", &impute_clipped, "colours"_a.noconvert(), "estimate"_a, "clipping"_a, "at"_a, "beyond"_a,
             "relative"_a, "threads"_a);
  module.def("interpolate", &interpolate, "places"_a.noconvert(), "at"_a, "table"_a);
}

}  // namespace beltrami::bindings
