// Inversion in the unit circle turns empty circles through the origin into supporting lines, so that the Delaunay
// neighbours of the origin are the corners of the convex hull of the inverted points: K. Q. Brown, "Voronoi diagrams
// from convex hulls", Information Processing Letters 9 (1979). The hull is found by R. L. Graham's scan around the
// origin, Information Processing Letters 1 (1972).
#include "points/local_stars.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>

#include "parallel.hpp"
#include "points/tangent_plane.hpp"

namespace beltrami::points {
namespace {

// A neighbour relative to the point, which is the origin.
struct Spoke {
  double x, y;
  Index point;
  double squared_length() const { return x * x + y * y; }
};

double cross(const Spoke& a, const Spoke& b) { return a.x * b.y - a.y * b.x; }

// Relative distance within which points count as on a circle: grids that are rotated and stored in single precision
// remain grids.
constexpr double on_circle = 3e-5;

// Tangent of the angle below which two directions are equal up to rounding.
constexpr double one_direction = 1e-12;

// Increases with the angle from -x over -y, x, y; only its order matters.
double pseudo_angle(const Spoke& spoke) {
  const double slope = spoke.x / (std::abs(spoke.x) + std::abs(spoke.y));
  return spoke.y < 0 ? slope - 1 : 1 - slope;
}

// Whether b, between a and c anticlockwise, is outside the circle through the origin, a and c, which exists only if a
// and c are less than half a turn apart.
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

// The spokes anticlockwise from the first, which is the shortest; only the shortest of each direction.
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

// Square of the radius of the circle through the origin and both ends; infinite if these are in one line.
double squared_circumradius(const Spoke& a, const Spoke& b) {
  const double area = 2 * cross(a, b);
  if (area == 0) return std::numeric_limits<double>::infinity();
  const double dx = a.x - b.x, dy = a.y - b.y;
  return a.squared_length() / area * (b.squared_length() / area) * (dx * dx + dy * dy);
}

// Keeps the spokes that a Delaunay triangulation joins to the origin, anticlockwise. Several points on one empty
// circle, which have no unique triangulation, are all kept. Spokes must not have length zero, and the first must be the
// shortest. Takes O(k log k).
void keep_delaunay_star(std::vector<Spoke>& spokes) {
  if (spokes.size() < 2) return;
  const std::vector<Spoke> around = distinct_directions(spokes);
  spokes.clear();
  // The scan starts and ends at the shortest spoke, which is always part of the star.
  for (std::size_t i = 0; i <= around.size(); ++i) {
    const Spoke& next = around[i % around.size()];
    while (spokes.size() >= 2 && is_hidden(spokes[spokes.size() - 2], spokes.back(), next)) spokes.pop_back();
    spokes.push_back(next);
  }
  spokes.pop_back();
}

constexpr std::size_t chunk = 1024;
constexpr double infinity = std::numeric_limits<double>::infinity();

// Numbers of neighbours to which the tangent plane is fitted: few, to exclude a second sheet nearby, or many, to
// average noise. The flatter fit is used.
constexpr std::size_t few = 8, many = 22;

// Bias correction: flatness is multiplied by 1 + this / number of points, since few points look too flat.
constexpr double doubt = 8;

// Ratio of the second to the first spread below which points are collinear, so that many planes contain them.
constexpr double in_line = 0.02;

// Maximum sine of the angle of a neighbour to the tangent plane (53 degrees: on the edge of a box the plane is tilted
// by 45), and maximum height in spacings.
constexpr double steepest = 0.8;
constexpr double highest = 1;

// Minimum spacing relative to the distance of the `many`-th neighbour; else a few points that nearly coincide would
// have so small a spacing that they lose the others. For evenly spread points the ratio is 0.38.
constexpr double least_spacing = 0.25;

// Maximum ratio of the distance of the `many`-th neighbour to that of the `few`-th: on a line, the most uneven case, it
// is 11 / 4. Beyond that, a cloud of fewer points ends, and another begins.
constexpr double most_uneven = 3;

struct Neighbour {
  Vector offset;
  double squared;
  Index point;
  // Not by the number of the point, so that the result does not depend on the order of points.
  bool operator<(const Neighbour& other) const {
    return squared != other.squared ? squared < other.squared : offset < other.offset;
  }
};

// The star of a point, see `Stars`; not settled: it needs more neighbours.
struct Star {
  std::vector<Triangle> triangles;
  double spacing = 0, flatness = 0, distance = 0;
  bool settled = false;
};

// Finds the star of one point at a time; keeps its memory for the next.
class Finder {
 public:
  explicit Finder(const double* positions) : positions_(positions) {}

