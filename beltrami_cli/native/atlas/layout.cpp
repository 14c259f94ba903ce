#include "atlas/layout.hpp"

#include <algorithm>

#include "atlas/packing.hpp"

namespace beltrami::atlas {
namespace {

struct Place {
  std::int64_t x, y;
};

Place place_of(const Window& window, std::int64_t texel, const Texture& grid) {
  const auto local = texel - grid.offset;
  const auto column = static_cast<std::int32_t>(local % grid.width), row = static_cast<std::int32_t>(local / grid.width);
  return {unwrapped(column, window.x, grid.width, grid.wrap_x), unwrapped(row, window.y, grid.height, grid.wrap_y)};
}

}  // namespace

Layout make_layout(const Ownership& ownership, std::int64_t margin) {
  Layout layout;
  layout.rectangle_of.assign(ownership.extents.size(), none);
  std::vector<Size> sizes;
  for (std::size_t window = 0; window < ownership.extents.size(); ++window) {
    const Extent& extent = ownership.extents[window];
    if (extent.empty()) continue;
    layout.rectangle_of[window] = static_cast<Index>(layout.rectangles.size());
    Rectangle rectangle{static_cast<Index>(window), extent.first_x - margin, extent.first_y - margin, 0, 0, 0, 0};
    rectangle.width = extent.last_x - extent.first_x + 1 + 2 * margin;
    rectangle.height = extent.last_y - extent.first_y + 1 + 2 * margin;
    sizes.push_back({rectangle.width, rectangle.height});
    layout.rectangles.push_back(rectangle);
  }
  const Packing packing = pack(sizes);
  // Without any rectangle there is a canvas still: all margin.
  layout.rows = std::max(packing.rows, 2 * margin);
  layout.columns = std::max(packing.columns, 2 * margin);
  for (std::size_t i = 0; i < sizes.size(); ++i) {
    layout.rectangles[i].row = packing.spots[i].row;
    layout.rectangles[i].column = packing.spots[i].column;
  }
  return layout;
}

std::int64_t Plan::cell_of(std::int64_t texel, const Texture& grid) const {
  const auto window = static_cast<std::size_t>(ownership.window[static_cast<std::size_t>(texel)]);
  const Rectangle& rectangle = layout.rectangles[static_cast<std::size_t>(layout.rectangle_of[window])];
  const Place place = place_of(windows.windows[window], texel, grid);
  return (rectangle.row + place.y - rectangle.y) * layout.columns + rectangle.column + place.x - rectangle.x;
}

Point2 Plan::owned_place(std::int64_t texel, const Texture& grid) const {
  const auto window = static_cast<std::size_t>(ownership.window[static_cast<std::size_t>(texel)]);
  const Place place = place_of(windows.windows[window], texel, grid);
  return {static_cast<double>(place.x), static_cast<double>(place.y)};
}

}  // namespace beltrami::atlas
