// An atlas as a manifold: charts on a canvas, extended over their seams.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "atlas/array.hpp"
#include "atlas/mesh.hpp"
#include "parallel.hpp"

namespace beltrami::atlas {

// Cells are named by row * columns + column; texels by their number among the texels of all textures.
struct Atlas {
  std::int64_t rows = 0, columns = 0;
  Array<std::uint8_t> kind;                   // 0 empty, 1 owned, 2 halo
  Array<float> squared_lengths;               // four planes: to the right, below, below right, below left
  Array<Index> cut_cells;                     // those between which and a neighbour the surface ends
  Array<Index> owned_cells, owned_texels;
  Array<Index> chart_of;                      // of each owned cell
  Array<Index> halo_cells, halo_taps;         // four taps a cell
  Array<float> halo_weights;
  Array<Index> halo_seams;
  Array<Index> gutter_cells, gutter_texels;
  Array<Index> border_texels, lone_texels;    // uncovered, but looked up by faces
  std::int64_t charts = 0, seams = 0, covered = 0, overlapped = 0;
};

// `allocate` provides the memory of large arrays, also temporary ones. The poll counts bands of charts. Throws
// std::invalid_argument if an index of the surface is out of range or the margin is not positive, std::length_error if
// the surface, its textures or its canvas are too large, Cancelled if the poll asks to stop.
Atlas make_atlas(const Surface& surface, std::int64_t margin, unsigned threads,
                 const Allocate& allocate = allocate_on_heap, const Poll& poll = {});

}  // namespace beltrami::atlas
