// The eight triangles around a cell, and where their edges are kept.
#pragma once

#include <array>

#include "parametric/grid.hpp"

namespace beltrami::parametric {

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

// Where the edge from cell `from` to its neighbour `from + step` is kept: a plane, and the cell that owns it.
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

// What a stencil needs at an update, see triangulated/stencils.hpp; all zero where it gives none.
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

}  // namespace beltrami::parametric
