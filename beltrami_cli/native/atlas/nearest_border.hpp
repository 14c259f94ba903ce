// The border edge of a chart that is nearest to a cell outside the chart.
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "atlas/charts.hpp"
#include "atlas/mesh.hpp"

namespace beltrami::atlas {

// A block of the texture's plane.
struct Block {
  std::int64_t x = 0, y = 0, width = 0, height = 0;
};

class NearestBorders {
 public:
  struct Entry {
    double squared_distance = std::numeric_limits<double>::infinity();
    double overhang = 0;  // how far past the edge's ends, along it
    Index border = none;
  };

  // Finds the border nearest to each cell of the block for which wanted is not 0, within the given distance. Only
  // borders that have the cell on their outer side are looked at. At a corner, where edges are equally near, seams come
  // before open edges, and then the one that faces the cell most directly.
  void find(const Mesh& mesh, const Charts& charts, std::span<const Index> borders, Block block, double reach,
            const std::vector<std::uint8_t>& wanted);

  const Entry& operator[](std::size_t cell) const { return entries_[cell]; }

 private:
  std::vector<Entry> entries_;
};

}  // namespace beltrami::atlas
