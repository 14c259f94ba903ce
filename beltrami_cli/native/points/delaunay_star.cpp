// Inversion in the unit circle turns empty circles through the origin into supporting lines, so that the Delaunay
// neighbours of the origin are the corners of the convex hull of the inverted points: K. Q. Brown, "Voronoi diagrams
// from convex hulls", Information Processing Letters 9 (1979). The hull is found by R. L. Graham's scan around the
// origin, Information Processing Letters 1 (1972).
#include "points/delaunay_star.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace beltrami::points {
namespace {

// Points this near to a circle, relative to their distance, count as on it: grids that are rotated and stored in
// single precision are still grids.
constexpr double on_circle = 3e-5;

// Tangent of the angle below which two directions are the same but for rounding.
constexpr double one_direction = 1e-12;

// Grows with the angle from -x over -y, x, y; only its order matters.
double pseudo_angle(const Spoke& spoke) {
  const double slope = spoke.x / (std::abs(spoke.x) + std::abs(spoke.y));
  return spoke.y < 0 ? slope - 1 : 1 - slope;
}

// Whether b, which lies between a and c anticlockwise, is beyond the circle through the origin, a and c. Where a and c
// are half a turn apart or more, there is no such circle.
bool is_hidden(const Spoke& a, const Spoke& b, const Spoke& c) {
  const double whole = cross(a, c);
  if (whole <= 0) return false;
  const double reached = cross(a, b) * c.squared_length() + cross(b, c) * a.squared_length();
  return reached < (1 - on_circle) * whole * b.squared_length();
}

bool have_one_direction(const Spoke& a, const Spoke& b) {
  const double along = a.x * b.x + a.y * b.y;
  return along > 0 && std::abs(cross(a, b)) <= one_direction * along;
}

// The spokes anticlockwise from the first, which is the shortest; of those in one direction only the shortest.
std::vector<Spoke> distinct_directions(const std::vector<Spoke>& spokes) {
  struct Keyed {
    double angle;
    std::size_t rank;
    bool operator<(const Keyed& other) const { return angle != other.angle ? angle < other.angle : rank < other.rank; }
  };
  std::vector<Keyed> keyed(spokes.size());
  for (std::size_t rank = 0; rank < spokes.size(); ++rank) keyed[rank] = {pseudo_angle(spokes[rank]), rank};
  std::sort(keyed.begin(), keyed.end());
  const auto first = std::find_if(keyed.begin(), keyed.end(), [](const Keyed& key) { return key.rank == 0; });
  std::rotate(keyed.begin(), first, keyed.end());
  std::vector<Spoke> distinct;
  distinct.reserve(spokes.size() + 1);
  for (const Keyed& key : keyed) {
    const Spoke& next = spokes[key.rank];
    if (distinct.empty() || !have_one_direction(distinct.back(), next))
      distinct.push_back(next);
    else if (next.squared_length() < distinct.back().squared_length())
      distinct.back() = next;
  }
  while (distinct.size() > 1 && have_one_direction(distinct.back(), distinct.front())) distinct.pop_back();
  return distinct;
}

}  // namespace

double squared_circumradius(const Spoke& a, const Spoke& b) {
  const double area = 2 * cross(a, b);
  if (area == 0) return std::numeric_limits<double>::infinity();
  const double dx = a.x - b.x, dy = a.y - b.y;
  return a.squared_length() / area * (b.squared_length() / area) * (dx * dx + dy * dy);
}

void keep_delaunay_star(std::vector<Spoke>& spokes) {
  if (spokes.size() < 2) return;
  const std::vector<Spoke> around = distinct_directions(spokes);
  spokes.clear();
  // The scan starts and ends at the shortest spoke, which belongs to the star for certain.
  for (std::size_t i = 0; i <= around.size(); ++i) {
    const Spoke& next = around[i % around.size()];
    while (spokes.size() >= 2 && is_hidden(spokes[spokes.size() - 2], spokes.back(), next)) spokes.pop_back();
    spokes.push_back(next);
  }
  spokes.pop_back();
}

}  // namespace beltrami::points
