// Continuity of the surface between points of the image plane.
#pragma once

#include "atlas/charts.hpp"
#include "atlas/mesh.hpp"

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

}  // namespace beltrami::atlas
