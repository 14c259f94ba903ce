// Ownership of texels by windows, and by faces in these.
#pragma once

#include <cstdint>
#include <vector>

#include "atlas/array.hpp"
#include "atlas/charts.hpp"
#include "atlas/mesh.hpp"
#include "atlas/windows.hpp"
#include "parallel.hpp"

namespace beltrami::atlas {

// The bounding box of a window's texels in the texture's plane; empty while last_x < first_x.
struct Extent {
  std::int64_t first_x = 0, first_y = 0, last_x = -1, last_y = -1;
  bool empty() const { return last_x < first_x; }
  void add(std::int64_t x, std::int64_t y);
};

struct Ownership {
  Array<Index> window;              // [texel]; none where no face covers it
  Array<Index> face;                // [texel]
  std::vector<Extent> extents;      // [window]
  std::vector<std::uint8_t> overlapping;  // [chart]: whether it covers texels that it does not own at that place
  std::int64_t covered = 0, overlapped = 0;
};

// A texel belongs to the first window, and in it to the first face, that covers its centre. Centres exactly on outer
// edges of charts are covered too, unless they are covered otherwise. Throws Cancelled if the poll asks to stop.
Ownership make_ownership(const Mesh& mesh, const Charts& charts, const Windows& windows, const Allocate& allocate,
                         const Poll& poll);

}  // namespace beltrami::atlas
