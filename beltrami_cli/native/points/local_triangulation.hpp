// Triangles of a surface that is known only by points: the stars of all points, as far as these agree.
#pragma once

#include <vector>

#include "points/local_stars.hpp"

namespace beltrami::points {

class LocalTriangulation {
 public:
  // Three finite numbers a point, near 1 in size, no two points at one place.
  explicit LocalTriangulation(std::vector<double> positions);

  Index point_count() const { return static_cast<Index>(spacing_.size()); }

  // Finds the stars of some points, see `find_stars`. Returns those to be asked for again with more neighbours, ascending.
  std::vector<Index> add_stars(const Neighbours& neighbours, bool keep_unsettled, unsigned threads);

  // Each triangle once, its corners ascending, in lexicographic order, when all points have their stars.
  std::vector<Triangle> faces() const;

 private:
  std::vector<double> positions_, spacing_, flatness_, distance_;  // the last three as in `Stars`
  std::vector<Triangle> triangles_;
};

}  // namespace beltrami::points
