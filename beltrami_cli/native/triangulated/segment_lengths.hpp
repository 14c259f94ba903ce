// The lengths of segments in a metric that is given by the lengths of edges.
#pragma once

#include <array>
#include <vector>

#include "triangulated/length_sweep.hpp"
#include "triangulated/metric.hpp"
#include "triangulated/segments.hpp"

namespace beltrami::triangulated {

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

}  // namespace beltrami::triangulated
