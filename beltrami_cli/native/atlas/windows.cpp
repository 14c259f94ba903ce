#include "atlas/windows.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <tuple>

namespace beltrami::atlas {
namespace {

// Maximum number of periods of a face; of larger ones only the middle is used. All faces together have at most a few
// million pairs of a face and a window.
constexpr double most_face_periods = 64, most_pairs = 1 << 22;

struct Box {
  double left = std::numeric_limits<double>::infinity(), right = -left, top = left, bottom = -left;
  void add(Point2 p) {
    left = std::min(left, p.x);
    right = std::max(right, p.x);
    top = std::min(top, p.y);
    bottom = std::max(bottom, p.y);
  }
};

// Windows along one axis: window i starts at start + i * size.
struct Axis {
  std::int64_t start = 0, size = 1;
  bool alone = true;
  double middle = 0;  // the window in the middle, perhaps between two

  Axis(double low, double high, std::int32_t texels, Wrap wrap) : size(texels) {
    if (wrap == Wrap::clamp || !(low <= high)) return;
    const auto first = static_cast<std::int64_t>(std::ceil(low));
    start = wrap == Wrap::repeat ? first : first - floor_mod(first, size);
    alone = std::floor(high) < static_cast<double>(start + size);
    middle = 0.5 * static_cast<double>(window(low) + window(high));
  }
  std::int64_t window(double place) const {
    return static_cast<std::int64_t>(std::floor((place - static_cast<double>(start)) / static_cast<double>(size)));
  }
  // The windows that a face overlaps.
  std::pair<std::int64_t, std::int64_t> range(double low, double high, double periods) const {
    if (alone) return {0, 0};
    const double centre = 0.5 * (low + high), reach = 0.5 * periods * static_cast<double>(size);
    return {window(std::max(std::ceil(low), centre - reach)), window(std::min(high, centre + reach))};
  }
};

// Cuts a polygon by a line: keeps where sign * (coordinate - at) >= 0.
template <class Coordinate>
std::vector<Point2> cut(const std::vector<Point2>& polygon, double at, double sign, const Coordinate& coordinate) {
  std::vector<Point2> kept;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Point2 a = polygon[i], b = polygon[(i + 1) % polygon.size()];
    const double inside_a = sign * (coordinate(a) - at), inside_b = sign * (coordinate(b) - at);
    if (inside_a >= 0) kept.push_back(a);
    if ((inside_a < 0) != (inside_b < 0)) kept.push_back(a + inside_a / (inside_a - inside_b) * (b - a));
  }
  return kept;
}

double area_within(const std::array<Point2, 3>& corners, double left, double top, double width, double height) {
  const auto x = [](Point2 p) { return p.x; };
  const auto y = [](Point2 p) { return p.y; };
  std::vector<Point2> polygon(corners.begin(), corners.end());
  polygon = cut(cut(cut(cut(polygon, left, 1, x), left + width, -1, x), top, 1, y), top + height, -1, y);
  double doubled = 0;
  for (std::size_t i = 2; i < polygon.size(); ++i)
    doubled += cross(polygon[i - 1] - polygon[0], polygon[i] - polygon[0]);
  return 0.5 * std::abs(doubled);
}

struct Part {
  std::int64_t row, column;
  Index face;
  double area;
  auto window() const { return std::tuple(row, column); }
};

class Maker {
 public:
  Maker(const Mesh& mesh, const Charts& charts) : mesh_(mesh), charts_(charts) {}

