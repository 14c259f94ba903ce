// One set of triangles from the stars of all points, which see the surface each in its own plane and may disagree.
#pragma once

#include <span>
#include <vector>

#include "points/local_stars.hpp"

namespace beltrami::points {

// Returns each triangle once, its corners ascending, in lexicographic order. Kept are those that are in the stars of at
// least two of their corners, and for points that this leaves with nothing all of their own star. Left out are triangles
// larger than `largest_radius` times the spacing of the densest of their corners, and those without area.
//
// in_stars: as in `Stars`, of all points, each with three different corners in [0, spacing.size()).
std::vector<Triangle> agreed_triangles(const double* positions, std::span<const double> spacing,
                                       std::span<const Triangle> in_stars);

}  // namespace beltrami::points
