// Local triangulation of a point cloud: the Delaunay triangles of each point's neighbours in its tangent plane, as in
// N. Sharp, K. Crane, "A Laplacian for nonmanifold triangle meshes", Computer Graphics Forum 39(5), 2020,
// doi:10.1111/cgf.14069, with limits in units of the local spacing that keep holes open and sheets apart.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "triangulated/topology.hpp"

namespace beltrami::points {

using triangulated::Index;
using Triangle = std::array<Index, 3>;

// The neighbours of some points.
struct Neighbours {
  std::span<const Index> rows;  // the points in question
  const Index* table;           // a row for each, of `count` other points; the point itself does not count
  std::size_t count;
  bool complete;  // whether each row has all other points of the cloud; otherwise it has the nearest
};

// The stars of some points, in any order.
struct Stars {
  std::vector<Triangle> triangles;  // each starts with the point whose star it is in
  std::vector<Index> unsettled;     // points that need more neighbours; their triangles are not there
  // Per row; 0 if the point is unsettled:
  std::vector<double> spacing;   // local spacing in the unit of the positions; 0 if no plane was found
  std::vector<double> flatness;  // squared distances from the tangent plane by those within it: of a flat surface 0
  std::vector<double> distance;  // of the eighth neighbour, or the last
};

// Positions are three numbers per point. keep_unsettled: accept incomplete stars, so that no point is unsettled.
Stars find_stars(const double* positions, const Neighbours& neighbours, bool keep_unsettled, unsigned threads);

// Maximum circumradius of a triangle, in spacings at its corners: of random points, one triangle in a thousand is
// larger, and gaps of more than five spacings stay open.
inline constexpr double largest_radius = 2.5;

}  // namespace beltrami::points
