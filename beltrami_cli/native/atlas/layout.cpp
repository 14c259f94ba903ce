#include "atlas/layout.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "atlas/packing.hpp"

namespace beltrami::atlas {
namespace {

constexpr std::int64_t most_cells = std::int64_t{1} << 31;
constexpr double blocks_a_side = 256;

struct Place {
  std::int64_t x, y;
};

Place place_of(const Window& window, std::int64_t texel, const Texture& grid) {
  const auto local = texel - grid.offset;
  const auto column = static_cast<std::int32_t>(local % grid.width), row = static_cast<std::int32_t>(local / grid.width);
  return {unwrapped(column, window.x, grid.width, grid.wrap_x), unwrapped(row, window.y, grid.height, grid.wrap_y)};
}

// Side of the blocks in which rectangles are packed: fine enough to fit charts together, coarse enough to take little time.
std::int64_t block_side(const std::vector<Rectangle>& rectangles) {
  double area = 0;
  for (const Rectangle& rectangle : rectangles) area += static_cast<double>(rectangle.width * rectangle.height);
  return std::max<std::int64_t>(1, static_cast<std::int64_t>(std::ceil(std::sqrt(area) / blocks_a_side)));
}

}  // namespace

Layout make_layout(const Mesh& mesh, const Windows& windows, const Ownership& ownership, std::int64_t margin) {
  Layout layout;
  layout.rectangle_of.assign(ownership.extents.size(), none);
  for (std::size_t window = 0; window < ownership.extents.size(); ++window) {
    const Extent& extent = ownership.extents[window];
    if (extent.empty()) continue;
    layout.rectangle_of[window] = static_cast<Index>(layout.rectangles.size());
    Rectangle rectangle{static_cast<Index>(window), extent.first_x - margin, extent.first_y - margin, 0, 0, 0, 0};
    rectangle.width = extent.last_x - extent.first_x + 1 + 2 * margin;
    rectangle.height = extent.last_y - extent.first_y + 1 + 2 * margin;
    layout.rectangles.push_back(rectangle);
  }
  const std::int64_t block = block_side(layout.rectangles);
  std::vector<Bits> footprints;
  for (const Rectangle& rectangle : layout.rectangles)
    footprints.push_back(make_footprint(mesh, windows, ownership, rectangle, margin, block));
  const Packing packing = pack(footprints);
  // Without any rectangle there is a canvas still: all margin.
  layout.rows = layout.columns = 2 * margin;
  for (std::size_t i = 0; i < layout.rectangles.size(); ++i) {
    Rectangle& rectangle = layout.rectangles[i];
    rectangle.row = block * packing.spots[i].row;
    rectangle.column = block * packing.spots[i].column;
    layout.rows = std::max(layout.rows, rectangle.row + rectangle.height);
    layout.columns = std::max(layout.columns, rectangle.column + rectangle.width);
  }
  if (layout.rows * layout.columns > most_cells)
    throw std::length_error("the charts need a canvas of more than 2^31 cells");
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
