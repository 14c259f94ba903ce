#include "atlas/nearest_texel.hpp"

#include <algorithm>
#include <memory>

#include "parallel.hpp"

namespace beltrami::atlas {
namespace {

constexpr std::size_t rows_per_chunk = 16, columns_per_chunk = 64;
constexpr std::int64_t no_texel = -1;

// Farther than any row: the nearest marked row of a column without marks.
constexpr std::int32_t far = 1 << 30;

// Computes the nearest marked row of each texel in its column, the upper of two. The loops run over arrays, so that
// columns are processed side by side.
void search_columns(const unsigned char* marked, std::size_t height, std::size_t width, std::size_t begin, std::size_t end,
                    std::int32_t* nearest) {
  const std::size_t count = end - begin;
  std::vector<std::int32_t> rows(count, -far);
  std::int32_t* const last = rows.data();
  for (std::size_t row = 0; row < height; ++row) {
    const unsigned char* const here = marked + row * width + begin;
    std::int32_t* const best = nearest + row * width + begin;
    const auto number = static_cast<std::int32_t>(row);
    for (std::size_t i = 0; i < count; ++i) last[i] = here[i] != 0 ? number : last[i];
    std::copy(last, last + count, best);
  }
  rows.assign(count, far);
  for (std::size_t row = height; row-- > 0;) {
    const unsigned char* const here = marked + row * width + begin;
    std::int32_t* const best = nearest + row * width + begin;
    const auto number = static_cast<std::int32_t>(row);
    for (std::size_t i = 0; i < count; ++i) last[i] = here[i] != 0 ? number : last[i];
    for (std::size_t i = 0; i < count; ++i) best[i] = last[i] - number < number - best[i] ? last[i] : best[i];
  }
}

// The lower envelope of the parabolas (x - column)^2 + height^2 over some columns of a row.
class Envelope {
 public:
  // Takes columns [begin, end), whose nearest marked rows are in `nearest`.
  void build(std::int64_t row, std::int64_t begin, std::int64_t end, const std::int32_t* nearest) {
    parts_.clear();
    for (std::int64_t column = begin; column < end; ++column) {
      if (nearest[column] == far || nearest[column] == -far) continue;
      const std::int64_t square = (nearest[column] - row) * (nearest[column] - row);
      std::int64_t start = begin;
      while (!parts_.empty()) {
        start = std::max(begin, first_nearer(parts_.back(), column, square));
        if (start > parts_.back().start) break;
        parts_.pop_back();
        start = begin;
      }
      if (start < end) parts_.push_back({column, square, start});
    }
    part_ = 0;
  }

  // Returns the column of the mark nearest to x, if within reach; x must not decrease from call to call.
  std::int64_t column_for(std::int64_t x, std::int64_t reach) {
    if (parts_.empty()) return no_texel;
    while (part_ + 1 < parts_.size() && parts_[part_ + 1].start <= x) ++part_;
    const std::int64_t across = parts_[part_].column - x;
    return across * across + parts_[part_].square <= reach * reach ? parts_[part_].column : no_texel;
  }

 private:
  struct Part {
    std::int64_t column, square, start;
  };

  // The first x at which a parabola is below an earlier one.
  static std::int64_t first_nearer(const Part& earlier, std::int64_t column, std::int64_t square) {
    const std::int64_t sum = column * column - earlier.column * earlier.column + square - earlier.square;
    return sum < 0 ? 0 : sum / (2 * (column - earlier.column)) + 1;
  }

  std::vector<Part> parts_;
  std::size_t part_ = 0;
};

// Appends the wanted texels of a row, and their marks.
void search_row(const bool* wanted, const std::int32_t* nearest, std::int64_t row, std::int64_t width, std::int64_t reach,
                Envelope& envelope, NearestMarks& found) {
  const bool* const end = wanted + width;
  for (const bool* first = std::find(wanted, end, true); first != end;) {
    // Wanted texels at most 2 reach apart share an envelope of all columns that may contain their marks.
    const bool* last = first;
    for (const bool* next = first + 1; next < end && next - last <= 2 * reach; ++next)
      if (*next) last = next;
    const std::int64_t begin = first - wanted, stop = last - wanted + 1;
    envelope.build(row, std::max<std::int64_t>(0, begin - reach), std::min(width, stop + reach), nearest);
    for (std::int64_t x = begin; x < stop; ++x) {
      if (!wanted[x]) continue;
      const std::int64_t column = envelope.column_for(x, reach);
      if (column == no_texel) continue;
      found.texels.push_back(row * width + x);
      found.marks.push_back(nearest[column] * width + column);
    }
    first = std::find(last + 1, end, true);
  }
}

}  // namespace

NearestMarks nearest_marked(const bool* marked, const bool* wanted, std::int64_t height, std::int64_t width,
                            std::int64_t reach, unsigned threads) {
  reach = std::min(reach, height + width);  // farther than that is nothing
  const auto rows = static_cast<std::size_t>(height), columns = static_cast<std::size_t>(width);
  // Compilers vectorise loops over bytes, but not over bool.
  const auto* const bytes = reinterpret_cast<const unsigned char*>(marked);
  std::unique_ptr<std::int32_t[]> nearest(new std::int32_t[rows * columns]);
  parallel_chunks(columns, columns_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    search_columns(bytes, rows, columns, begin, end, nearest.get());
  });
  std::vector<NearestMarks> chunks((rows + rows_per_chunk - 1) / rows_per_chunk);
  parallel_chunks(rows, rows_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    Envelope envelope;
    for (std::size_t row = begin; row < end; ++row)
      search_row(wanted + row * columns, nearest.get() + row * columns, static_cast<std::int64_t>(row), width, reach,
                 envelope, chunks[begin / rows_per_chunk]);
  });
  NearestMarks all;
  for (const NearestMarks& chunk : chunks) {
    all.texels.insert(all.texels.end(), chunk.texels.begin(), chunk.texels.end());
    all.marks.insert(all.marks.end(), chunk.marks.begin(), chunk.marks.end());
  }
  return all;
}

}  // namespace beltrami::atlas
