#include "triangulated/vertex_order.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <numeric>
#include <stdexcept>

#include "triangulated/morton_order.hpp"

namespace beltrami::triangulated {
namespace {

// A few groups of vertices. Along a Z-order curve four of five edges of even surfaces are within it, and on ten
// sheets upon each other half are.
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

// The faces at every vertex: those at v are faces[offsets[v]] up to offsets[v + 1].
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

std::vector<Index> vertex_order(Rows<double> positions, std::span<const Index> face_corners, Index vertex_count) {
  for (const Index corner : face_corners)
    if (corner < 0 || corner >= vertex_count) throw std::invalid_argument("a face refers to a vertex that is not there");
  auto order = morton_order(positions, vertex_count);
  const auto corners = face_corners.first(face_corners.size() / 3 * 3);
  return are_neighbours_near(order, corners) ? order : breadth_first(order, corners);
}

}  // namespace beltrami::triangulated
