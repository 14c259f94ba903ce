// The kernels of one group, in parallel lanes; compiled once for each instruction set from the same source.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "instruction_set.hpp"
#include "triangulated/metric.hpp"
#include "triangulated/segments.hpp"
#include "triangulated/short_time_kernel.hpp"
#include "triangulated/vertex_groups.hpp"

namespace beltrami::triangulated {

struct GroupJob {
  const Segments* segments;
  Rows<float> colours;
  const float* weights;  // w_q of every vertex, or nullptr for 1
  KernelParameters parameters;
  float* smoothed;
};

// A vertex reached by any kernel of a group.
struct alignas(64) RegionPlace {
  std::array<float, group_size> nearest;   // its shortest distance from each source that is known so far
  std::array<float, group_size> distance;  // the one passed on to other vertices last: in the end, the shortest
  // The value of each kernel at the vertex, in memory that is free once distances are known.
  std::array<float, group_size>& kernel() { return nearest; }
};

// Vertices reached by the kernels of a group, once distances are known.
struct Region {
  std::span<const Index> vertices;
  std::span<RegionPlace> places;  // of the vertices
  float beyond;                   // the distance where a vertex is out of reach
};

// A sample of a kernel: distance and vertex, which breaks ties.
using Rank = std::pair<float, Index>;

// Scratch memory of one thread, which grows on demand and is reused.
struct GroupScratch {
  explicit GroupScratch(std::size_t vertex_count) : place(vertex_count, 0) {}
  std::vector<std::uint16_t> place;  // [vertex]: 1 + its place in the region, 0 outside
  std::vector<RegionPlace> region;   // in the order in which they are found
  std::vector<Index> vertices;       // [place]
  std::vector<Rank> order;           // of the samples of a truncated kernel
};

// Writes the smoothed colours of up to 16 sources. Writes and returns nothing if they reach so many vertices that a
// march from each is faster.
BELTRAMI_DECLARE_VARIANTS(
    std::optional<KernelStatistics> sweep_group(const GroupJob& job, const VertexGroup& group, GroupScratch& scratch))

}  // namespace beltrami::triangulated
