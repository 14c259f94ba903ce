// Texture lookups at points of the surface: owned cells, their bilinear weights, and continuity of the surface.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "atlas/layout.hpp"
#include "atlas/unfolding.hpp"

namespace beltrami::atlas {

// Whether the surface continues between adjacent cells, or ends at an edge between them.
class Connections {
 public:
  Connections(const Mesh& mesh, const Charts& charts) : mesh_(mesh), charts_(charts) {}

  // Between two points on faces of one chart: whether the faces along the line join one face to the other, in the chart
  // or over seams that return to the same point. `none` as the second face stands for any face there.
  bool inside(Index face, Point2 from, Index other, Point2 to) const;

  // From a point on a face to a point outside the chart, beyond a seam: whether the path crosses no open edge.
  bool outwards(Index face, Point2 from, Point2 to) const;

 private:
  const Mesh& mesh_;
  const Charts& charts_;
};

// Whether the chart of a face covers a point near the face: a walk in the image, within the chart.
bool is_covered(const Mesh& mesh, Index start, Point2 place);

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
std::optional<Sample> look_up(const Plan& plan, const Landing& landing);

// The texel at a point of a chart's plane, covered by a face of the chart. Empty if no window owns it.
std::optional<Sample> stand_in(const Plan& plan, Index face, std::int64_t x, std::int64_t y, Point3 position);

}  // namespace beltrami::atlas
