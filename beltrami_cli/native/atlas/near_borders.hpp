// The texels near which charts end: only there can an edge of the surface lie between neighbouring texels.
#pragma once

#include <cstdint>
#include <vector>

#include "atlas/charts.hpp"
#include "atlas/mesh.hpp"

namespace beltrami::atlas {

class NearBorders {
 public:
  NearBorders(const Mesh& mesh, const Charts& charts);

  // Within two texels of an open edge, or within one texel of any border.
  bool is_near_open(std::int64_t texel) const { return !open_.empty() && open_[static_cast<std::size_t>(texel)]; }
  bool is_near_any(std::int64_t texel) const { return any_[static_cast<std::size_t>(texel)]; }

 private:
  std::vector<bool> open_, any_;  // [texel]; open_ is empty if no edge is open
};

}  // namespace beltrami::atlas
