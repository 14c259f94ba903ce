#include "atlas/nearest_texel.hpp"

#include <algorithm>
#include <vector>

#include "parallel.hpp"

namespace beltrami::atlas {
namespace {

constexpr std::size_t rows_per_chunk = 16, columns_per_chunk = 64;

// Sets for each texel of some columns the nearest marked row of its column, the upper of two; -1 if there is none.
void search_columns(const bool* marked, std::int64_t height, std::int64_t width, std::int64_t begin, std::int64_t end,
                    std::int64_t* nearest) {
  std::vector<std::int64_t> last(static_cast<std::size_t>(end - begin), -1);
  const auto at = [&](std::int64_t row, std::int64_t column) -> std::int64_t& { return nearest[row * width + column]; };
  for (std::int64_t row = 0; row < height; ++row)
    for (std::int64_t column = begin; column < end; ++column) {
      auto& above = last[static_cast<std::size_t>(column - begin)];
      if (marked[row * width + column]) above = row;
      at(row, column) = above;
    }
  last.assign(last.size(), -1);
  for (std::int64_t row = height - 1; row >= 0; --row)
    for (std::int64_t column = begin; column < end; ++column) {
      auto& below = last[static_cast<std::size_t>(column - begin)];
      if (marked[row * width + column]) below = row;
      auto& best = at(row, column);
      if (below >= 0 && (best < 0 || below - row < row - best)) best = below;
    }
}

// The lower envelope of the parabolas (x - column)^2 + height^2 of one row.
class Envelope {
 public:
  explicit Envelope(std::int64_t width)
      : columns_(static_cast<std::size_t>(width)), starts_(columns_.size()), squares_(columns_.size()) {}

  void search(std::int64_t row, std::int64_t width, std::int64_t reach, std::int64_t* nearest) {
    std::size_t count = 0;
    for (std::int64_t column = 0; column < width; ++column) {
      if (nearest[column] < 0) continue;
      const std::int64_t square = (nearest[column] - row) * (nearest[column] - row);
      std::int64_t start = 0;
      while (count > 0) {
        start = first_nearer(count - 1, column, square);
        if (start > starts_[count - 1]) break;
        --count;
      }
      if (count == 0) start = 0;
      if (start >= width) continue;
      columns_[count] = column;
      squares_[count] = square;
      starts_[count++] = start;
    }
    if (count == 0) return;
    rows_.assign(nearest, nearest + width);
    std::size_t part = 0;
    for (std::int64_t x = 0; x < width; ++x) {
      while (part + 1 < count && starts_[part + 1] <= x) ++part;
      const std::int64_t column = columns_[part], across = column - x;
      const bool near = across * across + squares_[part] <= reach * reach;
      nearest[x] = near ? rows_[static_cast<std::size_t>(column)] * width + column : -1;
    }
  }

 private:
  // The first x at which a parabola is below an earlier one.
  std::int64_t first_nearer(std::size_t earlier, std::int64_t column, std::int64_t square) const {
    const std::int64_t before = columns_[earlier];
    const std::int64_t sum = column * column - before * before + square - squares_[earlier];
    const std::int64_t twice = 2 * (column - before);
    return sum < 0 ? 0 : sum / twice + 1;
  }

  std::vector<std::int64_t> columns_, starts_, squares_, rows_;
};

}  // namespace

std::unique_ptr<std::int64_t[]> nearest_marked(const bool* marked, std::int64_t height, std::int64_t width,
                                               std::int64_t reach, unsigned threads) {
  reach = std::min(reach, height + width);  // farther than that is nothing
  std::unique_ptr<std::int64_t[]> nearest(new std::int64_t[static_cast<std::size_t>(height * width)]);
  parallel_chunks(static_cast<std::size_t>(width), columns_per_chunk, threads,
                  [&](std::size_t begin, std::size_t end, unsigned) {
                    search_columns(marked, height, width, static_cast<std::int64_t>(begin),
                                   static_cast<std::int64_t>(end), nearest.get());
                  });
  parallel_chunks(static_cast<std::size_t>(height), rows_per_chunk, threads,
                  [&](std::size_t begin, std::size_t end, unsigned) {
                    Envelope envelope(width);
                    for (auto row = static_cast<std::int64_t>(begin); row < static_cast<std::int64_t>(end); ++row)
                      envelope.search(row, width, reach, nearest.get() + row * width);
                  });
  return nearest;
}

}  // namespace beltrami::atlas
