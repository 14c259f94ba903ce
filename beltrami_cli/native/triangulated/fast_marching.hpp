// Geodesic distances from one vertex by fast marching on a triangulated manifold.
//
// R. Kimmel, J. Sethian, "Computing geodesic paths on manifolds", PNAS 95 (1998): solves |grad phi| = 1,
// phi(source) = 0 (eq. (10) of the Beltrami kernel paper) by accepting vertices in order of distance.
#pragma once

#include <cstdint>
#include <span>
#include <unordered_map>
#include <vector>

#include "triangulated/march_heap.hpp"
#include "triangulated/stencils.hpp"

namespace beltrami::triangulated {

// Position of a vertex on a grid, if any.
struct GridPlace {
  std::int32_t row, column;
};

// Source and limits of a march besides the radius; a general mesh has no window.
struct Selection {
  const std::uint8_t* wanted = nullptr;  // [vertex]: whether its kernel is wanted; nullptr: all
  const GridPlace* places = nullptr;     // [vertex]: for the window; nullptr: no window
  std::int32_t window_radius = 0;        // in rows and columns
};

// Marches from many sources, one after another; the scratch memory, 8 bytes per vertex, is reused.
class FastMarching {
 public:
  explicit FastMarching(const Stencils& stencils, const Selection& selection = {});

  // Vertices within `radius` of the source in order of distance, the source first; at most `max_count`.
  // Valid until the next call.
  std::span<const Reached> march(Index source, float radius, std::size_t max_count);

  // Whether max_count ended the last march while vertices within the radius were still queued.
  bool truncated() const { return truncated_; }

 private:
  // A vertex is Accepted, Close or Far by its mark: equal to accepted_mark_, to close_mark_, or older.
  struct Node {
    float distance = 0;
    std::uint32_t mark = 0;
  };

  // Links of a hub.
  struct PartneredLink {
    Index partner, link;
  };
  struct Hub {
    std::vector<Index> by_length;
    std::vector<PartneredLink> by_partner;
  };

  void begin_march();
  void relax(Index target, float distance);
  void update_from(Index vertex, float distance);
  void update_over(Index index, float distance);
  void update_from_hub(Index vertex, float distance);
  const Hub& hub_of(Index vertex);
  float through_partner(const Partner& partner, float distance, float best) const;
  void keep_nearest();

  bool outside_window(Index vertex) const;

  const Stencils& stencils_;
  Selection selection_;
  GridPlace centre_{};
  std::vector<Node> nodes_;
  MarchHeap heap_;
  std::vector<Reached> reached_;
  std::unordered_map<Index, Hub> hubs_;  // as far as they were reached
  std::uint32_t close_mark_ = 0, accepted_mark_ = 0;
  float radius_ = 0;         // limit of the distances that are found
  std::uint64_t bound_ = 0;  // limit of the keys in the heap
  std::size_t remaining_ = 0;  // how many vertices can still be taken, and one more
  bool truncated_ = false;
};

}  // namespace beltrami::triangulated
