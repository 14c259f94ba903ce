#include "atlas/bands.hpp"

#include <algorithm>
#include <cmath>

namespace beltrami::atlas {
namespace {

// High enough that the row that neighbouring bands both look at costs little, low enough that a band fits the cache.
constexpr std::int64_t rows_per_band = 64;

// The bands [first, last] of a rectangle that a shape comes near to.
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
  // The row below a band is looked at, too.
  return {std::max<std::int64_t>(row(top - reach) - 1, 0) / rows_per_band, row(bottom + reach) / rows_per_band};
}

// Lists numbers by band; the visitor calls its argument with (band, number), twice in the same way.
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

Bands make_bands(const Plan& plan, double reach) {
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
        const auto& corners = plan.mesh.texels[static_cast<std::size_t>(edge / 3)];
        const auto k = static_cast<std::size_t>(edge % 3);
        visit_near(i, std::array{corners[k], corners[next(k)]}, reach, b, put);
      }
  };
  const auto visit_faces = [&](const auto& put) {
    for (std::size_t i = 0; i < first_band.size(); ++i) {
      const auto window = static_cast<std::size_t>(plan.layout.rectangles[i].window);
      if (plan.windows.windows[window].alone && plan.ownership.loser[chart_of(i)] == 0) continue;
      for (const Index face : plan.charts.faces_of(chart_of(i)))
        visit_near(i, plan.mesh.texels[static_cast<std::size_t>(face)], 0, face, put);
    }
  };
  list_by_band(result.bands.size(), visit_borders, result.border_offsets, result.borders);
  list_by_band(result.bands.size(), visit_faces, result.face_offsets, result.faces);
  return result;
}

}  // namespace beltrami::atlas
