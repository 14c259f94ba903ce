#include "points/local_triangulation.hpp"

#include <algorithm>
#include <utility>

#include "points/agreement.hpp"
#include "points/outliers.hpp"

namespace beltrami::points {

LocalTriangulation::LocalTriangulation(std::vector<double> positions)
    : positions_(std::move(positions)),
      spacing_(positions_.size() / 3),
      flatness_(spacing_.size()),
      distance_(spacing_.size()) {}

std::vector<Index> LocalTriangulation::add_stars(const Neighbours& neighbours, bool keep_unsettled, unsigned threads) {
  Stars stars = find_stars(positions_.data(), neighbours, keep_unsettled, threads);
  for (std::size_t row = 0; row < neighbours.rows.size(); ++row) {
    const auto point = static_cast<std::size_t>(neighbours.rows[row]);
    spacing_[point] = stars.spacing[row];
    flatness_[point] = stars.flatness[row];
    distance_[point] = stars.distance[row];
  }
  triangles_.insert(triangles_.end(), stars.triangles.begin(), stars.triangles.end());
  std::sort(stars.unsettled.begin(), stars.unsettled.end());
  return std::move(stars.unsettled);
}

std::vector<Triangle> LocalTriangulation::faces() const {
  const auto lone = find_lone_points(distance_);
  std::vector<double> spacing = spacing_;
  for (std::size_t point = 0; point < spacing.size(); ++point)
    if (lone[point] && is_strewn(flatness_[point])) spacing[point] = 0;  // which no triangle is small enough for
  auto faces = agreed_triangles(positions_.data(), spacing, triangles_);
  remove_flakes(faces, lone);
  return faces;
}

}  // namespace beltrami::points
