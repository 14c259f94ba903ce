// Splitting of obtuse corners by unfolding.
//
// R. Kimmel, J. Sethian, "Computing geodesic paths on manifolds", PNAS 95 (1998), section 4: at an obtuse
// corner C of a triangle ABC the triangles beyond the edge AB are unfolded into the plane of ABC, one after
// the other, until a vertex D falls into the section of directions that make acute angles with both CA and
// CB. D then supports C in two acute stencils, (A, D) and (D, B). Only edge lengths enter.
#pragma once

#include <optional>
#include <span>

#include "triangulated/topology.hpp"

namespace beltrami::triangulated {

struct Support {
  Index vertex;           // D
  double squared_target;  // |CD|^2, in the unfolded plane
  double squared_first;   // |AD|^2, A = corner k + 1 (mod 3) of the face
  double squared_second;  // |BD|^2, B = corner k + 2 (mod 3) of the face
};

// The support of an obtuse corner. Empty if the strip of triangles meets a boundary or a non-manifold edge, comes
// back to the triangle itself, is degenerate, or is longer than a fixed bound.
std::optional<Support> unfold(const Topology& topology, std::span<const double> squared_lengths, Corner corner);

}  // namespace beltrami::triangulated
