// Pictures of bits packed on one canvas so that no bit lies on another.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "atlas/footprint.hpp"

namespace beltrami::atlas {

struct Spot {
  std::int64_t row, column;
};

struct Packing {
  std::int64_t rows = 0, columns = 0;
  std::vector<Spot> spots;  // [shape]: where its upper left bit goes
};

// High shapes come first, each to the first row, and in it the first column, where it fits.
Packing pack(std::span<const Bits> shapes);

}  // namespace beltrami::atlas
