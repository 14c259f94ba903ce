#include "atlas/packing.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <stdexcept>

namespace beltrami::atlas {
namespace {

constexpr std::int64_t most_cells = std::int64_t{1} << 31;
// Widths that are tried, in sides of a square of the rectangles' area. Wide canvases suit the kernel.
constexpr std::array relative_widths{0.75, 0.9, 1.0, 1.05, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5, 3.0};

Packing pack_into(std::span<const Size> rectangles, const std::vector<std::size_t>& by_height, std::int64_t width) {
  Packing packing;
  packing.spots.resize(rectangles.size());
  std::int64_t column = 0, shelf = 0;
  for (const std::size_t i : by_height) {
    const auto [rectangle_width, rectangle_height] = rectangles[i];
    if (column + rectangle_width > width || packing.rows == 0) {  // the next shelf; its first is its highest
      shelf = packing.rows;
      packing.rows += rectangle_height;
      column = 0;
    }
    packing.spots[i] = {shelf, column};
    column += rectangle_width;
    packing.columns = std::max(packing.columns, column);
  }
  return packing;
}

}  // namespace

Packing pack(std::span<const Size> rectangles) {
  std::vector<std::size_t> by_height(rectangles.size());
  std::iota(by_height.begin(), by_height.end(), 0);
  std::stable_sort(by_height.begin(), by_height.end(),
                   [&](std::size_t a, std::size_t b) { return rectangles[a].height > rectangles[b].height; });
  std::int64_t area = 0, widest = 0;
  for (const Size& rectangle : rectangles) {
    area += rectangle.width * rectangle.height;
    widest = std::max(widest, rectangle.width);
  }
  Packing best;
  for (const double relative : relative_widths) {
    const auto width = std::max(widest, static_cast<std::int64_t>(relative * std::sqrt(static_cast<double>(area))));
    auto packing = pack_into(rectangles, by_height, width);
    if (best.spots.empty() || packing.rows * packing.columns < best.rows * best.columns) best = std::move(packing);
  }
  if (best.rows * best.columns > most_cells) throw std::length_error("the charts need a canvas of more than 2^31 cells");
  return best;
}

}  // namespace beltrami::atlas
