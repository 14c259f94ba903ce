#include "atlas/looked_up.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "atlas/connections.hpp"

namespace beltrami::atlas {
namespace {

// Minimum weight of a texel in a lookup: smaller ones are invisible in 8 bits, or due to rounding.
constexpr double least_weight = 1.0 / 256;
// Maximum length of an edge in periods of its texture; of longer ones only the middle is used.
constexpr double most_edge_periods = 8;
constexpr std::size_t edges_per_poll = 1 << 12;
// Many edges meet a texel. Results are sorted from time to time, so that each texel is kept about once.
constexpr std::size_t first_compaction = 1 << 16;

// The texels within less than one row and column of a line: no more than what a lookup on it reads. Calls visit(x, y).
template <class Visit>
void visit_around(Point2 a, Point2 b, const Visit& visit) {
  constexpr double reach = 1 - least_weight;
  if (b.y < a.y) std::swap(a, b);
  const double slope = b.y > a.y ? (b.x - a.x) / (b.y - a.y) : 0;
  for (double y = std::ceil(a.y - reach); y <= b.y + reach; ++y) {
    const double upper = std::max(a.y, y - reach), lower = std::min(b.y, y + reach);
    const double first = b.y > a.y ? a.x + slope * (upper - a.y) : a.x, last = b.y > a.y ? a.x + slope * (lower - a.y) : b.x;
    const auto [left, right] = std::minmax(first, last);
    for (double x = std::ceil(left - reach); x <= right + reach; ++x)
      visit(static_cast<std::int64_t>(x), static_cast<std::int64_t>(y));
  }
}

class Finder {
 public:
  Finder(const Mesh& mesh, const Charts& charts, const Windows& windows, const Ownership& ownership)
      : mesh_(mesh), charts_(charts), windows_(windows), ownership_(ownership) {}

  // Texels outside all charts that a chart looks up are around its border.
  std::vector<LookedUp> find(const Poll& poll) {
    for (std::size_t i = 0; i < charts_.borders.size(); ++i) {
      if (i % edges_per_poll == 0 && poll && !poll(0)) throw Cancelled();
      add(charts_.borders[i].edge);
      if (found_.size() >= next_compaction_) compact();
    }
    compact();
    return std::move(found_);
  }

 private:
  void add(Edge edge) {
    const Texture& grid = mesh_.grid(static_cast<std::size_t>(edge / 3));
    auto [a, b] = mesh_.ends(edge);
    const Point2 middle = 0.5 * (a + b), half = 0.5 * (b - a);
    const double periods = std::max(std::abs(half.x) / grid.width, std::abs(half.y) / grid.height) * 2;
    if (periods > most_edge_periods) {
      a = middle - (most_edge_periods / periods) * half;
      b = middle + (most_edge_periods / periods) * half;
    }
    visit_around(a, b, [&](std::int64_t x, std::int64_t y) {
      const std::int64_t texel = texel_at(grid, x, y);
      if (ownership_.window[static_cast<std::size_t>(texel)] == none) found_.push_back({texel, shown_beside(edge / 3, x, y)});
    });
  }

  // The chart that owns the texels next to an uncovered texel that a face shows.
  Index shown_beside(Index face, std::int64_t x, std::int64_t y) const {
    Index chart = owner_beside(face, x, y);
    // A face without area in the image, on the border of another, shows the same as that face.
    for (Edge edge = 3 * face; chart == none && edge < 3 * face + 3; ++edge)
      if (const Edge twin = mesh_.twins[static_cast<std::size_t>(edge)]; twin != none && lie_on_each_other(edge, twin))
        chart = owner_beside(twin / 3, x, y);
    return chart == none ? lone : chart;
  }

  bool lie_on_each_other(Edge edge, Edge twin) const {
    if (mesh_.texture[static_cast<std::size_t>(edge / 3)] != mesh_.texture[static_cast<std::size_t>(twin / 3)]) return false;
    const auto [a, b] = mesh_.ends(edge);
    const auto [c, d] = mesh_.ends(twin);
    return (same_texel(a, d) && same_texel(b, c)) || (same_texel(a, c) && same_texel(b, d));
  }

  // The owner of the texels next to a place that the chart of a face covers; `none` if it covers none.
  Index owner_beside(Index face, std::int64_t x, std::int64_t y) const {
    const Texture& grid = mesh_.grid(static_cast<std::size_t>(face));
    const Index own = charts_.chart_of[static_cast<std::size_t>(face)];
    const bool overlaps = ownership_.overlapping[static_cast<std::size_t>(own)] != 0;
    Index found = none;
    for (std::int64_t j = y - 1; j <= y + 1; ++j)
      for (std::int64_t i = x - 1; i <= x + 1; ++i) {
        const Index window = ownership_.window[static_cast<std::size_t>(texel_at(grid, i, j))];
        if (window == none) continue;
        const Index chart = windows_.windows[static_cast<std::size_t>(window)].chart;
        if (chart == found) continue;
        const Point2 place{static_cast<double>(i), static_cast<double>(j)};
        if (chart != own && !(overlaps && is_covered(mesh_, face, place))) continue;
        if (found != none) return several;
        found = chart;
      }
    return found;
  }

  static std::int64_t texel_at(const Texture& grid, std::int64_t x, std::int64_t y) {
    return grid.texel(wrapped(x, grid.width, grid.wrap_x), wrapped(y, grid.height, grid.wrap_y));
  }

  // Merges all results of a texel.
  void compact() {
    std::sort(found_.begin(), found_.end(), [](const LookedUp& a, const LookedUp& b) { return a.texel < b.texel; });
    std::size_t kept = 0;
    for (const LookedUp& next : found_) {
      if (kept > 0 && found_[kept - 1].texel == next.texel) {
        Index& chart = found_[kept - 1].chart;
        if (chart != next.chart) chart = std::min({chart, next.chart, several});
      } else {
        found_[kept++] = next;
      }
    }
    found_.resize(kept);
    next_compaction_ = std::max(first_compaction, 2 * kept);
  }

  const Mesh& mesh_;
  const Charts& charts_;
  const Windows& windows_;
  const Ownership& ownership_;
  std::vector<LookedUp> found_;
  std::size_t next_compaction_ = first_compaction;
};

}  // namespace

std::vector<LookedUp> find_looked_up(const Mesh& mesh, const Charts& charts, const Windows& windows,
                                     const Ownership& ownership, const Poll& poll) {
  return Finder(mesh, charts, windows, ownership).find(poll);
}

}  // namespace beltrami::atlas
