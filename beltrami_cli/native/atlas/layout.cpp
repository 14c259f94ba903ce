#include "atlas/layout.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <numeric>
#include <span>
#include <stdexcept>

namespace beltrami::atlas {
namespace {

// A bitmap with rows of whole words.
struct Bits {
  std::int64_t rows = 0, columns = 0;
  std::vector<std::uint64_t> words;

  Bits(std::int64_t row_count, std::int64_t column_count)
      : rows(row_count), columns(column_count), words(static_cast<std::size_t>(row_count * words_a_row())) {}
  std::int64_t words_a_row() const { return (columns + 63) / 64; }
  std::uint64_t* row(std::int64_t i) { return words.data() + i * words_a_row(); }
  const std::uint64_t* row(std::int64_t i) const { return words.data() + i * words_a_row(); }
};

struct Spot {
  std::int64_t row, column;
};

struct Packing {
  std::int64_t rows = 0, columns = 0;
  std::vector<Spot> spots;  // [shape]: where its upper left bit goes
};

// Candidate widths, relative to the side of a square of the shapes' area; with many shapes, only the first ones.
constexpr std::array relative_widths{1.0, 1.15, 1.3, 1.6, 2.0, 2.5};
constexpr std::size_t many_shapes = 256, widths_for_many = 2;

// A run of bits in a shape's row.
struct RunOfBits {
  std::int64_t row, first, length;
};

std::vector<RunOfBits> runs_of(const Bits& shape) {
  std::vector<RunOfBits> runs;
  const auto is_set = [&](std::int64_t row, std::int64_t i) { return (shape.row(row)[i / 64] >> (i % 64) & 1) != 0; };
  for (std::int64_t row = 0; row < shape.rows; ++row)
    for (std::int64_t first = 0; first < shape.columns;) {
      std::int64_t end = first;
      while (end < shape.columns && is_set(row, end)) ++end;
      if (end > first) runs.push_back({row, first, end - first});
      first = std::max(end, first + 1);
    }
  // Long runs rule out most places.
  std::stable_sort(runs.begin(), runs.end(), [](const RunOfBits& a, const RunOfBits& b) { return a.length > b.length; });
  return runs;
}

class Canvas {
 public:
  explicit Canvas(std::int64_t columns)
      : columns_(columns), words_(static_cast<std::size_t>((columns + 63) / 64)), blocked_(words_), shifted_(words_) {}

  std::int64_t rows() const { return static_cast<std::int64_t>(longest_.size()); }

  Spot place(const Bits& shape) {
    const auto runs = runs_of(shape);
    for (std::int64_t row = 0;; ++row) {
      while (rows() < row + shape.rows) add_row();
      const std::int64_t column = find_column(shape, runs, row);
      if (column < 0) continue;
      for (const RunOfBits& run : runs) fill(row + run.row, column + run.first, run.length);
      return {row, column};
    }
  }

 private:
  void add_row() {
    taken_.resize(taken_.size() + words_, 0);
    longest_.push_back(columns_);
  }

  std::uint64_t* taken(std::int64_t row) { return taken_.data() + static_cast<std::size_t>(row) * words_; }

  // Returns the first column at which no run overlaps an occupied cell; -1 if there is none.
  std::int64_t find_column(const Bits& shape, const std::vector<RunOfBits>& runs, std::int64_t row) {
    for (const RunOfBits& run : runs)
      if (run.length > longest_[static_cast<std::size_t>(row + run.row)]) return -1;
    // Columns beyond the last one possible are blocked from the start.
    for (std::size_t word = 0; word < words_; ++word) {
      const std::int64_t first = 64 * static_cast<std::int64_t>(word);
      const std::int64_t open = std::clamp<std::int64_t>(columns_ - shape.columns + 1 - first, 0, 64);
      blocked_[word] = open == 64 ? 0 : ~std::uint64_t{0} << open;
    }
    for (const RunOfBits& run : runs)
      if (!block(run, row)) return -1;
    for (std::size_t word = 0; word < words_; ++word)
      if (blocked_[word] != ~std::uint64_t{0})
        return 64 * static_cast<std::int64_t>(word) + std::countr_one(blocked_[word]);
    return -1;
  }

