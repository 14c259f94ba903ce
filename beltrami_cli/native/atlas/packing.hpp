// Rectangles packed on one canvas, on shelves.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace beltrami::atlas {

struct Size {
  std::int64_t width, height;
};

struct Spot {
  std::int64_t row, column;
};

struct Packing {
  std::int64_t rows = 0, columns = 0;
  std::vector<Spot> spots;  // [rectangle]: its upper left cell
};

// Throws std::length_error if the canvas would have more than 2^31 cells.
Packing pack(std::span<const Size> rectangles);

}  // namespace beltrami::atlas
