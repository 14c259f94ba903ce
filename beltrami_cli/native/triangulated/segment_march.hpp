// Shortest paths along segments, by Dijkstra's algorithm: one source at a time, or from several at once.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "triangulated/fast_marching.hpp"
#include "triangulated/segments.hpp"

namespace beltrami::triangulated {

// The scratch memory, 8 bytes a vertex, is reused between marches.
class SegmentMarch {
 public:
  explicit SegmentMarch(const Segments& segments);

  // Vertices within `radius` of the nearest source in order of distance, the sources first; at most `max_count`.
  // Valid until the next call.
  std::span<const Reached> march(std::span<const Index> sources, float radius, std::size_t max_count);

  // Whether the last march was ended by max_count while vertices within the radius were still waiting.
  bool truncated() const { return truncated_; }

 private:
  struct Node {
    float distance = 0;
    std::uint32_t mark = 0;  // of the march that found the distance
  };

  void relax(Index target, float distance);

  const Segments& segments_;
  std::vector<Node> nodes_;
  std::vector<std::uint64_t> heap_;  // distance bits in the high half, vertex in the low half
  std::vector<Reached> reached_;
  std::uint32_t mark_ = 0;
  float radius_ = 0;
  bool truncated_ = false;
};

}  // namespace beltrami::triangulated
