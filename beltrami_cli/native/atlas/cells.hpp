// The cells of one band: their kinds, their places on the surface, and the sources of halo cells.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "atlas/borders.hpp"
#include "atlas/connections.hpp"
#include "atlas/layout.hpp"
#include "atlas/lookup.hpp"
#include "atlas/unfolding.hpp"

namespace beltrami::atlas {

enum class Kind : std::uint8_t { empty, owned, halo };

struct HaloCell {
  Index cell;
  std::array<Index, 4> taps;
  std::array<float, 4> weights;
  Index seam;
};

// A halo cell on an uncovered texel.
struct GutterCell {
  std::int64_t texel;
  double squared_distance;  // to the chart, in texels
  std::int64_t cell;
  Index chart;
};

class Cells {
 public:
  explicit Cells(const Blueprint& plan);

  void make(const Band& band, std::span<const Index> borders, std::span<const Index> faces);

  // Row by row, with the width of the rectangle; one row more than the band if the rectangle continues below.
  std::int64_t width() const { return block_.width; }
  std::int64_t height() const { return block_.height; }
  Kind kind(std::size_t cell) const { return kinds_[cell]; }
  Point3 position(std::size_t cell) const { return {positions_[0][cell], positions_[1][cell], positions_[2][cell]}; }
  // The same for all cells; where nearness is 0, the surface continues to all neighbours that are not empty.
  const Kind* kinds() const { return kinds_.data(); }
  const double* coordinates(std::size_t axis) const { return positions_[axis].data(); }
  const std::uint8_t* nearness() const { return nearness_.data(); }
  // Whether the surface continues between two neighbouring cells, neither of them empty.
  bool are_joined(std::size_t cell, std::size_t other) const {
    return nearness_[cell] == 0 || nearness_[other] == 0 || is_on(cell, other);
  }

  // Of the band's own rows, in the order of cells. May be moved from.
  std::vector<HaloCell> halo;
  std::vector<GutterCell> gutter;

 private:
  void enter(const Band& band);
  void find_owned();
  void find_wanted();
  void find_covered(std::span<const Index> faces);
  void make_owned(std::int64_t y, std::int64_t begin, std::int64_t end);
  void place_on(Index face, std::size_t begin, std::size_t end);
  void make_halo(std::size_t cell, Point2 place, bool record);
  std::optional<Sample> continue_chart(std::size_t cell, Point2 place);
  Plane plane_at(Edge edge, Point2 place) const;
  Point3 step_at(std::int64_t x, std::int64_t y, Point2 step) const;
  bool is_owned(std::int64_t x, std::int64_t y) const;
  Index owned_face(std::int64_t x, std::int64_t y) const;
  Point3 owned_position(std::int64_t x, std::int64_t y) const;
  void record_gutter(std::size_t cell, Point2 place, std::int64_t at);
  std::int64_t canvas_cell(Point2 place) const;
  void put(std::size_t cell, Point3 position);
  bool is_on(std::size_t cell, std::size_t other) const;
  Point2 place_of(std::size_t cell) const;

  const Blueprint& plan_;
  const double reach_;
  Block block_;
  const Rectangle* rectangle_ = nullptr;
  const Window* window_ = nullptr;
  const Texture* grid_ = nullptr;
  std::vector<std::int32_t> columns_;   // texel column at each of the block's; none outside the window
  std::vector<std::uint8_t> owned_;     // with margin rows more above and below
  std::vector<Point2> nearest_first_;   // steps to cells within the margin
  std::vector<std::uint8_t> wanted_;    // whether the cell, not owned, is near an owned one
  std::vector<Index> covering_;         // the face of the chart that covers a wanted cell
  std::vector<Kind> kinds_;
  std::array<std::vector<double>, 3> positions_;  // [axis]
  std::vector<Index> faces_;            // the chart's face at a cell; outside the chart -1 - number of its path,
                                        // if an open edge may be near
  std::vector<Path> paths_;
  std::vector<std::uint8_t> nearness_;  // to where charts end, see NearBorders
  Connections connections_;
  NearestBorders nearest_;
};

// Maximum distance of a halo cell from its chart, in texels.
double halo_reach(std::int64_t margin);

}  // namespace beltrami::atlas
