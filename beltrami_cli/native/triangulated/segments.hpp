// Straight segments between vertices of a triangulated manifold, over edges and over one or two unfolded edges.
//
// A geodesic on a polyhedron is straight within every strip of triangles unfolded into the plane (J. Mitchell, D. Mount,
// C. Papadimitriou, "The discrete geodesic problem", SIAM J. Comput. 16, 1987). Here it is put together from segments that
// lie in strips of one, two or three triangles: in a neighbourhood of twenty samples there is hardly a longer strip, and
// no distance is shorter than the geodesic one.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "triangulated/topology.hpp"

namespace beltrami::triangulated {

// Larger than any length; adding lengths to it cannot overflow.
constexpr float no_segment = 1e30F;

// As many lengths as the widest register holds may be read from any place on.
constexpr std::size_t spare_lengths = 16;

// Segment ids: [0, E) the edges, [E, 2 E) across the edge, [2 E, 2 E + 3 F) around the corner, over both its edges.
// Both directions of every segment stand in lists, grouped by the vertex that it comes from.
struct Segments {
  std::vector<std::uint32_t> offsets;  // [vertex], one more at the end
  std::vector<Index> targets;          // [place in the lists]
  std::vector<float> lengths;          // [place in the lists]: no_segment where the straight line leaves the strip; and
                                       // `spare_lengths` more
  std::vector<std::array<std::uint32_t, 2>> places;  // [id]: both directions; the first spare one for what is no segment

  Index vertex_count() const { return static_cast<Index>(offsets.size() - 1); }
  void set_length(std::size_t id, float length) {
    for (const std::uint32_t place : places[id]) lengths[place] = length;
  }
};

// All segments that a metric may make straight; no lengths yet. Throws std::length_error if the mesh is too large.
Segments make_segments(const Topology& topology);

}  // namespace beltrami::triangulated