  // Valid until the next call.
  const Star& find(Index point, std::span<const Index> others, bool complete) {
    star_.triangles.clear();
    star_.spacing = star_.flatness = 0;
    star_.settled = complete;
    gather(point, others, complete);
    star_.distance = around_.empty() ? 0 : std::sqrt(around_[std::min(few, around_.size()) - 1].squared);
    if (around_.size() < 2 || !find_plane()) return star_;
    // The maximum height of a neighbour depends on the spacing, and the spacing on the neighbours.
    lay_out(infinity);
    star_.spacing = measure_spacing();
    lay_out(highest * star_.spacing);
    star_.spacing = measure_spacing();
    collect(point);
    return star_;
  }

 private:
  // Removes the farthest neighbours, since others at the same distance may be missing.
  void gather(Index point, std::span<const Index> others, bool complete) {
    around_.clear();
    const double* here = positions_ + 3 * static_cast<std::size_t>(point);
    for (const Index other : others) {
      if (other == point) continue;
      const double* there = positions_ + 3 * static_cast<std::size_t>(other);
      const Vector offset{there[0] - here[0], there[1] - here[1], there[2] - here[2]};
      const double squared = dot(offset, offset);
      if (squared > 0) around_.push_back({offset, squared, other});
    }
    std::sort(around_.begin(), around_.end());
    squared_reach_ = infinity;
    if (complete || around_.empty()) return;
    squared_reach_ = around_.back().squared;
    while (!around_.empty() && around_.back().squared == squared_reach_) around_.pop_back();
  }

  // Squared distance within which there are `wanted` neighbours, or of the farthest known neighbour.
  double squared_distance_beyond(std::size_t wanted) const {
    if (wanted < around_.size()) return around_[wanted].squared;
    return squared_reach_ < infinity ? squared_reach_ : 2 * around_.back().squared;
  }

  bool find_plane() {
    double flattest = infinity;
    for (const std::size_t most : {few, many, around_.size()}) {
      if (most > many && flattest < infinity) break;  // all there are, for points that scanners lay in dense lines
      const std::size_t wanted = std::min(most, around_.size());
      const double reach = squared_distance_beyond(wanted);
      offsets_.clear();
      for (const Neighbour& neighbour : around_) {
        if (neighbour.squared >= reach) break;
        offsets_.push_back(neighbour.offset);
      }
      const TangentPlane plane = fit_tangent_plane(offsets_, reach);
      if (plane.second_spread <= in_line * plane.first_spread) continue;
      const double across = plane.normal_spread + plane.height * plane.height;
      star_.flatness = across / plane.second_spread * (1 + doubt / static_cast<double>(wanted));
      if (star_.flatness >= flattest) continue;
      flattest = star_.flatness;
      plane_ = plane;
    }
    return flattest < infinity;
  }

  // Finds the star in the tangent plane, with each neighbour at its distance in space, as if the surface were unrolled.
  void lay_out(double height_limit) {
    spokes_.clear();
    for (const Neighbour& neighbour : around_) {
      const double height = std::abs(dot(neighbour.offset, plane_.normal));
      if (height > height_limit || height * height > steepest * steepest * neighbour.squared) continue;
      const double x = dot(neighbour.offset, plane_.first), y = dot(neighbour.offset, plane_.second);
      const double stretch = std::sqrt(neighbour.squared / (x * x + y * y));
      spokes_.push_back({stretch * x, stretch * y, neighbour.point});
    }
    keep_delaunay_star(spokes_);
  }

