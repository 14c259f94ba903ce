// Outliers: points that belong to no surface, but to each other as well as they can.
#pragma once

#include <span>
#include <vector>

#include "points/local_stars.hpp"

namespace beltrami::points {

// Marks the points that stand several times as far from their neighbours as most points of the cloud. They may still be on a
// surface that is sampled sparsely. distance: as in `Stars`, of all points.
std::vector<char> find_lone_points(std::span<const double> distance);

// Whether a lone point whose surroundings are so flat (as in `Stars`) is strewn in space rather than on a surface.
bool is_strewn(double flatness);

// Removes the triangles of flakes: a few lone points that hang together with no others.
void remove_flakes(std::vector<Triangle>& triangles, std::span<const char> lone);

}  // namespace beltrami::points
