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

// A group whose region would hold more vertices has none: its kernels are so large that a march costs no more.
constexpr std::size_t largest_region = 2048;

struct VertexGroups {
  std::vector<Index> members;  // of all groups in turn: group g owns [16 g, 16 g + 16), the last what is left

  // The regions of block b's groups follow each other in regions[b], region g ending before ends[g].
  std::vector<std::vector<Index>> regions;
  std::vector<std::uint32_t> ends;  // [group]

  std::size_t count() const { return (members.size() + group_size - 1) / group_size; }
  std::span<const Index> sources(std::size_t group) const;
  // In the order in which distances are best updated; empty if it would be too large.
  std::span<const Index> region(std::size_t group) const;
};

// Cuts the vertices into groups by bisecting space, within blocks that follow each other in memory.
VertexGroups make_groups(Rows<double> positions, Index vertex_count, unsigned threads);

// Finds the vertices within the radius of a group's members, along segments of the metric without colours: colours make
// no path shorter, so that the regions hold for any.
void find_regions(VertexGroups& groups, const Segments& segments, float radius, unsigned threads,
                  const Poll& poll = {});

}  // namespace beltrami::triangulated
