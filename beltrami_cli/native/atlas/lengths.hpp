// Distances in space between neighbouring cells of a canvas.
#pragma once

#include <cstdint>
#include <vector>

#include "atlas/cells.hpp"

namespace beltrami::atlas {

// Planes of squared lengths: to the right, below, below right, below left.
struct LengthPlanes {
  float* lengths;
  std::size_t plane;    // from one plane to the next
  std::size_t columns;  // from one row to the next
};

// Measures a band's cells.
class Lengths {
 public:
  explicit Lengths(LengthPlanes planes) : planes_(planes) {}

  // Measures the row that starts at `local` among the cells and at `start` on the canvas. Where the surface ends
  // between two cells, both are added to the cuts. The last row has no row below.
  void measure(const Cells& cells, std::size_t local, bool has_below, std::size_t start, std::vector<Index>& cuts);

 private:
  void find_plain(const Cells& cells, std::size_t local, std::size_t width);
  void measure_plain(const Cells& cells, std::size_t local, std::size_t start, std::size_t begin, std::size_t end);

  LengthPlanes planes_;
  std::vector<std::uint8_t> plain_;
};

}  // namespace beltrami::atlas
