// A parametric manifold sampled on a grid: an image, a height map, or the canvas of a texture atlas.
//
// Edges run from each cell to its eight neighbours. A triangle of three mutual neighbours is one half of a grid
// square; a cell is updated through the eight triangles around it that have it at a corner of 45 degrees (in the
// plane), so corners are seldom obtuse and need no splitting.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace beltrami::grid {

// Squared lengths of a cell's edges are stored in four planes; the other four directions belong to its neighbours.
enum Direction : std::size_t { right, below, below_right, below_left };
constexpr std::size_t direction_count = 4;

// An edge that does not exist: longer than any radius, and small enough that no arithmetic on it overflows.
constexpr float no_edge = 1e12F;

// Maximum radius of kernels, so that none crosses a missing edge.
constexpr float longest_radius = 9e5F;

enum Kind : std::uint8_t { empty = 0, owned = 1, halo = 2 };

struct Grid {
  std::size_t rows = 0, columns = 0;
  // Planes of rows * columns values:
  const std::uint8_t* kind = nullptr;  // see Kind
  std::array<const float*, direction_count> squared_lengths{};  // in space; not finite without an edge, as at empty cells
  const float* scale = nullptr;           // factors from the cell's squared lengths to local units; nullptr: 1
  const std::uint8_t* repeats = nullptr;  // number of cells that show the same texel, and share its weight; nullptr: 1
  std::size_t cells() const { return rows * columns; }
};

// Planes of rows * columns values, not necessarily contiguous.
struct Planes {
  const float* const* data = nullptr;
  std::size_t channels = 0;
  const float* operator[](std::size_t channel) const { return data[channel]; }
};

// Contiguous planes.
template <class Value>
std::vector<Value*> planes_of(Value* values, const Grid& grid, std::size_t channels) {
  std::vector<Value*> planes;
  for (std::size_t k = 0; k < channels; ++k) planes.push_back(values + k * grid.cells());
  return planes;
}

struct Offset {
  int x, y;
  friend constexpr bool operator==(Offset, Offset) = default;
  friend constexpr Offset operator+(Offset a, Offset b) { return {a.x + b.x, a.y + b.y}; }
  friend constexpr Offset operator-(Offset a, Offset b) { return {a.x - b.x, a.y - b.y}; }
};

// The updated cell is the origin; its supports are a neighbour along an axis and one along a diagonal.
struct StencilClass {
  Offset axis, diagonal;
};

constexpr std::array<StencilClass, 8> stencil_classes{{
    {{-1, 0}, {-1, -1}}, {{-1, 0}, {-1, 1}}, {{1, 0}, {1, -1}}, {{1, 0}, {1, 1}},
    {{0, -1}, {-1, -1}}, {{0, -1}, {1, -1}}, {{0, 1}, {-1, 1}}, {{0, 1}, {1, 1}},
}};

constexpr std::array<Offset, 8> neighbours{{{-1, 0}, {1, 0}, {0, -1}, {0, 1}, {-1, -1}, {1, 1}, {1, -1}, {-1, 1}}};

// Storage of the edge from cell `from` to `from + step`: a plane, and the cell that owns it.
struct EdgePlace {
  Direction plane;
  Offset cell;
};

constexpr EdgePlace edge_place(Offset from, Offset step) {
  const Offset to = from + step;
  if (step == Offset{1, 0}) return {right, from};
  if (step == Offset{-1, 0}) return {right, to};
  if (step == Offset{0, 1}) return {below, from};
  if (step == Offset{0, -1}) return {below, to};
  if (step == Offset{1, 1}) return {below_right, from};
  if (step == Offset{-1, -1}) return {below_right, to};
  if (step == Offset{-1, 1}) return {below_left, from};
  return {below_left, to};
}

// Coefficients of a stencil's update, see triangulated/stencils.hpp; all zero if there is no update.
struct Coefficients {
  float k, squared_height, n;
};

// Squared lengths: a from the updated cell to the diagonal support, b to the axis support, c between the supports.
// An obtuse corner, a missing edge or supports at one place give no update; edges alone then carry the front.
inline Coefficients make_coefficients(float a, float b, float c) {
  const float k = (b + c - a) / (2 * c);
  const float squared_height = b - k * k * c;
  const bool usable = a + b >= c && a < no_edge && b < no_edge && c < no_edge && c > 0 && squared_height > 0;
  return usable ? Coefficients{k, squared_height, squared_height / c} : Coefficients{0, 0, 0};
}

}  // namespace beltrami::grid
