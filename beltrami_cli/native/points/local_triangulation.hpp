// Triangles of a surface that is known only by points: the stars of all points, each in its own plane, as far as these
// agree, without outliers.
//
// Kept are the triangles in the stars of at least two of their corners, and for points that this leaves with nothing all of
// their own star; without those larger than `largest_radius` times the spacing of the densest of their corners, and those
// without area. Outliers are points far from others that are strewn in space, and small pieces of such points alone.
#pragma once

#include <cstddef>
#include <span>
#include <utility>
#include <vector>

#include "points/local_stars.hpp"

namespace beltrami::points {

// Compressed triangles: one that continues where the previous one ended, as around a point, is a single number.
class PackedTriangles {
 public:
  explicit PackedTriangles(std::span<const Triangle> triangles);

  // Calls visit(triangle) in the original order.
  template <class Visit>
  void for_each(const Visit& visit) const {
    Triangle triangle{};
    for (std::size_t i = 0; i < numbers_.size(); ++i) {
      if (numbers_[i] < 0) {
        triangle[0] = ~numbers_[i++];
        triangle[2] = numbers_[i++];
      }
      triangle[1] = std::exchange(triangle[2], numbers_[i]);
      visit(std::as_const(triangle));
    }
  }

 private:
  std::vector<Index> numbers_;  // of corners: the first, complemented, and the second where a sequence begins; the third
};

class LocalTriangulation {
 public:
  // Three finite numbers per point, near 1 in size, all points distinct; they are not copied.
  explicit LocalTriangulation(std::span<const double> positions);

  Index point_count() const { return static_cast<Index>(spacing_.size()); }

  // Finds the stars of some points, see `find_stars`. Returns those that need more neighbours, ascending.
  std::vector<Index> add_stars(const Neighbours& neighbours, bool keep_unsettled, unsigned threads);

  // All triangles, each once with sorted corners, in lexicographic order, after the stars of all points. May be called
  // once.
  std::vector<Triangle> faces();

 private:
  std::span<const double> positions_;
  std::vector<double> spacing_, distance_;  // as in `Stars`
  std::vector<char> strewn_;                // whether a point is strewn in space rather than on a surface
  std::vector<PackedTriangles> triangles_;  // of each call
};

}  // namespace beltrami::points
