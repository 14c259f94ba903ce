// Looking up a texture at a point of the surface: owned cells and their bilinear weights.
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

// The texels around the landing in the texture of its face, if they belong to its chart; of a face without area in
// the image, the texels that it shows, of any chart. A point on a texel's centre is that texel. Empty if there is
// no such texel near.
std::optional<Sample> look_up(const Plan& plan, const Landing& landing);

// The texel at a place of a chart's plane, which a face of the chart covers. Empty if no window owns it.
std::optional<Sample> stand_in(const Plan& plan, Index face, std::int64_t x, std::int64_t y, Point3 position);

}  // namespace beltrami::atlas
