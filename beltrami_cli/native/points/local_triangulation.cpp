#include "points/local_triangulation.hpp"

#include <algorithm>
#include <limits>
#include <span>
#include <utility>

#include "disjoint_sets.hpp"
#include "points/tangent_plane.hpp"

namespace beltrami::points {
namespace {

// Ratio of distances to neighbours, relative to most points of the cloud, above which a point is lone and may be an
// outlier.
constexpr double far_apart = 4;

// Flatness of random points in space is about 0.7, of a surface with noise of half a spacing about 0.3.
constexpr double not_flat = 0.25;

// Parts of the triangles, sorted one at a time to save memory.
constexpr std::size_t windows = 32;

// Minimum number of points of a piece that is not a flake.
constexpr Index few_together = 16;

Vector between(const double* positions, Index from, Index to) {
  const double* a = positions + 3 * static_cast<std::size_t>(from);
  const double* b = positions + 3 * static_cast<std::size_t>(to);
  return {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
}

// Square of the radius of the circle around a triangle in space, |a|^2 |b|^2 |c|^2 / (4 |a x b|^2).
double squared_radius(const double* positions, const Triangle& triangle) {
  const Vector a = between(positions, triangle[0], triangle[1]), b = between(positions, triangle[0], triangle[2]);
  const Vector c = between(positions, triangle[1], triangle[2]);
  const Vector normal{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
  const double area = 4 * dot(normal, normal);
  if (area <= 0) return std::numeric_limits<double>::infinity();
  return dot(a, a) * dot(b, b) / area * dot(c, c);
}

Triangle with_ascending_corners(Triangle triangle) {
  std::sort(triangle.begin(), triangle.end());
  return triangle;
}

bool is_too_large(const double* positions, std::span<const double> spacing, const Triangle& triangle) {
  double least = std::numeric_limits<double>::infinity();
  for (const Index corner : triangle) least = std::min(least, spacing[static_cast<std::size_t>(corner)]);
  const double limit = largest_radius * least;
  return !(squared_radius(positions, triangle) <= limit * limit);
}

// The kept triangles, each once with sorted corners, in lexicographic order. in_stars: as in `Stars`, of all points,
// each with three different corners in [0, spacing.size()).
std::vector<Triangle> agreed_triangles(const double* positions, std::span<const double> spacing,
                                       std::span<const PackedTriangles> in_stars) {
  std::vector<Triangle> sorted, kept;
  kept.reserve(spacing.size() * 9 / 4);  // a closed surface has twice as many as points, and some overlap
  std::vector<char> joined(spacing.size(), 0);
  const std::size_t window = spacing.size() / windows + 1;  // of lowest corners, which are sorted at a time
  for (std::size_t begin = 0; begin < spacing.size(); begin += window, sorted.clear()) {
    for (const auto& triangles : in_stars)
      triangles.for_each([&](const Triangle& triangle) {
        if (static_cast<std::size_t>(std::min({triangle[0], triangle[1], triangle[2]})) - begin < window &&
            !is_too_large(positions, spacing, triangle))
          sorted.push_back(with_ascending_corners(triangle));
      });
    std::sort(sorted.begin(), sorted.end());
    for (std::size_t i = 0; i + 1 < sorted.size(); ++i) {
      if (sorted[i] != sorted[i + 1] || (!kept.empty() && kept.back() == sorted[i])) continue;
      kept.push_back(sorted[i]);
      for (const Index corner : sorted[i]) joined[static_cast<std::size_t>(corner)] = 1;
    }
  }
  for (const auto& triangles : in_stars)
    triangles.for_each([&](const Triangle& triangle) {
      if (!joined[static_cast<std::size_t>(triangle[0])] && !is_too_large(positions, spacing, triangle))
        kept.push_back(with_ascending_corners(triangle));
    });
  std::sort(kept.begin(), kept.end());
  kept.erase(std::unique(kept.begin(), kept.end()), kept.end());
  return kept;
}

// Marks lone points, which may still be on a sparsely sampled surface. distance: as in `Stars`, of all points.
std::vector<char> find_lone_points(std::span<const double> distance) {
  std::vector<char> lone(distance.size(), 0);
  std::vector<double> sorted(distance.begin(), distance.end());
  if (sorted.empty()) return lone;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  for (std::size_t point = 0; point < distance.size(); ++point) lone[point] = distance[point] > far_apart * *middle;
  return lone;
}

// Removes the triangles of flakes: small pieces of lone points only.
void remove_flakes(std::vector<Triangle>& triangles, std::span<const char> lone) {
  DisjointSets pieces(lone.size());
  for (const auto& [a, b, c] : triangles) {
    pieces.unite(a, b);
    pieces.unite(a, c);
  }
  std::vector<Index> size(lone.size(), 0);    // [root]
  std::vector<char> settled(lone.size(), 0);  // [root]: whether a point of its piece is not lone
  for (std::size_t point = 0; point < lone.size(); ++point) {
    const auto root = static_cast<std::size_t>(pieces.root(static_cast<Index>(point)));
    ++size[root];
    if (!lone[point]) settled[root] = 1;
  }
  std::erase_if(triangles, [&](const Triangle& triangle) {
    const auto root = static_cast<std::size_t>(pieces.root(triangle[0]));
    return size[root] < few_together && !settled[root];
  });
}

}  // namespace

PackedTriangles::PackedTriangles(std::span<const Triangle> triangles) {
  Triangle before{-1, -1, -1};
  for (const Triangle& triangle : triangles) {
    if (triangle[0] != before[0] || triangle[1] != before[2]) numbers_.insert(numbers_.end(), {~triangle[0], triangle[1]});
    numbers_.push_back(triangle[2]);
    before = triangle;
  }
  numbers_.shrink_to_fit();
}

LocalTriangulation::LocalTriangulation(std::span<const double> positions)
    : positions_(positions), spacing_(positions.size() / 3), distance_(spacing_.size()), strewn_(spacing_.size()) {}

std::vector<Index> LocalTriangulation::add_stars(const Neighbours& neighbours, bool keep_unsettled, unsigned threads) {
  Stars stars = find_stars(positions_.data(), neighbours, keep_unsettled, threads);
  for (std::size_t row = 0; row < neighbours.rows.size(); ++row) {
    const auto point = static_cast<std::size_t>(neighbours.rows[row]);
    spacing_[point] = stars.spacing[row];
    distance_[point] = stars.distance[row];
    strewn_[point] = stars.flatness[row] > not_flat;
  }
  triangles_.emplace_back(stars.triangles);
  std::sort(stars.unsettled.begin(), stars.unsettled.end());
  return std::move(stars.unsettled);
}

std::vector<Triangle> LocalTriangulation::faces() {
  const auto lone = find_lone_points(distance_);
  for (std::size_t point = 0; point < lone.size(); ++point)
    if (lone[point] && strewn_[point]) spacing_[point] = 0;  // which no triangle is small enough for
  auto faces = agreed_triangles(positions_.data(), spacing_, std::exchange(triangles_, {}));
  remove_flakes(faces, lone);
  return faces;
}

}  // namespace beltrami::points
