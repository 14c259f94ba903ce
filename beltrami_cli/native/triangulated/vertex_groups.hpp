// Groups of neighbouring vertices, whose kernels are computed in parallel lanes, and the regions they can reach.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "parallel.hpp"
#include "triangulated/metric.hpp"
#include "triangulated/segments.hpp"

namespace beltrami::triangulated {

constexpr std::size_t group_size = 16;

// A segment between two vertices of a group, with the same length in both directions.
struct InnerSegment {
  std::uint32_t place;     // in the lists of segments
  std::uint16_t from, to;  // numbers in the group
};

struct VertexGroup {
  std::span<const Index> sources;
  std::span<const InnerSegment> inner;
};

struct VertexGroups {
  std::vector<Index> members;                // of all groups in turn: group g owns [16 g, 16 g + 16), the last the remainder
  std::vector<InnerSegment> inner;           // of all groups in turn
  std::vector<std::uint32_t> inner_offsets;  // [group], one more at the end

  std::size_t count() const { return (members.size() + group_size - 1) / group_size; }
  VertexGroup group(std::size_t number) const;
};

// Divides the vertices into groups, within contiguous blocks: by bisecting space or, if neighbours in space are seldom
// joined by segments, by collecting joined ones.
VertexGroups make_groups(Rows<double> positions, const Segments& segments, unsigned threads);

}  // namespace beltrami::triangulated