  // The side of a square in the circumcircle of a triangle of the star, which on a square grid is the spacing. Lengths
  // of spokes are unsuitable, since many are short if points are in dense lines. The lower quartile of triangles is
  // used, since at the rim of a hole half of them may span it.
  double measure_spacing() {
    squared_radii_.clear();
    for (std::size_t i = 0; i < spokes_.size(); ++i) squared_radii_.push_back(squared_radius_beside(i));
    if (squared_radii_.empty()) return 0;
    const auto fourth = squared_radii_.begin() + static_cast<std::ptrdiff_t>(squared_radii_.size() / 4);
    std::nth_element(squared_radii_.begin(), fourth, squared_radii_.end());
    const auto distance = [&](std::size_t rank) { return std::sqrt(around_[rank - 1].squared); };
    const double least = around_.size() < many ? 0 : least_spacing * std::min(distance(many), most_uneven * distance(few));
    return std::isfinite(*fourth) ? std::max(std::sqrt(2 * *fourth), least) : least;
  }

  // Squared circumradius of the triangle between a spoke and the next; infinite if they are half a turn apart or more.
  double squared_radius_beside(std::size_t spoke) const {
    const Spoke &a = spokes_[spoke], &b = spokes_[(spoke + 1) % spokes_.size()];
    return cross(a, b) > 0 ? squared_circumradius(a, b) : infinity;
  }

  void collect(Index point) {
    const double limit = largest_radius * largest_radius * star_.spacing * star_.spacing;
    double largest = 0;
    for (std::size_t i = 0; i < spokes_.size(); ++i) {
      const double squared_radius = squared_radius_beside(i);
      largest = std::max(largest, squared_radius);
      if (squared_radius <= limit)
        star_.triangles.push_back({point, spokes_[i].point, spokes_[(i + 1) % spokes_.size()].point});
    }
    // A circle through the point reaches twice its radius, so farther neighbours cannot be inside. An open star may
    // gain more neighbours, at the rim of the cloud and between dense lines of a scanner.
    if (largest < infinity && 4 * std::min(largest, limit) <= squared_reach_ && !spokes_.empty()) star_.settled = true;
  }

  const double* positions_;
  std::vector<Neighbour> around_;
  double squared_reach_ = infinity;
  std::vector<Vector> offsets_;
  TangentPlane plane_;
  std::vector<Spoke> spokes_;
  std::vector<double> squared_radii_;
  Star star_;
};

}  // namespace

Stars find_stars(const double* positions, const Neighbours& neighbours, bool keep_unsettled, unsigned threads) {
  Stars stars;
  stars.spacing.resize(neighbours.rows.size());
  stars.flatness.resize(neighbours.rows.size());
  stars.distance.resize(neighbours.rows.size());
  std::mutex mutex;
  parallel_chunks(neighbours.rows.size(), chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    Finder finder(positions);
    std::vector<Triangle> triangles;
    std::vector<Index> unsettled;
    for (std::size_t row = begin; row < end; ++row) {
      const Index point = neighbours.rows[row];
      const Star& star =
          finder.find(point, {neighbours.table + row * neighbours.count, neighbours.count}, neighbours.complete);
      if (!star.settled && !keep_unsettled) {
        unsettled.push_back(point);
        continue;
      }
      triangles.insert(triangles.end(), star.triangles.begin(), star.triangles.end());
      stars.spacing[row] = star.spacing;
      stars.flatness[row] = star.flatness;
      stars.distance[row] = star.distance;
    }
    const std::lock_guard lock(mutex);
    stars.triangles.insert(stars.triangles.end(), triangles.begin(), triangles.end());
    stars.unsettled.insert(stars.unsettled.end(), unsettled.begin(), unsettled.end());
  });
  return stars;
}

}  // namespace beltrami::points
