// Charts: the connected parts of the surface in the image plane; and the seams between them.
#pragma once

#include <span>
#include <vector>

#include "atlas/mesh.hpp"

namespace beltrami::atlas {

// An edge at which a chart ends.
struct Border {
  Edge edge = none;
  Index seam = none;  // number of the seam, none at an open edge
};

struct Charts {
  std::vector<Index> chart_of;      // [face]
  std::vector<Index> face_offsets;  // chart c has the faces [face_offsets[c], face_offsets[c + 1])
  std::vector<Index> faces;
  std::vector<Index> border_offsets;
  std::vector<Border> borders;
  std::vector<double> areas;        // in texels
  Index seams = 0;

  std::size_t size() const { return areas.size(); }
  std::span<const Index> faces_of(std::size_t chart) const {
    return std::span(faces).subspan(static_cast<std::size_t>(face_offsets[chart]),
                                    static_cast<std::size_t>(face_offsets[chart + 1] - face_offsets[chart]));
  }
};

// Charts are numbered by their first face. A seam is all seam edges between two charts, or a connected run of
// seam edges of a chart with itself.
Charts make_charts(const Mesh& mesh);

}  // namespace beltrami::atlas
