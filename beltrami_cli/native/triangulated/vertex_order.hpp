// Cache-friendly orders of vertices, for marches and sweeps that go from neighbour to neighbour.
#pragma once

#include <span>
#include <vector>

#include "triangulated/metric.hpp"

namespace beltrami::triangulated {

// The vertices along a Z-order curve through the first (at most three) coordinates: a permutation of
// [0, vertex_count), new position -> vertex. Positions must be finite.
std::vector<Index> morton_order(Rows<double> positions, Index vertex_count);

// The Morton order or, if neighbours in space are not neighbours on the surface, a breadth-first order along faces.
// Positions must be finite. Throws std::invalid_argument if a corner of a face is outside [0, vertex_count).
std::vector<Index> vertex_order(Rows<double> positions, std::span<const Index> face_corners, Index vertex_count);

}  // namespace beltrami::triangulated
