// Vectorised lengths of segments; compiled once for each instruction set from the same source.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "instruction_set.hpp"
#include "triangulated/metric.hpp"
#include "triangulated/segments.hpp"

namespace beltrami::triangulated {

// A metric and the segments that are straight in it. Tables of edges have sixteen spare entries.
struct LengthTables {
  std::vector<std::array<Index, 2>> edges;
  TrianglePlanes planes;
  Segments segments;
  std::vector<float> in_space;  // [edge]: squared length without colours
  std::vector<float> squared;   // [edge]: squared length
};

// Parts of one update, each for edges or triangles [begin, end), begin a multiple of sixteen.
struct LengthSweep {
  // Squared lengths of edges by eq. (1), from in_space.
  void (*measure_edges)(LengthTables& tables, Rows<float> colours, float squared_beta, std::size_t begin, std::size_t end);
  // From these, lengths of segments along edges, and of segments that cross one or two edges of triangles.
  void (*set_lengths)(LengthTables& tables, std::size_t begin, std::size_t end);
  void (*cross_edges)(LengthTables& tables, std::size_t begin, std::size_t end);
};

BELTRAMI_DECLARE_VARIANTS(extern const LengthSweep length_sweep)

}  // namespace beltrami::triangulated
