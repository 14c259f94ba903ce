// One iteration of the short-time Beltrami kernel on a grid, by sweeps over a window of fixed order.
//
// A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images on manifolds" (2007), eqs. (8), (9).
// The distances solve the discrete eikonal equation of fast marching, but without a heap: the cells of the window
// are updated in an order fixed beforehand, so that sixteen neighbouring centres go through the same operations
// side by side in the lanes of vector registers.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "grid/grid.hpp"
#include "parallel.hpp"

namespace beltrami::grid {

// The planes of a tile, about 32 floats a cell, stay in the second-level cache (some 0.5 MB).
constexpr std::size_t tile_rows = 32, tile_columns = 96;

// The window has a side of 2 radius + 1 cells; slot (y + radius) * side + x + radius is the cell at offset (x, y).
struct EdgeStep {
  int from;         // slot
  Direction plane;  // where the edge's length is kept
  Offset cell;      // relative to the window's centre
};

struct TriangleStep {
  int axis, diagonal;  // slots
  std::size_t stencil_class;
};

struct Target {
  int slot;
  Offset offset;
  std::vector<EdgeStep> edges;
  std::vector<TriangleStep> triangles;
};

// Targets in rings outwards, by distance in the plane. Each is supported only by cells of inner rings, which already
// have distances: paths that turn back around colour edges are missed.
struct WindowProgram {
  int radius;
  std::vector<Target> targets;
};

WindowProgram make_window_program(int radius);

struct SweepParameters {
  float time_step;  // t, squared length
  float radius;     // sqrt(-4 t ln threshold), length
  float beta;       // lengths per unit of colour
};

// Copies cells of planes to other planes.
void copy_planes(const Planes& planes, std::size_t cells, float* const* copies, unsigned threads);

// Measures distances on `metric` colours and averages `colours`; both have grid.cells() values per plane. Writes the
// owned cells of `smoothed` (contiguous planes, like colours) and copies the others. Returns the sum over owned cells
// of the number of samples in each kernel. Bit-identical for any number of threads and any instruction set. The poll
// counts cells of the grid; throws Cancelled if it asks to stop.
std::int64_t smooth_by_sweeps(const Grid& grid, Planes metric, Planes colours, const SweepParameters& parameters,
                              const WindowProgram& program, float* smoothed, unsigned threads, const Poll& poll = {});

// Distances from one owned cell, as in smooth_by_sweeps: (2 program.radius + 1)^2 values, row by row, infinite beyond
// parameters.radius. The time step has no effect.
void distances_by_sweeps(const Grid& grid, Planes metric, const SweepParameters& parameters, const WindowProgram& program,
                         std::size_t cell, float* distances);

}  // namespace beltrami::grid
