// Stencils of grids for fast marching with a heap: the reference for tests of the window sweep, the kernel for larger
// windows, and the exact scheme of the paper.
//
// A. Spira, R. Kimmel, "An efficient solution to the eikonal equation on parametric manifolds", Interfaces and Free
// Boundaries 6 (2004): the four quadrants around a grid point are its stencils; where the metric makes a quadrant obtuse, a
// grid point (i, j) within it supports two acute ones. All lengths come from the metric g at the updated point.
#pragma once

#include <cstddef>
#include <vector>

#include "grid/grid.hpp"
#include "triangulated/stencils.hpp"

namespace beltrami::grid {

using triangulated::Index;

// Maximum distance of split supports: a quadrant that needs further ones has a section narrower than about 1 / 10
// radian, and the front then runs along the edges.
constexpr int furthest_support = 10;

enum class Scheme {
  triangles,  // the eight triangles around a cell, as in the window sweep
  metric      // quadrants, split by the metric
};

// The non-empty cells of a grid, numbered row by row.
struct CellNumbers {
  std::vector<Index> number_of;  // [cell], none where empty
  std::vector<std::size_t> cell_of;
};

CellNumbers number_cells(const Grid& grid);

// Stencils between the non-empty cells for the metric that `metric` colours induce.
triangulated::Stencils make_grid_stencils(const Grid& grid, const CellNumbers& numbers, Planes metric, float beta,
                                          Scheme scheme, unsigned threads);

}  // namespace beltrami::grid
