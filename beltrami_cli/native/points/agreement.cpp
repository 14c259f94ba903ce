#include "points/agreement.hpp"

#include <algorithm>
#include <limits>

#include "points/tangent_plane.hpp"

namespace beltrami::points {
namespace {

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

}  // namespace

std::vector<Triangle> agreed_triangles(const double* positions, std::span<const double> spacing,
                                       std::span<const Triangle> in_stars) {
  std::vector<Triangle> sorted;
  sorted.reserve(in_stars.size());
  for (const Triangle& triangle : in_stars)
    if (!is_too_large(positions, spacing, triangle)) sorted.push_back(with_ascending_corners(triangle));
  std::sort(sorted.begin(), sorted.end());
  std::vector<char> joined(spacing.size(), 0);
  std::vector<Triangle> kept;
  for (std::size_t i = 0; i + 1 < sorted.size(); ++i) {
    if (sorted[i] != sorted[i + 1] || (!kept.empty() && kept.back() == sorted[i])) continue;
    kept.push_back(sorted[i]);
    for (const Index corner : sorted[i]) joined[static_cast<std::size_t>(corner)] = 1;
  }
  for (const Triangle& triangle : in_stars)
    if (!joined[static_cast<std::size_t>(triangle[0])] && !is_too_large(positions, spacing, triangle))
      kept.push_back(with_ascending_corners(triangle));
  std::sort(kept.begin(), kept.end());
  kept.erase(std::unique(kept.begin(), kept.end()), kept.end());
  return kept;
}

}  // namespace beltrami::points
