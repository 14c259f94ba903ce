// Windows: the parts of charts, each at most one period of the texture wide and high, in which texels have places.
//
// A chart that fits into one period is one window. A chart that spans more (a texture that tiles) is cut in windows of
// one period each; the texels will belong to the fullest of them, and the others are dropped.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "atlas/charts.hpp"
#include "atlas/mesh.hpp"

namespace beltrami::atlas {

struct Window {
  Index chart = none, texture = none;
  std::int64_t x = 0, y = 0;          // first column and row, in the texture's plane; as wide and high as the texture
  std::size_t begin = 0, end = 0;     // its faces, in Windows::faces
  bool alone = true;                  // whether the chart has no other window
};

struct Windows {
  std::vector<Window> windows;  // in the order in which they may own texels: large charts before small ones
  std::vector<Index> faces;
};

// The texel columns at coordinates [x, x + columns.size()) of the texture's plane; none outside the window.
void list_columns(const Window& window, const Texture& grid, std::int64_t x, std::span<std::int32_t> columns);

Windows make_windows(const Mesh& mesh, const Charts& charts);

}  // namespace beltrami::atlas
