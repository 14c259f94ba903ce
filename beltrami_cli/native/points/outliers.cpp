#include "points/outliers.hpp"

#include <algorithm>
#include <numeric>

namespace beltrami::points {
namespace {

constexpr double far_apart = 4;

// Points at random in space have a flatness around 0.7, those on a surface with noise of half a spacing one around 0.3.
constexpr double not_flat = 0.25;

// Flakes have fewer points.
constexpr Index few_together = 16;

// Points by what they hang together with, in a forest whose paths are halved on the way.
class Pieces {
 public:
  explicit Pieces(std::size_t count) : parent_(count), size_(count, 1) { std::iota(parent_.begin(), parent_.end(), 0); }

  Index root(Index point) {
    while (at(parent_, point) != point) point = at(parent_, point) = at(parent_, at(parent_, point));
    return point;
  }

  void join(Index a, Index b) {
    a = root(a);
    b = root(b);
    if (a == b) return;
    if (at(size_, a) < at(size_, b)) std::swap(a, b);
    at(parent_, b) = a;
    at(size_, a) += at(size_, b);
  }

  Index size(Index point) { return at(size_, root(point)); }

 private:
  static Index& at(std::vector<Index>& values, Index point) { return values[static_cast<std::size_t>(point)]; }

  std::vector<Index> parent_, size_;
};

}  // namespace

std::vector<char> find_lone_points(std::span<const double> distance) {
  std::vector<char> lone(distance.size(), 0);
  std::vector<double> sorted(distance.begin(), distance.end());
  if (sorted.empty()) return lone;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  for (std::size_t point = 0; point < distance.size(); ++point) lone[point] = distance[point] > far_apart * *middle;
  return lone;
}

bool is_strewn(double flatness) { return flatness > not_flat; }

void remove_flakes(std::vector<Triangle>& triangles, std::span<const char> lone) {
  Pieces pieces(lone.size());
  for (const auto& [a, b, c] : triangles) {
    pieces.join(a, b);
    pieces.join(a, c);
  }
  std::vector<char> settled(lone.size(), 0);  // by root: whether a point there is not lone
  for (std::size_t point = 0; point < lone.size(); ++point)
    if (!lone[point]) settled[static_cast<std::size_t>(pieces.root(static_cast<Index>(point)))] = 1;
  std::erase_if(triangles, [&](const Triangle& triangle) {
    const Index root = pieces.root(triangle[0]);
    return pieces.size(root) < few_together && !settled[static_cast<std::size_t>(root)];
  });
}

}  // namespace beltrami::points
