// Rectangles cut in bands of rows, which are worked on one by one; and what of the surface each band needs.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "atlas/layout.hpp"

namespace beltrami::atlas {

struct Band {
  Index rectangle = none;
  std::int64_t top = 0, bottom = 0;  // rows of the rectangle; the row at the bottom is looked at but not made
};

struct Bands {
  std::vector<Band> bands;
  // Borders near each band, and faces that may cover cells of it which belong to another window.
  std::vector<std::size_t> border_offsets, face_offsets;
  std::vector<Index> borders, faces;

  std::span<const Index> borders_of(std::size_t band) const {
    return std::span(borders).subspan(border_offsets[band], border_offsets[band + 1] - border_offsets[band]);
  }
  std::span<const Index> faces_of(std::size_t band) const {
    return std::span(faces).subspan(face_offsets[band], face_offsets[band + 1] - face_offsets[band]);
  }
};

Bands make_bands(const Plan& plan, double reach);

}  // namespace beltrami::atlas