  // Marks the columns at which a run would overlap an occupied cell; returns whether any column is left.
  bool block(const RunOfBits& run, std::int64_t row) {
    const std::uint64_t* from = taken(row + run.row);
    shift_down(from, run.first, shifted_.data());
    for (std::int64_t covered = 1; covered < run.length;) {
      const std::int64_t step = std::min(covered, run.length - covered);
      add_shifted(shifted_.data(), step);
      covered += step;
    }
    std::uint64_t all = ~std::uint64_t{0};
    for (std::size_t word = 0; word < words_; ++word) all &= blocked_[word] |= shifted_[word];
    return all != ~std::uint64_t{0};
  }

  void shift_down(const std::uint64_t* from, std::int64_t by, std::uint64_t* to) const {
    const auto words = static_cast<std::size_t>(by / 64);
    const int bits = static_cast<int>(by % 64);
    for (std::size_t i = 0; i < words_; ++i) to[i] = shifted_word(from, i + words, bits);
  }

  // Words are read before they are written: later ones are still unchanged.
  void add_shifted(std::uint64_t* words, std::int64_t by) const {
    const auto skipped = static_cast<std::size_t>(by / 64);
    const int bits = static_cast<int>(by % 64);
    for (std::size_t i = 0; i < words_; ++i) words[i] |= shifted_word(words, i + skipped, bits);
  }

  std::uint64_t shifted_word(const std::uint64_t* from, std::size_t word, int bits) const {
    const std::uint64_t low = word < words_ ? from[word] : 0, high = word + 1 < words_ ? from[word + 1] : 0;
    return bits == 0 ? low : low >> bits | high << (64 - bits);
  }

  void fill(std::int64_t row, std::int64_t first, std::int64_t length) {
    std::uint64_t* words = taken(row);
    for (std::int64_t i = first; i < first + length; ++i) words[i / 64] |= std::uint64_t{1} << (i % 64);
    std::int64_t longest = 0, free = 0;
    for (std::int64_t i = 0; i < columns_; ++i) {
      free = (words[i / 64] >> (i % 64) & 1) != 0 ? 0 : free + 1;
      longest = std::max(longest, free);
    }
    longest_[static_cast<std::size_t>(row)] = longest;
  }

  std::int64_t columns_;
  std::size_t words_;
  std::vector<std::uint64_t> taken_, blocked_, shifted_;
  std::vector<std::int64_t> longest_;  // [row]: free columns side by side
};

Packing pack_into(std::span<const Bits> shapes, const std::vector<std::size_t>& order, std::int64_t columns) {
  Packing packing;
  packing.spots.resize(shapes.size());
  Canvas canvas(columns);
  for (const std::size_t i : order) {
    packing.spots[i] = canvas.place(shapes[i]);
    packing.columns = std::max(packing.columns, packing.spots[i].column + shapes[i].columns);
  }
  packing.rows = canvas.rows();
  return packing;
}

// Packs shapes without overlap, the highest first, each in the first row and there in the first column that fits.
Packing pack(std::span<const Bits> shapes) {
  std::vector<std::size_t> order(shapes.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return shapes[a].rows > shapes[b].rows; });
  double area = 0;
  std::int64_t widest = 1;
  for (const Bits& shape : shapes) {
    for (const std::uint64_t word : shape.words) area += std::popcount(word);
    widest = std::max(widest, shape.columns);
  }
  Packing best;
  const std::size_t widths = shapes.size() > many_shapes ? widths_for_many : relative_widths.size();
  for (const double relative : std::span(relative_widths).first(widths)) {
    const auto columns = std::max(widest, static_cast<std::int64_t>(std::ceil(relative * std::sqrt(area))));
    auto packing = pack_into(shapes, order, columns);
    if (best.spots.empty() || packing.rows * packing.columns < best.rows * best.columns) best = std::move(packing);
  }
  return best;
}

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

void set(std::uint64_t* row, std::int64_t first, std::int64_t last) {
  for (std::int64_t i = first; i <= last; ++i) row[i / 64] |= std::uint64_t{1} << (i % 64);
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
        set(footprint.row(row), begin / block, (end - 1 + 2 * margin) / block);
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
        visit_near(i, plan.mesh.ends(edge), reach, b, put);
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
