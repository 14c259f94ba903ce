// The short-time kernel with distances along segments, sixteen sources at a time: the alternative to fast marching.
//
// A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images on manifolds" (2007), eqs. (8) and (9).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "parallel.hpp"
#include "triangulated/fast_marching.hpp"
#include "triangulated/length_sweep.hpp"
#include "triangulated/metric.hpp"
#include "triangulated/segments.hpp"
#include "triangulated/short_time_kernel.hpp"
#include "triangulated/vertex_groups.hpp"

namespace beltrami::triangulated {

// Shortest paths along segments from one source, by Dijkstra's algorithm. At hubs, segments are taken one at a time
// from the shortest on, so that k samples take O(k log k) for any valence. The scratch memory, 8 bytes per vertex, is
// reused between marches.
class SegmentMarch {
 public:
  SegmentMarch(const Segments& segments, const HubLists& hubs);

  // Vertices within `radius` of the source in order of distance, the source first; at most `max_count`.
  // Valid until the next call.
  std::span<const Reached> march(Index source, float radius, std::size_t max_count);

  // Whether max_count ended the last march while vertices within the radius were still queued.
  bool truncated() const { return truncated_; }

 private:
  struct Node {
    float distance = 0;
    std::uint32_t mark = 0;  // of the march that found the distance
  };

  // The next segment of a hub whose list is being processed; its key is that of the vertex at its other end.
  struct Waiting {
    std::uint64_t key;
    std::uint32_t hub, next;  // the number of the hub, and the place in the lists of hubs
    bool operator>(const Waiting& other) const { return key > other.key; }
  };

  void relax(Index target, float distance);
  void pass_on(Index vertex, float distance);
  void take_hub_segment();
  void keep_nearest(std::size_t count);
  void wait_for(std::uint32_t hub, std::uint32_t next);

  const Segments& segments_;
  const HubLists& hubs_;
  std::vector<Node> nodes_;
  std::vector<std::uint64_t> heap_;  // distance bits in the high half, vertex in the low half
  std::vector<Waiting> waiting_;     // a heap, too
  std::vector<Reached> reached_;
  std::uint32_t mark_ = 0;
  float radius_ = 0;  // beyond which nothing is looked for
  bool truncated_ = false;
};

// The lengths of segments in a metric that is given by the lengths of edges.
class SegmentLengths {
 public:
  explicit SegmentLengths(Topology topology);

  const std::vector<std::array<Index, 2>>& edges() const { return tables_.edges; }
  const Segments& segments() const { return tables_.segments; }

  // Updates the lengths of all segments from edges, by eq. (1) as in squared_edge_lengths(), in single precision.
  // Returns whether positions or scales have changed since the last call.
  bool update(Rows<double> positions, Rows<float> colours, double beta, const float* scales, unsigned threads);

 private:
  bool have_changed(Rows<double> positions, const float* scales);

  LengthTables tables_;
  std::vector<double> positions_;  // as they were at the last call
  std::vector<float> scales_;
};

class SegmentKernel {
 public:
  SegmentKernel(std::span<const Index> face_corners, Index vertex_count);

  bool has_metric() const { return !groups_.members.empty(); }
  Index vertex_count() const { return lengths_.segments().vertex_count(); }
  const std::vector<std::array<Index, 2>>& edges() const { return lengths_.edges(); }

  // Updates all lengths, and the groups if positions or scales have changed. As squared_edge_lengths().
  void update_metric(Rows<double> positions, Rows<float> colours, double beta, const float* scales, unsigned threads);

  // As smooth() of fast marching. Bit-identical for any number of threads and any instruction set. Distances do not
  // depend on the groups, so another order of vertices only changes the rounding of averages. All kernels of a group
  // are averaged if one of them is wanted.
  KernelStatistics smooth(Rows<float> colours, const float* weights, const KernelParameters& parameters, float* smoothed,
                          unsigned threads, const Poll& poll = {});

  // The samples of one kernel in order of distance, the source first.
  std::vector<Reached> distances(Index source, float radius, std::size_t max_count) const;

 private:
  void march_group(std::span<const Index> sources, Rows<float> colours, const float* weights,
                   const KernelParameters& parameters, float* smoothed, SegmentMarch& marching,
                   KernelStatistics& statistics) const;

  SegmentLengths lengths_;
  HubLists hubs_;
  VertexGroups groups_;
};

}  // namespace beltrami::triangulated
