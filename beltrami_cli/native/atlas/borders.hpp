// Borders of charts: the texels near them, and the nearest border of each cell outside its chart.
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "atlas/charts.hpp"
#include "atlas/mesh.hpp"

namespace beltrami::atlas {

// Bits of a texel: it is within two texels of an open edge; within one texel of any border, or near an open edge.
constexpr std::uint8_t near_open = 1, near_any = 2;

// The texels near borders of charts: only there can an edge of the surface be between neighbouring texels.
class NearBorders {
 public:
  NearBorders(const Mesh& mesh, const Charts& charts);

  bool is_near_open(std::int64_t texel) const { return !open_.empty() && open_[static_cast<std::size_t>(texel)]; }
  // The bits of a texel; 0 far from borders.
  std::uint8_t nearness(std::int64_t texel) const {
    if (!any_[static_cast<std::size_t>(texel)]) return 0;
    return is_near_open(texel) ? near_open | near_any : near_any;
  }

 private:
  std::vector<bool> open_, any_;  // [texel]; open_ is empty if no edge is open
};

// A block of the texture's plane.
struct Block {
  std::int64_t x = 0, y = 0, width = 0, height = 0;
};

// The border edges nearest to cells outside their chart.
class NearestBorders {
 public:
  struct Entry {
    double squared_distance = std::numeric_limits<double>::infinity();
    double overhang = 0;  // how far past the edge's ends, along it
    Index border = none;
  };

  // Finds the nearest border, within a distance, of each cell of the block for which `wanted` is not 0. Only borders
  // with the cell on their outer side are considered. At a corner, where edges are equally near, seams precede open
  // edges, then the edge that faces the cell most directly.
  void find(const Mesh& mesh, const Charts& charts, std::span<const Index> borders, Block block, double reach,
            const std::vector<std::uint8_t>& wanted);

  const Entry& operator[](std::size_t cell) const { return entries_[cell]; }

 private:
  std::vector<Entry> entries_;
};

}  // namespace beltrami::atlas
