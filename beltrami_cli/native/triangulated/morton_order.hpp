// A cache-friendly order of vertices: fast marching touches neighbours, so they should lie close in memory.
#pragma once

#include <vector>

#include "triangulated/metric.hpp"

namespace beltrami::triangulated {

// The vertices along a Z-order curve through the first (at most three) coordinates: a permutation of
// [0, vertex_count), new position -> vertex. Positions must be finite.
std::vector<Index> morton_order(Rows<double> positions, Index vertex_count);

}  // namespace beltrami::triangulated
