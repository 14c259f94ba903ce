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
#include <limits>
#include <vector>

#include "triangulated/topology.hpp"

namespace beltrami::triangulated {

// Input of the lengths of segments from triangles, laid out for vectorisation: all first corners, then all second and
// all third ones.
struct TrianglePlanes {
  std::size_t count = 0, stride = 0;  // of triangles; stride is a multiple of 16, with spare ones at the end
  std::vector<Index> edges;           // [at(corner)]: the edge that faces it
  // [at(corner)]: the two other edges of the triangle beyond that edge, from the edge's lower and from its higher vertex;
  // any if there is none beyond.
  std::vector<Index> beyond_low, beyond_high;

  std::size_t at(Corner corner) const {
    return static_cast<std::size_t>(corner % 3) * stride + static_cast<std::size_t>(corner / 3);
  }
};

TrianglePlanes make_planes(const Topology& topology);

// Larger than any length; adding lengths to it cannot overflow.
constexpr float no_segment = 1e30F;

// Spare entries, since the widest register may be read from any offset in the lists.
constexpr std::size_t spare_lengths = 16;

// Vertices with more segments are hubs: the time of a kernel that reaches one must not be proportional to its segments.
constexpr std::uint32_t most_segments = 512;

// Index that means "no segment".
constexpr std::uint32_t no_place = std::numeric_limits<std::uint32_t>::max();

// Lists of both directions of every segment, grouped by origin.
struct Segments {
  std::vector<std::uint32_t> offsets;  // [vertex], one more at the end
  std::vector<Index> targets;          // [place in the lists], and some more
  std::vector<float> lengths;          // the same; no_segment where the straight line leaves the strip

  // Positions of segments in the lists.
  std::vector<std::array<std::uint32_t, 2>> over_edges;  // [edge]: from its lower and from its higher vertex
  std::vector<std::uint32_t> across_edges;               // [corner in planes]: from it, across the edge that it faces
  std::vector<std::array<std::uint32_t, 2>> round_corners;  // [corner in planes]: around it, over both its edges

  Index vertex_count() const { return static_cast<Index>(offsets.size() - 1); }
};

// The segments of hubs, sorted by length.
struct HubLists {
  std::vector<Index> hubs;             // ascending
  std::vector<std::uint32_t> offsets;  // [hub], one more at the end
  std::vector<std::uint32_t> places;   // of straight segments, for each hub in order of length
};

HubLists sort_hubs(const Segments& segments);

// All segments that a metric may make straight; no lengths yet. Throws std::length_error if the mesh is too large.
Segments make_segments(const Topology& topology, const TrianglePlanes& planes);

}  // namespace beltrami::triangulated
