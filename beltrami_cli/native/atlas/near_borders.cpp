#include "atlas/near_borders.hpp"

#include <algorithm>
#include <cmath>

namespace beltrami::atlas {
namespace {

// A texel in a coarse chart is looked up between two or three texels of a fine one.
constexpr std::int64_t reach_of_open = 2, reach_of_any = 1;
// Of a segment that spans more periods of the texture, only so many are marked.
constexpr double most_periods = 4;

// Marks the texels within `reach` rows and columns of a segment.
void mark(std::vector<bool>& marks, const Texture& grid, Point2 a, Point2 b, std::int64_t reach) {
  const bool upright = std::abs(b.y - a.y) > std::abs(b.x - a.x);
  if (upright ? b.y < a.y : b.x < a.x) std::swap(a, b);
  const double from = upright ? a.y : a.x, to = upright ? b.y : b.x;
  const double start = upright ? a.x : a.y, slope = to > from ? ((upright ? b.x : b.y) - start) / (to - from) : 0;
  const auto crossing = [&](double along) { return start + slope * (std::clamp(along, from, to) - from); };
  const double last = std::min(to, from + most_periods * std::max(grid.width, grid.height));
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

}  // namespace

NearBorders::NearBorders(const Mesh& mesh, const Charts& charts) {
  const auto& textures = mesh.surface->textures;
  const auto texels =
      static_cast<std::size_t>(textures.empty() ? 0 : textures.back().texel(0, textures.back().height));
  any_.assign(texels, false);
  for (const Border& border : charts.borders) {
    const auto face = static_cast<std::size_t>(border.edge / 3), k = static_cast<std::size_t>(border.edge % 3);
    const Point2 a = mesh.texels[face][k], b = mesh.texels[face][next(k)];
    const bool is_open = border.seam == none;
    mark(any_, mesh.grid(face), a, b, is_open ? reach_of_open : reach_of_any);
    if (!is_open) continue;
    if (open_.empty()) open_.assign(texels, false);
    mark(open_, mesh.grid(face), a, b, reach_of_open);
  }
}

}  // namespace beltrami::atlas
