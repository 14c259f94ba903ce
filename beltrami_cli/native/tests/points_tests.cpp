// Tests of the local triangulation without Python, meant to be run under the sanitizers, on clouds of every kind.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <random>
#include <set>
#include <vector>

#include "points/local_stars.hpp"
#include "points/local_triangulation.hpp"
#include "points/tangent_plane.hpp"
#include "tests/check.hpp"

using namespace beltrami::points;

namespace {

double uniform(std::mt19937& random) { return std::uniform_real_distribution<double>(-1, 1)(random); }

// How far d is outside the circle through the origin, a and b (anticlockwise), relative to its distance; negative inside. By
// the determinant of the textbooks.
double outside(const Spoke& a, const Spoke& b, const Spoke& d) {
  const double determinant =
      cross(a, b) * d.squared_length() - cross(a, d) * b.squared_length() + cross(b, d) * a.squared_length();
  return determinant / (cross(a, b) * d.squared_length());
}

void stars_are_those_of_empty_circles() {
  std::mt19937 random(5);
  int compared = 0;
  for (int trial = 0; trial < 3000; ++trial) {
    std::vector<Spoke> spokes(1 + random() % 30);
    const double shift = trial % 3 == 0 ? 0.9 : 0;  // far from the others: on the rim
    for (std::size_t i = 0; i < spokes.size(); ++i)
      spokes[i] = {uniform(random) + shift, uniform(random), static_cast<Index>(i)};
    std::sort(spokes.begin(), spokes.end(),
              [](const Spoke& a, const Spoke& b) { return a.squared_length() < b.squared_length(); });
    std::set<std::pair<Index, Index>> expected, found;
    double nearest_to_circle = 1;
    for (const Spoke& a : spokes)
      for (const Spoke& b : spokes) {
        if (cross(a, b) <= 0) continue;
        double least = 1;
        for (const Spoke& d : spokes)
          if (d.point != a.point && d.point != b.point) least = std::min(least, outside(a, b, d));
        if (least > 0) expected.insert({a.point, b.point});
        nearest_to_circle = std::min(nearest_to_circle, std::abs(least));
      }
    if (nearest_to_circle < 1e-4) continue;  // counts as on the circle
    std::vector<Spoke> star = spokes;
    keep_delaunay_star(star);
    for (std::size_t i = 0; i < star.size(); ++i) {
      const Spoke &a = star[i], &b = star[(i + 1) % star.size()];
      if (cross(a, b) > 0) found.insert({a.point, b.point});
    }
    CHECK(expected == found);
    ++compared;
  }
  CHECK(compared > 2500);
}

// On a grid many points are on one circle and in one direction, so that there is no single right answer: any fan of empty
// circles is one that leaves out no direction.
void stars_on_grids_are_fans_of_empty_circles() {
  std::mt19937 random(4);
  const double turn = 2 * std::acos(-1.0);
  for (int trial = 0; trial < 3000; ++trial) {
    const int low = trial % 2 ? 0 : -5;  // in a corner, or around
    const double tilt = trial % 3 ? 0.1 * trial : 0;
    std::vector<Spoke> spokes;
    for (Index i = 0; i < 40; ++i) {
      const double x = low + static_cast<int>(random() % 10), y = low + static_cast<int>(random() % 10);
      if (x == 0 && y == 0) continue;
      spokes.push_back({std::cos(tilt) * x - std::sin(tilt) * y, std::sin(tilt) * x + std::cos(tilt) * y, i});
    }
    std::sort(spokes.begin(), spokes.end(),
              [](const Spoke& a, const Spoke& b) { return a.squared_length() < b.squared_length(); });
    std::vector<double> angles;
    for (const Spoke& spoke : spokes) angles.push_back(std::atan2(spoke.y, spoke.x));
    std::sort(angles.begin(), angles.end());
    double widest = angles.front() + turn - angles.back();
    for (std::size_t i = 1; i < angles.size(); ++i) widest = std::max(widest, angles[i] - angles[i - 1]);
    std::vector<Spoke> star = spokes;
    keep_delaunay_star(star);
    double covered = 0;
    for (std::size_t i = 0; i < star.size(); ++i) {
      const Spoke &a = star[i], &b = star[(i + 1) % star.size()];
      if (cross(a, b) <= 1e-9) continue;
      covered += std::atan2(cross(a, b), a.x * b.x + a.y * b.y);
      for (const Spoke& d : spokes) CHECK(outside(a, b, d) > -1e-9);
    }
    CHECK(std::abs(covered - (widest > turn / 2 - 1e-9 ? turn - widest : turn)) < 1e-6);
  }
}

void points_on_one_circle_are_all_kept() {
  std::vector<Spoke> star;
  for (int i = 1; i < 8; ++i) {  // seven corners of an octagon, the origin is the eighth
    const double angle = i * std::acos(-1.0) / 4;
    star.push_back({std::cos(angle) - 1, std::sin(angle), i});
  }
  std::sort(star.begin(), star.end(),
            [](const Spoke& a, const Spoke& b) { return a.squared_length() < b.squared_length(); });
  keep_delaunay_star(star);
  CHECK(star.size() == 7);
  CHECK(std::abs(squared_circumradius(star[0], star[1]) - 1) < 1e-12);
}

void planes_are_found_in_any_direction() {
  std::mt19937 random(6);
  for (int trial = 0; trial < 500; ++trial) {
    const Vector normal{uniform(random), uniform(random), uniform(random)};
    const double squared = dot(normal, normal);
    if (squared < 0.01) continue;
    std::vector<Vector> offsets(20);
    for (Vector& offset : offsets) {
      offset = {uniform(random), uniform(random), uniform(random)};
      const double height = dot(offset, normal) / squared;
      for (std::size_t axis = 0; axis < 3; ++axis) offset[axis] -= height * normal[axis];
    }
    const TangentPlane plane = fit_tangent_plane(offsets, 4);
    CHECK(std::abs(std::abs(dot(plane.normal, normal)) / std::sqrt(squared) - 1) < 1e-9);
    CHECK(plane.first_spread >= plane.second_spread && plane.normal_spread < 1e-12);
    CHECK(std::abs(dot(plane.first, plane.second)) < 1e-12 && std::abs(dot(plane.first, plane.first) - 1) < 1e-12);
  }
}

std::vector<Triangle> triangulated(const std::vector<double>& positions, std::size_t neighbours, unsigned threads) {
  const std::size_t count = positions.size() / 3;
  std::vector<Index> rows(count), table;
  std::iota(rows.begin(), rows.end(), 0);
  for (const Index row : rows) {
    std::vector<Index> others = rows;
    const auto squared = [&](Index other) {
      double sum = 0;
      for (std::size_t axis = 0; axis < 3; ++axis)
        sum += std::pow(positions[3 * static_cast<std::size_t>(other) + axis] -
                            positions[3 * static_cast<std::size_t>(row) + axis], 2);
      return sum;
    };
    std::sort(others.begin(), others.end(), [&](Index a, Index b) { return squared(a) < squared(b); });
    table.insert(table.end(), others.begin(), others.begin() + static_cast<std::ptrdiff_t>(neighbours));
  }
  LocalTriangulation triangulation(positions);
  CHECK(triangulation.add_stars({rows, table.data(), neighbours, neighbours == count}, true, threads).empty());
  return triangulation.faces();
}

void clouds_of_every_kind_give_proper_triangles_for_any_number_of_threads() {
  std::mt19937 random(7);
  for (int trial = 0; trial < 400; ++trial) {
    const std::size_t count = random() % 60;
    std::vector<double> positions(3 * count);
    for (std::size_t i = 0; i < positions.size(); ++i)
      switch (trial % 5) {
        case 0: positions[i] = uniform(random); break;                                // in space
        case 1: positions[i] = i % 3 == 2 ? 0 : uniform(random); break;               // in a plane
        case 2: positions[i] = static_cast<double>(random() % 4); break;              // coincident, on one circle, in line
        case 3: positions[i] = i % 3 == 0 ? uniform(random) : 0; break;               // in one line
        default: positions[i] = 1e6 + (random() % 2 ? 1e-9 : 1) * uniform(random);    // far away, nearly coincident
      }
    const std::size_t neighbours = trial % 2 ? count : std::min<std::size_t>(count, 12);
    const auto triangles = triangulated(positions, neighbours, 1);
    CHECK(triangles == triangulated(positions, neighbours, 3));
    for (const Triangle& triangle : triangles) {
      CHECK(triangle[0] >= 0 && triangle[0] < triangle[1] && triangle[1] < triangle[2]);
      CHECK(triangle[2] < static_cast<Index>(count));
    }
    CHECK(std::adjacent_find(triangles.begin(), triangles.end()) == triangles.end());
    if (trial % 5 == 3) CHECK(triangles.empty());
  }
}

void more_neighbours_are_asked_for_until_the_star_is_closed() {
  std::vector<double> positions;
  for (int y = 0; y < 9; ++y)
    for (int x = 0; x < 9; ++x) positions.insert(positions.end(), {1.0 * x, 1.0 * y, 0});
  const std::vector<Index> rows{40};
  const std::vector<Index> few{31, 39, 41, 49}, enough{40, 30, 31, 32, 39, 41, 48, 49, 50, 22, 38, 42, 58, 20};
  CHECK(find_stars(positions.data(), {rows, few.data(), few.size(), false}, false, 1).unsettled == rows);
  const Stars stars = find_stars(positions.data(), {rows, enough.data(), enough.size(), false}, false, 1);
  CHECK(stars.unsettled.empty() && stars.triangles.size() == 8 && std::abs(stars.spacing[0] - 1) < 1e-12);
}

}  // namespace

int main() {
  stars_are_those_of_empty_circles();
  stars_on_grids_are_fans_of_empty_circles();
  points_on_one_circle_are_all_kept();
  planes_are_found_in_any_direction();
  clouds_of_every_kind_give_proper_triangles_for_any_number_of_threads();
  more_neighbours_are_asked_for_until_the_star_is_closed();
  std::puts("points tests passed");
  return 0;
}
