// The combinatorial part of a triangulated manifold, made once per mesh: it does not depend on the metric.
//
// Any set of triangles is accepted: open, closed, self-intersecting, non-manifold. Triangles with the same three
// vertices count once; a triangle with a repeated vertex only contributes its edge. Geodesic distances do not depend on
// orientation, so the corners of a face are sorted.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace beltrami::triangulated {

using Index = std::int32_t;

// A corner is coded as 3 * face + k, k in 0..2; it also names the edge that faces the corner.
using Corner = Index;

constexpr Index none = -1;

struct Topology {
  Index vertex_count = 0;

  std::vector<std::array<Index, 3>> faces;       // distinct, corners ascending, sorted
  std::vector<std::array<Index, 3>> face_edges;  // [face][k]: edge that faces corner k
  std::vector<std::array<Index, 2>> edges;       // distinct, (low, high), sorted
  std::vector<Corner> twins;                     // [corner]: corner facing the same edge from the other side,
                                                 // none at boundary and non-manifold edges

  Index edge_facing(Corner corner) const {
    return face_edges[static_cast<std::size_t>(corner / 3)][static_cast<std::size_t>(corner % 3)];
  }

  // Links: directed edges grouped by their origin; vertex v owns links [link_offsets[v], link_offsets[v + 1]).
  std::vector<Index> link_offsets;
  std::vector<Index> link_targets;
  std::vector<std::array<Index, 2>> edge_links;  // [edge]: link low -> high, link high -> low

  // Partner slots: link A -> C has a slot for each triangle on the edge AC; the third vertex may help to
  // update C. Link l owns slots [slot_offsets[l], slot_offsets[l + 1]).
  std::vector<Index> slot_offsets;
  std::vector<std::array<Index, 2>> corner_slots;  // [corner C = 3 f + k]: slots of the links from the face's
                                                   // corners k + 1 and k + 2 (mod 3) to C
};

// Links and partner slots are used by fast marching; on request their lists are left empty.
enum class Links { made, left_out };

// Throws std::invalid_argument if an index is outside [0, vertex_count), std::length_error if the mesh is too
// large for 32-bit indices.
Topology make_topology(std::span<const Index> face_corners, Index vertex_count, Links links = Links::made);

}  // namespace beltrami::triangulated
