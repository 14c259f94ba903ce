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

// Grows with the angle from -x over -y, x, y; only its order matters.
double pseudo_angle(const Spoke& spoke) {
  const double slope = spoke.x / (std::abs(spoke.x) + std::abs(spoke.y));
  return spoke.y < 0 ? slope - 1 : 1 - slope;
}

// Whether b, which lies between a and c anticlockwise, is beyond the circle through the origin, a and c. Where a and c are
// half a turn apart or more, there is no such circle.
bool is_hidden(const Spoke& a, const Spoke& b, const Spoke& c) {
  const double whole = cross(a, c);
  if (whole <= 0) return false;
  return cross(a, b) * c.squared_length() + cross(b, c) * a.squared_length() < (1 - on_circle) * whole * b.squared_length();
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
  struct Keyed {
    double angle;
    std::size_t rank;
    bool operator<(const Keyed& other) const { return angle != other.angle ? angle < other.angle : rank < other.rank; }
  };
  std::vector<Keyed> keyed(spokes.size());
  for (std::size_t rank = 0; rank < spokes.size(); ++rank) keyed[rank] = {pseudo_angle(spokes[rank]), rank};
  std::sort(keyed.begin(), keyed.end());
  // The scan starts and ends at the shortest spoke, which belongs to the star for certain.
  const auto start = std::find_if(keyed.begin(), keyed.end(), [](const Keyed& key) { return key.rank == 0; });
  std::rotate(keyed.begin(), start, keyed.end());
  std::vector<Spoke> star;
  star.reserve(spokes.size() + 1);
  for (std::size_t i = 0; i <= keyed.size(); ++i) {
    const Spoke& next = spokes[keyed[i % keyed.size()].rank];
    while (star.size() >= 2 && is_hidden(star[star.size() - 2], star.back(), next)) star.pop_back();
    star.push_back(next);
  }
  star.pop_back();
  spokes.swap(star);
}

}  // namespace beltrami::points
