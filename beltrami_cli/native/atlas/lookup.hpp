// Texture lookups at points of the surface: owned cells, and their bilinear weights.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "atlas/layout.hpp"
#include "atlas/unfolding.hpp"

namespace beltrami::atlas {

struct Sample {
  std::array<Index, 4> cells;    // owned
  std::array<float, 4> weights;  // with the sum 1
  Point3 position;
  bool near_open;  // whether an open edge may be near
};

Point3 position_of(const Mesh& mesh, const Landing& landing);

// The texels around the end point of a path, if they belong to the chart of its face; for a face without area in the
// image, the texels it shows, of any chart. A point at the centre of a texel is that texel. Empty if there is no such
// texel nearby.
std::optional<Sample> look_up(const Blueprint& plan, const Landing& landing);

// The texel at a point of a chart's plane, covered by a face of the chart. Empty if no window owns it.
std::optional<Sample> stand_in(const Blueprint& plan, Index face, std::int64_t x, std::int64_t y, Point3 position);

}  // namespace beltrami::atlas
