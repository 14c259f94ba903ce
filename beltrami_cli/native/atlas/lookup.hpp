// Looking up a texture at a point of the surface: owned cells and their bilinear weights, and where the surface goes on.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "atlas/layout.hpp"
#include "atlas/unfolding.hpp"

namespace beltrami::atlas {

// Whether the surface goes on between cells that are neighbours in the texture's plane, or ends at an edge between them.
class Connections {
 public:
  Connections(const Mesh& mesh, const Charts& charts) : mesh_(mesh), charts_(charts) {}

  // Between two places on faces of one chart: whether the faces along the line between them join one face to the other,
  // in the chart or over seams that lead back to the same place. Of the second face `none` stands for any face there.
  bool inside(Index face, Point2 from, Index other, Point2 to) const;

  // From a place on a face to one outside the chart, beyond a seam: whether no open edge lies on the way.
  bool outwards(Index face, Point2 from, Point2 to) const;

 private:
  const Mesh& mesh_;
  const Charts& charts_;
};

// Whether the chart of a face covers a place near the face: a walk in the image, within the chart.
bool is_covered(const Mesh& mesh, Index start, Point2 place);

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
