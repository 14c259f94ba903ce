// The lengths of segments in a metric that is given by the lengths of edges.
#pragma once

#include <vector>

#include "triangulated/metric.hpp"
#include "triangulated/segments.hpp"

namespace beltrami::triangulated {

// What is known of edges and triangles in a metric; kept, so that memory is not asked for at each iteration.
struct EdgeMetric {
  std::vector<float> in_space;  // [edge]: squared length without colours
  std::vector<float> squared;   // [edge]: squared length
  std::vector<float> lengths;   // [edge]
  // [corner C = 3 f + k]: C unfolded into the plane in which the edge that faces it runs from its lower vertex, the
  // origin, along the first axis.
  struct Place {
    float along, height;
  };
  std::vector<Place> corners;
};

// Squared lengths of edges by eq. (1), as squared_edge_lengths() in single precision. Returns whether any
// length without colours has changed since the last call.
bool measure_edges(EdgeMetric& metric, const Topology& topology, Rows<double> positions, Rows<float> colours, double beta,
                   const float* scales, unsigned threads);

// Unfolds strips of two and three triangles and sets the lengths of all segments; by squared edge lengths, metric.squared or in_space.
void update_lengths(Segments& segments, EdgeMetric& metric, const Topology& topology, const std::vector<float>& squared,
                    unsigned threads);

}  // namespace beltrami::triangulated
