// A parametric manifold sampled on a grid: an image, a height map, or the canvas of a texture atlas.
//
// Edges run from each cell to its eight neighbours. A triangle of three mutual neighbours is one half of a grid
// square; a cell is updated through the eight triangles around it that have it at a corner of 45 degrees (in the
// plane), so corners are seldom obtuse and need no splitting.
#pragma once

#include <cstddef>
#include <cstdint>

namespace beltrami::parametric {

// Squared lengths of a cell's edges are kept in four planes; the other four directions are the neighbours' own.
enum Direction : std::size_t { right, below, below_right, below_left };
constexpr std::size_t direction_count = 4;

// An edge that does not exist: longer than any radius, and small enough that no arithmetic on it overflows.
constexpr float no_edge = 1e12F;

// No kernel reaches further, so none goes over an edge that does not exist.
constexpr float longest_radius = 9e5F;

enum Kind : std::uint8_t { empty = 0, owned = 1, halo = 2 };

struct Grid {
  std::size_t rows = 0, columns = 0;
  const std::uint8_t* kind = nullptr;      // rows * columns, see Kind
  const float* squared_lengths = nullptr;  // direction_count planes of rows * columns, in space; not finite where
                                           // there is no edge, as there is none at an empty cell
  const float* scale = nullptr;            // rows * columns: what a cell's squared lengths are multiplied by, to make
                                           // local units of them; nullptr: 1
  const std::uint8_t* repeats = nullptr;   // rows * columns: how many cells show what a cell shows, each of which counts
                                           // in averages for one over that many; nullptr: 1
  std::size_t cells() const { return rows * columns; }
};

// N planes of rows * columns values.
struct Planes {
  const float* data = nullptr;
  std::size_t channels = 0;
};

}  // namespace beltrami::parametric
