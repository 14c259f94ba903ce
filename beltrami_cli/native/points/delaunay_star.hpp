// The Delaunay neighbours of one point in the plane, without a triangulation of the others.
#pragma once

#include <vector>

#include "triangulated/topology.hpp"

namespace beltrami::points {

using triangulated::Index;

// Another point as seen from the one in question, which is the origin.
struct Spoke {
  double x, y;
  Index point;
  double squared_length() const { return x * x + y * y; }
};

inline double cross(const Spoke& a, const Spoke& b) { return a.x * b.y - a.y * b.x; }

// Square of the radius of the circle through the origin and both ends; infinite if these are in one line.
double squared_circumradius(const Spoke& a, const Spoke& b);

// Leaves of the spokes those that a Delaunay triangulation joins to the origin, anticlockwise. Of points on one empty
// circle, which have no unique triangulation, it leaves all. The spokes must not be of length zero; the first
// must be the shortest. Takes O(k log k).
void keep_delaunay_star(std::vector<Spoke>& spokes);

}  // namespace beltrami::points
