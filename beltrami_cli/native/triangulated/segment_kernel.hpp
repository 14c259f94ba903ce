// The short-time kernel with distances along segments, sixteen sources at a time: the alternative to fast marching.
//
// A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images on manifolds" (2007), eqs. (8) and (9).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "parallel.hpp"
#include "triangulated/metric.hpp"
#include "triangulated/segment_lengths.hpp"
#include "triangulated/segment_march.hpp"
#include "triangulated/segments.hpp"
#include "triangulated/short_time_kernel.hpp"
#include "triangulated/vertex_groups.hpp"

namespace beltrami::triangulated {

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
