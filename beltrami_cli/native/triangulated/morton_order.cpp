#include "triangulated/morton_order.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>

namespace beltrami::triangulated {
namespace {

// Three coordinates of 21 bits fill a 64-bit code.
constexpr std::uint64_t cells = (1U << 21) - 1;

// Puts two zero bits between the 21 low bits of x.
std::uint64_t spread_bits(std::uint64_t x) {
  x = (x | x << 32) & 0x001f00000000ffffU;
  x = (x | x << 16) & 0x001f0000ff0000ffU;
  x = (x | x << 8) & 0x100f00f00f00f00fU;
  x = (x | x << 4) & 0x10c30c30c30c30c3U;
  x = (x | x << 2) & 0x1249249249249249U;
  return x;
}

struct Keyed {
  std::uint64_t code;
  Index vertex;
  bool operator<(const Keyed& other) const {
    return code != other.code ? code < other.code : vertex < other.vertex;
  }
};

}  // namespace

std::vector<Index> morton_order(Rows<double> positions, Index vertex_count) {
  const std::size_t axes = std::min<std::size_t>(positions.width, 3);
  std::array<double, 3> low{}, high{};
  low.fill(std::numeric_limits<double>::infinity());
  high.fill(-std::numeric_limits<double>::infinity());
  for (Index v = 0; v < vertex_count; ++v)
    for (std::size_t axis = 0; axis < axes; ++axis) {
      low[axis] = std::min(low[axis], positions[v][axis]);
      high[axis] = std::max(high[axis], positions[v][axis]);
    }
  double extent = 0;  // one scale for all axes, so that cells are cubes
  for (std::size_t axis = 0; axis < axes; ++axis) extent = std::max(extent, high[axis] - low[axis]);
  const double scale = extent > 0 ? static_cast<double>(cells) / extent : 0;

  std::vector<Keyed> keyed(static_cast<std::size_t>(vertex_count));
  for (Index v = 0; v < vertex_count; ++v) {
    std::uint64_t code = 0;
    for (std::size_t axis = 0; axis < axes; ++axis)
      code |= spread_bits(static_cast<std::uint64_t>((positions[v][axis] - low[axis]) * scale)) << axis;
    keyed[static_cast<std::size_t>(v)] = {code, v};
  }
  std::sort(keyed.begin(), keyed.end());
  std::vector<Index> order;
  order.reserve(keyed.size());
  for (const auto& entry : keyed) order.push_back(entry.vertex);
  return order;
}

}  // namespace beltrami::triangulated
