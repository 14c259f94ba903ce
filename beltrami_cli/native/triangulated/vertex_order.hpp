// An order in which neighbouring vertices of a mesh lie close in memory, whatever order they are given in.
#pragma once

#include <span>
#include <vector>

#include "triangulated/metric.hpp"

namespace beltrami::triangulated {

// A permutation of [0, vertex_count), new position -> vertex: along a Z-order curve through space; or breadth first along
// faces where neighbours in space are not neighbours on the surface. Positions must be finite. Throws
// std::invalid_argument if an index of a face's corner is outside [0, vertex_count).
std::vector<Index> vertex_order(Rows<double> positions, std::span<const Index> face_corners, Index vertex_count);

}  // namespace beltrami::triangulated
