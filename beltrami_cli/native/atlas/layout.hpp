// Where the windows lie on the canvas.
#pragma once

#include <cstdint>
#include <vector>

#include "atlas/footprint.hpp"
#include "atlas/mesh.hpp"
#include "atlas/near_borders.hpp"
#include "atlas/ownership.hpp"
#include "atlas/windows.hpp"

namespace beltrami::atlas {

// Rectangles may overlap on the canvas, but not the cells within the margin of what their windows own.
struct Layout {
  std::int64_t rows = 0, columns = 0;
  std::vector<Rectangle> rectangles;
  std::vector<Index> rectangle_of;  // [window]; none if it owns nothing
};

// Throws std::length_error if the canvas would have more than 2^31 cells.
Layout make_layout(const Mesh& mesh, const Windows& windows, const Ownership& ownership, std::int64_t margin);

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
