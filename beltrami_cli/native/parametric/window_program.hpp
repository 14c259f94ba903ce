// In which order the cells of a window are reached, and from what.
#pragma once

#include <vector>

#include "parametric/stencil_classes.hpp"

namespace beltrami::parametric {

// The window has 2 radius + 1 cells a side; slot (y + radius) * side + x + radius is the cell at offset (x, y).
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

// Targets ring by ring outwards, by distance in the plane. The first pass takes only supports that come earlier, which
// already hold distances; the second takes all that lie in the window, and repairs paths that bend around colour edges.
struct WindowProgram {
  int radius;
  std::vector<Target> outward, repair;
};

WindowProgram make_window_program(int radius);

}  // namespace beltrami::parametric
