// Whether the surface goes on between cells that are neighbours in the texture's plane, or ends at an edge between them.
#pragma once

#include "atlas/charts.hpp"
#include "atlas/mesh.hpp"

namespace beltrami::atlas {

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

}  // namespace beltrami::atlas
