// Rows of colours, for Python: stored among the pixels of an image, and looked at for what was cut off.
#include "bindings/colours.hpp"

#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <tuple>
#include <vector>

#include "bindings/arrays.hpp"
#include "colours/limits.hpp"
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

// Of every channel: the least and the largest value, and how many are 0 and 1.
auto find_limits(const Matrix<float>& colours) {
  std::vector<colours::Limits> found;
  {
    const nb::gil_scoped_release unlock;
    found = colours::find_limits(colours.data(), colours.shape(0), colours.shape(1));
  }
  std::vector<std::tuple<float, float, std::size_t, std::size_t>> rows;
  for (const colours::Limits& channel : found)
    rows.emplace_back(channel.least, channel.most, channel.at_0, channel.at_1);
  return rows;
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
  module.def("find_limits", &find_limits, "colours"_a);
}

}  // namespace beltrami::bindings
