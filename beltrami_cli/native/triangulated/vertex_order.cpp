#include "triangulated/vertex_order.hpp"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <numeric>
#include <stdexcept>

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

// Distance in the order that counts as near: a few groups of vertices. Along a Z-order curve four of five edges of even
// surfaces are shorter, and half of those on ten stacked sheets.
constexpr Index close_by = 64;

std::vector<Index> invert(const std::vector<Index>& order) {
  std::vector<Index> rank(order.size());
  for (std::size_t i = 0; i < order.size(); ++i) rank[static_cast<std::size_t>(order[i])] = static_cast<Index>(i);
  return rank;
}

bool are_neighbours_near(const std::vector<Index>& order, std::span<const Index> corners) {
  const auto rank = invert(order);
  std::size_t count = 0;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const std::size_t next = i % 3 == 2 ? i - 2 : i + 1;
    const Index apart = rank[static_cast<std::size_t>(corners[i])] - rank[static_cast<std::size_t>(corners[next])];
    count += std::abs(apart) <= close_by;
  }
  return 3 * count >= corners.size();
}

// The faces at every vertex v: faces[offsets[v]] up to offsets[v + 1].
struct Incidence {
  std::vector<std::uint32_t> offsets;
  std::vector<std::uint32_t> faces;
};

Incidence faces_at_vertices(std::span<const Index> corners, std::size_t vertex_count) {
  Incidence at{std::vector<std::uint32_t>(vertex_count + 1, 0), std::vector<std::uint32_t>(corners.size())};
  for (const Index corner : corners) ++at.offsets[static_cast<std::size_t>(corner)];
  // Every entry is first the end of its list, and its beginning once the list is filled.
  std::inclusive_scan(at.offsets.begin(), at.offsets.end(), at.offsets.begin());
  for (std::size_t i = corners.size(); i-- > 0;)
    at.faces[--at.offsets[static_cast<std::size_t>(corners[i])]] = static_cast<std::uint32_t>(i / 3);
  return at;
}

// Breadth first from the first vertex of every component.
std::vector<Index> breadth_first(const std::vector<Index>& seeds, std::span<const Index> corners) {
  const Incidence at = faces_at_vertices(corners, seeds.size());
  std::vector<bool> found(seeds.size(), false);
  std::vector<Index> order;
  order.reserve(seeds.size());
  const auto find = [&](Index vertex) {
    if (found[static_cast<std::size_t>(vertex)]) return;
    found[static_cast<std::size_t>(vertex)] = true;
    order.push_back(vertex);
  };
  std::size_t next = 0;
  for (const Index seed : seeds)
    for (find(seed); next < order.size(); ++next) {
      const auto vertex = static_cast<std::size_t>(order[next]);
      for (std::uint32_t i = at.offsets[vertex]; i < at.offsets[vertex + 1]; ++i)
        for (std::size_t k = 0; k < 3; ++k) find(corners[3 * std::size_t{at.faces[i]} + k]);
    }
  return order;
}

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

std::vector<Index> vertex_order(Rows<double> positions, std::span<const Index> face_corners, Index vertex_count) {
  for (const Index corner : face_corners)
    if (corner < 0 || corner >= vertex_count) throw std::invalid_argument("a face refers to a vertex that is not there");
  auto order = morton_order(positions, vertex_count);
  const auto corners = face_corners.first(face_corners.size() / 3 * 3);
  return are_neighbours_near(order, corners) ? order : breadth_first(order, corners);
}

}  // namespace beltrami::triangulated
