// The integer points of a triangle, so that triangles that share an edge share no point and leave none out.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>

#include "atlas/mesh.hpp"

namespace beltrami::atlas {

// Calls fill(y, begin, end) for the rows y in [top, bottom) that hold points: columns [begin, end) within
// [left, right). Points on left and upper edges count, those on right and lower edges do not. Both faces of an
// edge compute its crossing with a row to equal bits.
template <class Fill>
void scan(const std::array<Point2, 3>& corners, std::int64_t left, std::int64_t right, std::int64_t top,
          std::int64_t bottom, const Fill& fill) {
  struct Line {
    Point2 upper;
    double bottom, slope;
  };
  std::array<Line, 3> lines;
  for (std::size_t k = 0; k < 3; ++k) {
    Point2 a = corners[k], b = corners[k == 2 ? 0 : k + 1];
    if (b.y < a.y) std::swap(a, b);
    lines[k] = {a, b.y, b.y > a.y ? (b.x - a.x) / (b.y - a.y) : 0};
  }
  const auto [lowest, highest] = std::minmax({corners[0].y, corners[1].y, corners[2].y});
  const auto first = std::max(top, static_cast<std::int64_t>(std::ceil(lowest)));
  const auto last = std::min(bottom, static_cast<std::int64_t>(std::ceil(highest)));
  const auto column = [&](double x) {
    return static_cast<std::int64_t>(
        std::ceil(std::clamp(x, static_cast<double>(left), static_cast<double>(right))));
  };
  for (std::int64_t row = first; row < last; ++row) {
    const auto y = static_cast<double>(row);
    double low = 0, high = 0;
    bool met = false;
    for (const Line& line : lines) {
      if (!(line.upper.y <= y && y < line.bottom)) continue;
      const double x = line.upper.x + (y - line.upper.y) * line.slope;
      low = met ? std::min(low, x) : x;
      high = met ? std::max(high, x) : x;
      met = true;
    }
    if (!met) continue;
    const std::int64_t begin = column(low), end = column(high);
    if (begin < end) fill(row, begin, end);
  }
}

}  // namespace beltrami::atlas