  Windows make() {
    std::vector<std::size_t> order(charts_.size());
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return charts_.areas[a] > charts_.areas[b]; });
    result_.faces.reserve(mesh_.size());
    // Degenerate charts do not cover any texel.
    for (const std::size_t chart : order)
      if (charts_.areas[chart] > 0) add(chart);
    return std::move(result_);
  }

 private:
  void add(std::size_t chart) {
    const auto faces = charts_.faces_of(chart);
    Box box;
    for (const Index face : faces)
      for (const Point2 corner : mesh_.texels[static_cast<std::size_t>(face)]) box.add(corner);
    const Texture& grid = mesh_.grid(static_cast<std::size_t>(faces[0]));
    const Axis columns(box.left, box.right, grid.width, grid.wrap_x), rows(box.top, box.bottom, grid.height, grid.wrap_y);
    if (columns.alone && rows.alone) {
      open_window(chart, columns.start, rows.start, true);
      result_.faces.insert(result_.faces.end(), faces.begin(), faces.end());
      result_.windows.back().end = result_.faces.size();
    } else {
      add_many(chart, columns, rows);
    }
  }

  void add_many(std::size_t chart, const Axis& columns, const Axis& rows) {
    auto parts = cut_faces(chart, columns, rows);
    std::sort(parts.begin(), parts.end(), [](const Part& a, const Part& b) {
      return a.window() != b.window() ? a.window() < b.window() : a.face < b.face;
    });
    struct WindowRun {
      std::size_t begin, end;
      double area, from_middle = 0;
      // Equally full windows are ranked by position: in the middle the chart continues on all sides.
      auto rank(double full) const { return std::tuple(-std::llround(1000 * area / full), from_middle); }
    };
    std::vector<WindowRun> runs;
    for (std::size_t i = 0; i < parts.size(); ++i) {
      if (i == 0 || parts[i].window() != parts[i - 1].window()) runs.push_back({i, i, 0, 0});
      runs.back().end = i + 1;
      runs.back().area += parts[i].area;
    }
    for (WindowRun& run : runs) {
      const double x = static_cast<double>(parts[run.begin].column) - columns.middle;
      const double y = static_cast<double>(parts[run.begin].row) - rows.middle;
      run.from_middle = x * x + y * y;
    }
    const double full = static_cast<double>(columns.size) * static_cast<double>(rows.size);
    std::stable_sort(runs.begin(), runs.end(), [&](const WindowRun& a, const WindowRun& b) { return a.rank(full) < b.rank(full); });
    for (const WindowRun& run : runs) {
      const Part& first = parts[run.begin];
      open_window(chart, columns.start + first.column * columns.size, rows.start + first.row * rows.size, false);
      for (std::size_t i = run.begin; i < run.end; ++i) result_.faces.push_back(parts[i].face);
      result_.windows.back().end = result_.faces.size();
    }
  }

  std::vector<Part> cut_faces(std::size_t chart, const Axis& columns, const Axis& rows) const {
    const auto faces = charts_.faces_of(chart);
    const double periods = std::clamp(std::sqrt(most_pairs / static_cast<double>(faces.size())), 2.0, most_face_periods);
    std::vector<Part> parts;
    for (const Index face : faces) {
      const auto& corners = mesh_.texels[static_cast<std::size_t>(face)];
      Box box;
      for (const Point2 corner : corners) box.add(corner);
      const auto [left, right] = columns.range(box.left, box.right, periods);
      const auto [top, bottom] = rows.range(box.top, box.bottom, periods);
      const bool whole = left == right && top == bottom;
      for (std::int64_t row = top; row <= bottom; ++row)
        for (std::int64_t column = left; column <= right; ++column) {
          const double area = whole ? 0.5 * std::abs(doubled_area(corners))
                                    : area_within(corners, static_cast<double>(columns.start + column * columns.size),
                                                  static_cast<double>(rows.start + row * rows.size),
                                                  static_cast<double>(columns.size), static_cast<double>(rows.size));
          if (area > 0) parts.push_back({row, column, face, area});
        }
    }
    return parts;
  }

  void open_window(std::size_t chart, std::int64_t x, std::int64_t y, bool alone) {
    const auto face = static_cast<std::size_t>(charts_.faces_of(chart)[0]);
    result_.windows.push_back(
        {static_cast<Index>(chart), mesh_.texture[face], x, y, result_.faces.size(), result_.faces.size(), alone});
  }

  const Mesh& mesh_;
  const Charts& charts_;
  Windows result_;
};

}  // namespace

void list_columns(const Window& window, const Texture& grid, std::int64_t x, std::span<std::int32_t> columns) {
  for (std::int32_t& column : columns) {
    column = x >= window.x && x < window.x + grid.width ? wrapped(x, grid.width, grid.wrap_x) : none;
    ++x;
  }
}

Windows make_windows(const Mesh& mesh, const Charts& charts) { return Maker(mesh, charts).make(); }

}  // namespace beltrami::atlas
