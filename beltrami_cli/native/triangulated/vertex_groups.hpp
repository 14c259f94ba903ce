// Groups of neighbouring vertices, whose kernels are computed side by side, and the regions that these can reach.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "parallel.hpp"
#include "triangulated/metric.hpp"
#include "triangulated/segments.hpp"

namespace beltrami::triangulated {

constexpr std::size_t group_size = 16;

struct VertexGroups {
  std::vector<Index> members;  // of all groups in turn: group g owns [16 g, 16 g + 16), the last what is left

  std::size_t count() const { return (members.size() + group_size - 1) / group_size; }
  std::span<const Index> sources(std::size_t group) const;
};

// Cuts the vertices into groups, within blocks that follow each other in memory: by bisecting space, or, where neighbours
// in space are hardly joined by segments, by gathering those that are.
VertexGroups make_groups(Rows<double> positions, const Segments& segments, unsigned threads);

}  // namespace beltrami::triangulated
