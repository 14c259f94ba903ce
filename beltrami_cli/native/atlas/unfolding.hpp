// Straight on over an edge: the faces beyond it, unfolded one after the other into the plane of the face before it.
#pragma once

#include <array>
#include <optional>

#include "atlas/mesh.hpp"

namespace beltrami::atlas {

struct Landing {
  Index face;
  std::array<double, 3> weights;  // barycentric, not negative, of its corners
};

// Where a place of the texture's plane, outside the face of `edge` beyond that edge, lies on the surface: the face's
// map to its plane in space is extended, and the straight line from the edge's point nearest to the place is followed
// over the unfolded faces. Empty where it meets an open edge, or crosses more than a fixed number of faces.
std::optional<Landing> unfold(const Mesh& mesh, Edge edge, Point2 place);

}  // namespace beltrami::atlas
