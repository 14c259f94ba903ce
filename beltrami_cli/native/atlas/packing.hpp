// Packing of bitmaps on a canvas.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace beltrami::atlas {

// A bitmap with rows of whole words.
struct Bits {
  std::int64_t rows = 0, columns = 0;
  std::vector<std::uint64_t> words;

  Bits(std::int64_t row_count, std::int64_t column_count)
      : rows(row_count), columns(column_count), words(static_cast<std::size_t>(row_count * words_a_row())) {}
  std::int64_t words_a_row() const { return (columns + 63) / 64; }
  std::uint64_t* row(std::int64_t i) { return words.data() + i * words_a_row(); }
  const std::uint64_t* row(std::int64_t i) const { return words.data() + i * words_a_row(); }
  void set(std::int64_t i, std::int64_t first, std::int64_t last) {
    for (std::int64_t column = first; column <= last; ++column) row(i)[column / 64] |= std::uint64_t{1} << (column % 64);
  }
};

struct Spot {
  std::int64_t row, column;
};

struct Packing {
  std::int64_t rows = 0, columns = 0;
  std::vector<Spot> spots;  // [shape]: where its upper left bit goes
};

// Packs shapes without overlap, the highest first, each in the first row and there in the first column that fits.
Packing pack(std::span<const Bits> shapes);

}  // namespace beltrami::atlas
