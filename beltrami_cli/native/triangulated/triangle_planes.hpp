// What the lengths of segments need of triangles, laid out for many of them side by side: all first corners, then all
// second and all third ones.
#pragma once

#include <cstddef>
#include <vector>

#include "triangulated/topology.hpp"

namespace beltrami::triangulated {

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

}  // namespace beltrami::triangulated
