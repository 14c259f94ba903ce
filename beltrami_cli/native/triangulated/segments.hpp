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

struct Segment {
  Index target;
  float length;  // no_segment where the straight line leaves the strip
};

// Segment ids: [0, E) the edges, [E, 2 E) across the edge, [2 E, 2 E + 3 F) around the corner, over both its edges.
struct Segments {
  std::vector<std::uint64_t> offsets;  // [vertex], one more at the end
  std::vector<Segment> from;           // both directions of every segment, grouped by the vertex that it comes from
  std::vector<std::array<std::uint32_t, 2>> places;  // [id]: both directions in `from`; its last entry, a spare one,
                                                     // for what is no segment

  Index vertex_count() const { return static_cast<Index>(offsets.size() - 1); }
  void set_length(std::size_t id, float length) {
    for (const std::uint32_t place : places[id]) from[place].length = length;
  }
};

// All segments that a metric may make straight; no lengths yet. Throws std::length_error if the mesh is too large.
Segments make_segments(const Topology& topology);

}  // namespace beltrami::triangulated
