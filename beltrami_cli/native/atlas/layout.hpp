// Layout of windows on the canvas, and the bands of rows that are processed one by one.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "atlas/borders.hpp"
#include "atlas/mesh.hpp"
#include "atlas/ownership.hpp"
#include "atlas/windows.hpp"
#include "parallel.hpp"

namespace beltrami::atlas {

// The rectangle of a window: its owned cells with a margin, one cell wider above and on the left if that is odd.
struct Rectangle {
  Index window = none;
  std::int64_t x = 0, y = 0;            // its upper left cell, in the texture's plane
  std::int64_t width = 0, height = 0;
  std::int64_t row = 0, column = 0;     // its upper left cell, on the canvas
};

// Rectangles may overlap on the canvas, but cells within the margin of owned cells may not.
struct Layout {
  std::int64_t rows = 0, columns = 0;
  std::vector<Rectangle> rectangles;
  std::vector<Index> rectangle_of;  // [window]; none if it owns nothing
};

// Throws std::length_error if the canvas would have more than 2^31 cells.
Layout make_layout(const Mesh& mesh, const Windows& windows, const Ownership& ownership, std::int64_t margin,
                   const Poll& poll);

// All that cells are made from.
struct Blueprint {
  const Mesh& mesh;
  const Charts& charts;
  const Windows& windows;
  const Ownership& ownership;
  const Layout& layout;
  const NearBorders& near_borders;
  std::int64_t margin;

  // The canvas cell of a texel that a window owns.
  std::int64_t cell_of(std::int64_t texel, const Texture& grid) const;
  // The point in the texture's plane at which the owner has the texel.
  Point2 owned_place(std::int64_t texel, const Texture& grid) const;
};

struct Band {
  Index rectangle = none;
  std::int64_t top = 0, bottom = 0;  // rows of the rectangle; the row at the bottom is looked at but not made
};

// Bands of the rectangles, and the parts of the surface that each needs.
struct Bands {
  std::vector<Band> bands;
  // Borders near each band, and faces that may cover its cells which belong to another window.
  std::vector<std::size_t> border_offsets, face_offsets;
  std::vector<Index> borders, faces;

  std::span<const Index> borders_of(std::size_t band) const {
    return std::span(borders).subspan(border_offsets[band], border_offsets[band + 1] - border_offsets[band]);
  }
  std::span<const Index> faces_of(std::size_t band) const {
    return std::span(faces).subspan(face_offsets[band], face_offsets[band + 1] - face_offsets[band]);
  }
};

Bands make_bands(const Blueprint& plan, double reach);

}  // namespace beltrami::atlas
