// Shortest paths along segments from one source, by Dijkstra's algorithm.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "triangulated/march_heap.hpp"
#include "triangulated/segments.hpp"

namespace beltrami::triangulated {

// At hubs, segments are taken one at a time from the shortest on, so that k samples take O(k log k) for any valence. The
// scratch memory, 8 bytes per vertex, is reused between marches.
class SegmentMarch {
 public:
  SegmentMarch(const Segments& segments, const HubLists& hubs);

  // Vertices within `radius` of the source in order of distance, the source first; at most `max_count`.
  // Valid until the next call.
  std::span<const Reached> march(Index source, float radius, std::size_t max_count);

  // Whether max_count ended the last march while vertices within the radius were still queued.
  bool truncated() const { return truncated_; }

 private:
  struct Node {
    float distance = 0;
    std::uint32_t mark = 0;  // of the march that found the distance
  };

  // The next segment of a hub whose list is being processed; its key is that of the vertex at its other end.
  struct Waiting {
    std::uint64_t key;
    std::uint32_t hub, next;  // the number of the hub, and the place in the lists of hubs
    bool operator>(const Waiting& other) const { return key > other.key; }
  };

  void relax(Index target, float distance);
  void pass_on(Index vertex, float distance);
  void take_hub_segment();
  bool is_stale(std::uint64_t key) const;
  void wait_for(std::uint32_t hub, std::uint32_t next);

  const Segments& segments_;
  const HubLists& hubs_;
  std::vector<Node> nodes_;
  MarchHeap heap_;
  std::vector<Waiting> waiting_;  // a heap, too
  std::vector<Reached> reached_;
  std::uint32_t mark_ = 0;
  float radius_ = 0;  // limit of the distances that are found
  bool truncated_ = false;
};

}  // namespace beltrami::triangulated
