// Where the windows lie on the canvas.
#pragma once

#include <cstdint>
#include <vector>

#include "atlas/mesh.hpp"
#include "atlas/near_borders.hpp"
#include "atlas/ownership.hpp"
#include "atlas/windows.hpp"

namespace beltrami::atlas {

// The rectangle of a window: what it owns and a margin on all sides.
struct Rectangle {
  Index window = none;
  std::int64_t x = 0, y = 0;            // its upper left cell, in the texture's plane
  std::int64_t width = 0, height = 0;
  std::int64_t row = 0, column = 0;     // its upper left cell, on the canvas
};

struct Layout {
  std::int64_t rows = 0, columns = 0;
  std::vector<Rectangle> rectangles;
  std::vector<Index> rectangle_of;  // [window]; none if it owns nothing
};

Layout make_layout(const Ownership& ownership, std::int64_t margin);

// All that is known of a surface before cells are made.
struct Plan {
  const Mesh& mesh;
  const Charts& charts;
  const Windows& windows;
  const Ownership& ownership;
  const Layout& layout;
  const NearBorders& near_borders;
  std::int64_t margin;

  // The canvas cell of a texel that somebody owns.
  std::int64_t cell_of(std::int64_t texel, const Texture& grid) const;
  // The place in the texture's plane at which the owner has the texel.
  Point2 owned_place(std::int64_t texel, const Texture& grid) const;
};

}  // namespace beltrami::atlas
