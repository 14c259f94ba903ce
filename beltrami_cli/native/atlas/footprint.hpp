// Which part of its rectangle on the canvas a window really needs.
#pragma once

#include <cstdint>
#include <vector>

#include "atlas/mesh.hpp"
#include "atlas/ownership.hpp"
#include "atlas/windows.hpp"

namespace beltrami::atlas {

// The rectangle of a window: what it owns and a margin on all sides.
struct Rectangle {
  Index window = none;
  std::int64_t x = 0, y = 0;            // its upper left cell, in the texture's plane
  std::int64_t width = 0, height = 0;
  std::int64_t row = 0, column = 0;     // its upper left cell, on the canvas
};

// A picture of bits, rows of whole words.
struct Bits {
  std::int64_t rows = 0, columns = 0;
  std::vector<std::uint64_t> words;

  Bits(std::int64_t row_count, std::int64_t column_count)
      : rows(row_count), columns(column_count), words(static_cast<std::size_t>(row_count * words_a_row())) {}
  std::int64_t words_a_row() const { return (columns + 63) / 64; }
  std::uint64_t* row(std::int64_t i) { return words.data() + i * words_a_row(); }
  const std::uint64_t* row(std::int64_t i) const { return words.data() + i * words_a_row(); }
};

// The blocks of the rectangle, `block` cells a side, that hold a cell within `margin` rows and columns of an owned one.
Bits make_footprint(const Mesh& mesh, const Windows& windows, const Ownership& ownership, const Rectangle& rectangle,
                    std::int64_t margin, std::int64_t block);

}  // namespace beltrami::atlas
