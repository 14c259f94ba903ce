#include "atlas/layout.hpp"

#include <algorithm>
#include <cmath>
#include <span>
#include <stdexcept>

#include "atlas/packing.hpp"

namespace beltrami::atlas {
namespace {

constexpr std::int64_t most_cells = std::int64_t{1} << 31;
constexpr double blocks_a_side = 256;
constexpr std::int64_t cells_per_poll = 1 << 22;

struct Place {
  std::int64_t x, y;
};

Place place_of(const Window& window, std::int64_t texel, const Texture& grid) {
  const auto local = texel - grid.offset;
  const auto column = static_cast<std::int32_t>(local % grid.width), row = static_cast<std::int32_t>(local / grid.width);
  return {unwrapped(column, window.x, grid.width, grid.wrap_x), unwrapped(row, window.y, grid.height, grid.wrap_y)};
}

// Rectangles begin at even texels and even cells: JPEG subsamples chroma over 2 x 2 texels, and noise is measured in
// squares of 2 x 2 cells.
constexpr std::int64_t cell_step = 2;

std::int64_t rounded_down(std::int64_t place) { return place - (place % cell_step + cell_step) % cell_step; }

// Side of the blocks of packing: fine enough to fit charts together, coarse enough to be fast.
std::int64_t block_side(const std::vector<Rectangle>& rectangles) {
  double area = 0;
  for (const Rectangle& rectangle : rectangles) area += static_cast<double>(rectangle.width * rectangle.height);
  return cell_step * std::max<std::int64_t>(1, static_cast<std::int64_t>(std::ceil(std::sqrt(area) / blocks_a_side / cell_step)));
}

// Calls visit(begin, end) for the runs of a row that are owned; is_owned(i) for columns i in [0, width).
template <class IsOwned, class Visit>
void visit_runs(std::int64_t width, const IsOwned& is_owned, const Visit& visit) {
  for (std::int64_t begin = 0; begin < width;) {
    while (begin < width && !is_owned(begin)) ++begin;
    std::int64_t end = begin;
    while (end < width && is_owned(end)) ++end;
    if (begin < end) visit(begin, end);
    begin = end;
  }
}

// The blocks of the rectangle, of side `block`, with a cell within `margin` rows and columns of an owned cell.
Bits make_footprint(const Mesh& mesh, const Windows& windows, const Ownership& ownership, const Rectangle& rectangle,
                    std::int64_t margin, std::int64_t block, const Poll& poll) {
  Bits footprint((rectangle.height + block - 1) / block, (rectangle.width + block - 1) / block);
  const Window& window = windows.windows[static_cast<std::size_t>(rectangle.window)];
  const Texture& grid = mesh.surface->textures[static_cast<std::size_t>(window.texture)];
  const std::int64_t left = rectangle.x + margin, width = rectangle.width - 2 * margin;
  const bool wraps = left < 0 || left + width > grid.width;
  for (std::int64_t y = margin, looked_at = 0; y < rectangle.height - margin; ++y, looked_at += width) {
    if (looked_at >= cells_per_poll) {
      looked_at = 0;
      if (poll && !poll(0)) throw Cancelled();
    }
    const Index* texels = ownership.window.data() + grid.texel(0, wrapped(rectangle.y + y, grid.height, grid.wrap_y));
    const auto mark = [&](std::int64_t begin, std::int64_t end) {  // owned columns, from the margin on
      for (std::int64_t row = (y - margin) / block; row <= (y + margin) / block; ++row)
        footprint.set(row, begin / block, (end - 1 + 2 * margin) / block);
    };
    if (wraps)
      visit_runs(width, [&](std::int64_t i) {
        return texels[wrapped(left + i, grid.width, grid.wrap_x)] == rectangle.window;
      }, mark);
    else
      visit_runs(width, [&](std::int64_t i) { return texels[left + i] == rectangle.window; }, mark);
  }
  return footprint;
}

// Height of a band: so large that rows shared with the next band cost little, so small that it fits the cache.
constexpr std::int64_t rows_per_band = 64;

// The bands [first, last] of a rectangle that are near a shape.
struct Span {
  std::int64_t first = 0, last = -1;
};

Span bands_near(const Rectangle& rectangle, std::span<const Point2> shape, double reach) {
  double left = shape[0].x, right = left, top = shape[0].y, bottom = top;
  for (const Point2 p : shape) {
    left = std::min(left, p.x);
    right = std::max(right, p.x);
    top = std::min(top, p.y);
    bottom = std::max(bottom, p.y);
  }
  const auto x = static_cast<double>(rectangle.x), y = static_cast<double>(rectangle.y);
  const auto width = static_cast<double>(rectangle.width), height = static_cast<double>(rectangle.height);
  if (right + reach < x || left - reach > x + width || bottom + reach < y || top - reach > y + height) return {};
  const auto row = [&](double place) {
    return static_cast<std::int64_t>(std::floor(std::clamp(place - y, 0.0, height - 1)));
  };
  // A band also reads the row below it.
  return {std::max<std::int64_t>(row(top - reach) - 1, 0) / rows_per_band, row(bottom + reach) / rows_per_band};
}

// Groups numbers by band; `visit` must call its argument with (band, number) in the same way twice.
template <class Visitor>
void list_by_band(std::size_t bands, const Visitor& visit, std::vector<std::size_t>& offsets, std::vector<Index>& list) {
  offsets.assign(bands + 1, 0);
  visit([&](std::size_t band, Index) { ++offsets[band + 1]; });
  for (std::size_t band = 0; band < bands; ++band) offsets[band + 1] += offsets[band];
  list.resize(offsets.back());
  auto cursor = offsets;
  visit([&](std::size_t band, Index number) { list[cursor[band]++] = number; });
}

}  // namespace

Layout make_layout(const Mesh& mesh, const Windows& windows, const Ownership& ownership, std::int64_t margin,
                   const Poll& poll) {
  Layout layout;
  layout.rectangle_of.assign(ownership.extents.size(), none);
  for (std::size_t window = 0; window < ownership.extents.size(); ++window) {
    const Extent& extent = ownership.extents[window];
    if (extent.empty()) continue;
    layout.rectangle_of[window] = static_cast<Index>(layout.rectangles.size());
    Rectangle rectangle;
    rectangle.window = static_cast<Index>(window);
    rectangle.x = rounded_down(extent.first_x - margin);
    rectangle.y = rounded_down(extent.first_y - margin);
    rectangle.width = extent.last_x + 1 + margin - rectangle.x;
    rectangle.height = extent.last_y + 1 + margin - rectangle.y;
    layout.rectangles.push_back(rectangle);
  }
  const std::int64_t block = block_side(layout.rectangles);
  std::vector<Bits> footprints;
  for (const Rectangle& rectangle : layout.rectangles)
    footprints.push_back(make_footprint(mesh, windows, ownership, rectangle, margin, block, poll));
  const Packing packing = pack(footprints);
  // Without rectangles the canvas is a margin.
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

std::int64_t Blueprint::cell_of(std::int64_t texel, const Texture& grid) const {
  const auto window = static_cast<std::size_t>(ownership.window[static_cast<std::size_t>(texel)]);
  const Rectangle& rectangle = layout.rectangles[static_cast<std::size_t>(layout.rectangle_of[window])];
  const Place place = place_of(windows.windows[window], texel, grid);
  return (rectangle.row + place.y - rectangle.y) * layout.columns + rectangle.column + place.x - rectangle.x;
}

Point2 Blueprint::owned_place(std::int64_t texel, const Texture& grid) const {
  const auto window = static_cast<std::size_t>(ownership.window[static_cast<std::size_t>(texel)]);
  const Place place = place_of(windows.windows[window], texel, grid);
  return {static_cast<double>(place.x), static_cast<double>(place.y)};
}

Bands make_bands(const Blueprint& plan, double reach) {
  Bands result;
  std::vector<std::size_t> first_band;
  for (std::size_t i = 0; i < plan.layout.rectangles.size(); ++i) {
    first_band.push_back(result.bands.size());
    const std::int64_t height = plan.layout.rectangles[i].height;
    for (std::int64_t top = 0; top < height; top += rows_per_band)
      result.bands.push_back({static_cast<Index>(i), top, std::min(top + rows_per_band, height)});
  }
  const auto visit_near = [&](std::size_t i, std::span<const Point2> shape, double distance, Index number, const auto& put) {
    const Span near = bands_near(plan.layout.rectangles[i], shape, distance);
    for (std::int64_t band = near.first; band <= near.last; ++band)
      put(first_band[i] + static_cast<std::size_t>(band), number);
  };
  const auto chart_of = [&](std::size_t i) {
    const auto window = static_cast<std::size_t>(plan.layout.rectangles[i].window);
    return static_cast<std::size_t>(plan.windows.windows[window].chart);
  };
  const auto visit_borders = [&](const auto& put) {
    for (std::size_t i = 0; i < first_band.size(); ++i)
      for (Index b = plan.charts.border_offsets[chart_of(i)]; b < plan.charts.border_offsets[chart_of(i) + 1]; ++b) {
        const Edge edge = plan.charts.borders[static_cast<std::size_t>(b)].edge;
        visit_near(i, plan.mesh.ends(edge), reach, b, put);
      }
  };
  const auto visit_faces = [&](const auto& put) {
    for (std::size_t i = 0; i < first_band.size(); ++i) {
      const auto window = static_cast<std::size_t>(plan.layout.rectangles[i].window);
      if (plan.windows.windows[window].alone && plan.ownership.overlapping[chart_of(i)] == 0) continue;
      for (const Index face : plan.charts.faces_of(chart_of(i)))
        visit_near(i, plan.mesh.texels[static_cast<std::size_t>(face)], 0, face, put);
    }
  };
  list_by_band(result.bands.size(), visit_borders, result.border_offsets, result.borders);
  list_by_band(result.bands.size(), visit_faces, result.face_offsets, result.faces);
  return result;
}

}  // namespace beltrami::atlas
