// The texels near which charts end: only there can an edge of the surface lie between neighbouring texels.
#pragma once

#include <cstdint>
#include <vector>

#include "atlas/charts.hpp"
#include "atlas/mesh.hpp"

namespace beltrami::atlas {

// Bits of a texel: it is within two texels of an open edge; within one texel of any border, or near an open edge.
constexpr std::uint8_t near_open = 1, near_any = 2;

class NearBorders {
 public:
  NearBorders(const Mesh& mesh, const Charts& charts);

  bool is_near_open(std::int64_t texel) const { return !open_.empty() && open_[static_cast<std::size_t>(texel)]; }
  // The bits of a texel; 0 far from where charts end.
  std::uint8_t nearness(std::int64_t texel) const {
    if (!any_[static_cast<std::size_t>(texel)]) return 0;
    return is_near_open(texel) ? near_open | near_any : near_any;
  }

 private:
  std::vector<bool> open_, any_;  // [texel]; open_ is empty if no edge is open
};

}  // namespace beltrami::atlas
