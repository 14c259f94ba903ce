#include "atlas/borders.hpp"

#include <algorithm>
#include <cmath>

namespace beltrami::atlas {
namespace {

// A texel in a coarse chart is looked up between two or three texels of a fine one.
constexpr std::int64_t reach_of_open = 2, reach_of_any = 1;
// Maximum number of periods of a segment that are marked.
constexpr double most_marked_periods = 4;

// Marks the texels within `reach` rows and columns of a segment.
void mark(std::vector<bool>& marks, const Texture& grid, Point2 a, Point2 b, std::int64_t reach) {
  const bool upright = std::abs(b.y - a.y) > std::abs(b.x - a.x);
  if (upright ? b.y < a.y : b.x < a.x) std::swap(a, b);
  const double from = upright ? a.y : a.x, to = upright ? b.y : b.x;
  const double start = upright ? a.x : a.y, slope = to > from ? ((upright ? b.x : b.y) - start) / (to - from) : 0;
  const auto crossing = [&](double along) { return start + slope * (std::clamp(along, from, to) - from); };
  const double last = std::min(to, from + most_marked_periods * std::max(grid.width, grid.height));
  const auto end = static_cast<std::int64_t>(std::ceil(last)) + reach;
  for (std::int64_t along = static_cast<std::int64_t>(std::floor(from)) - reach; along <= end; ++along) {
    const auto [least, most] =
        std::minmax({crossing(static_cast<double>(along - 1)), crossing(static_cast<double>(along + 1))});
    const auto top = static_cast<std::int64_t>(std::ceil(most)) + reach;
    for (std::int64_t across = static_cast<std::int64_t>(std::floor(least)) - reach; across <= top; ++across) {
      const auto x = wrapped(upright ? across : along, grid.width, grid.wrap_x);
      const auto y = wrapped(upright ? along : across, grid.height, grid.wrap_y);
      marks[static_cast<std::size_t>(grid.texel(x, y))] = true;
    }
  }
}

// Tolerance within which distances are equal.
constexpr double rounding = 1e-9;

class Spreader {
 public:
  Spreader(const Mesh& mesh, const Border& border, Index number, double reach)
      : number_(number), open_(border.seam == none), reach_(reach) {
    const auto [start, end] = mesh.ends(border.edge);
    start_ = start;
    along_ = end - start;
    squared_length_ = dot(along_, along_);
    outward_ = doubled_area(mesh.texels[static_cast<std::size_t>(border.edge / 3)]) < 0 ? 1 : -1;
  }

  std::int64_t top() const { return static_cast<std::int64_t>(std::ceil(start_.y + std::min(along_.y, 0.0) - reach_)); }
  std::int64_t bottom() const {
    return static_cast<std::int64_t>(std::floor(start_.y + std::max(along_.y, 0.0) + reach_)) + 1;
  }
  // Columns [left, right) of a row that may be within reach.
  std::pair<std::int64_t, std::int64_t> columns(double y) const {
    double from = 0, to = 1;
    if (along_.y != 0) {
      const double a = (y - reach_ - start_.y) / along_.y, b = (y + reach_ - start_.y) / along_.y;
      from = std::clamp(std::min(a, b), 0.0, 1.0);
      to = std::clamp(std::max(a, b), 0.0, 1.0);
    }
    const auto [low, high] = std::minmax({start_.x + from * along_.x, start_.x + to * along_.x});
    return {static_cast<std::int64_t>(std::ceil(low - reach_)), static_cast<std::int64_t>(std::floor(high + reach_)) + 1};
  }

  void offer(Point2 place, NearestBorders::Entry& best, const auto& is_open) const {
    const Point2 offset = place - start_;
    const double side = outward_ * cross(along_, offset);
    if (!(side >= -rounding * squared_length_) || squared_length_ == 0) return;
    const double t = dot(offset, along_) / squared_length_, past = std::max({-t, t - 1, 0.0});
    const double squared_overhang = past * past * squared_length_;
    const double squared = side * side / squared_length_ + squared_overhang;
    if (squared > reach_ * reach_ || squared > best.squared_distance + rounding) return;
    if (squared >= best.squared_distance - rounding) {
      const bool best_is_open = is_open(best.border);
      if (open_ != best_is_open ? open_ : squared_overhang >= best.overhang - rounding) return;
    }
    best = {squared, squared_overhang, number_};
  }

 private:
  Index number_;
  bool open_;
  double reach_, squared_length_ = 0, outward_ = 1;
  Point2 start_, along_;
};

}  // namespace

NearBorders::NearBorders(const Mesh& mesh, const Charts& charts) {
  const auto texels = static_cast<std::size_t>(mesh.surface->texel_count());
  any_.assign(texels, false);
  for (const Border& border : charts.borders) {
    const auto [a, b] = mesh.ends(border.edge);
    const Texture& grid = mesh.grid(static_cast<std::size_t>(border.edge / 3));
    const bool is_open = border.seam == none;
    mark(any_, grid, a, b, is_open ? reach_of_open : reach_of_any);
    if (!is_open) continue;
    if (open_.empty()) open_.assign(texels, false);
    mark(open_, grid, a, b, reach_of_open);
  }
}

void NearestBorders::find(const Mesh& mesh, const Charts& charts, std::span<const Index> borders, Block block,
                          double reach, const std::vector<std::uint8_t>& wanted) {
  entries_.assign(static_cast<std::size_t>(block.width * block.height), {});
  const auto is_open = [&](Index border) { return charts.borders[static_cast<std::size_t>(border)].seam == none; };
  for (const Index number : borders) {
    const Spreader spreader(mesh, charts.borders[static_cast<std::size_t>(number)], number, reach);
    const std::int64_t bottom = std::min(spreader.bottom(), block.y + block.height);
    for (std::int64_t y = std::max(spreader.top(), block.y); y < bottom; ++y) {
      const auto [left, right] = spreader.columns(static_cast<double>(y));
      const std::int64_t end = std::min(right, block.x + block.width);
      for (std::int64_t x = std::max(left, block.x); x < end; ++x) {
        const auto cell = static_cast<std::size_t>((y - block.y) * block.width + x - block.x);
        if (wanted[cell] != 0)
          spreader.offer({static_cast<double>(x), static_cast<double>(y)}, entries_[cell], is_open);
      }
    }
  }
}

}  // namespace beltrami::atlas
