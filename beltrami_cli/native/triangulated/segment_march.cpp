#include "triangulated/segment_march.hpp"

#include <algorithm>
#include <bit>
#include <functional>

namespace beltrami::triangulated {

SegmentMarch::SegmentMarch(const Segments& segments)
    : segments_(segments), nodes_(static_cast<std::size_t>(segments.vertex_count())) {}

std::span<const Reached> SegmentMarch::march(std::span<const Index> sources, float radius, std::size_t max_count) {
  heap_.clear();
  reached_.clear();
  truncated_ = false;
  radius_ = radius;
  if (++mark_ == 0) {
    std::fill(nodes_.begin(), nodes_.end(), Node{});
    mark_ = 1;
  }
  // A single source comes first, whatever else lies at distance 0.
  for (const Index source : sources) relax(source, 0);
  while (!heap_.empty()) {
    std::pop_heap(heap_.begin(), heap_.end(), std::greater<>());
    const std::uint64_t key = heap_.back();
    heap_.pop_back();
    const auto vertex = static_cast<Index>(key & 0xffffffffU);
    const float distance = nodes_[static_cast<std::size_t>(vertex)].distance;
    // A vertex is pushed again each time that its distance falls; all but its first pop are stale.
    if (std::bit_cast<std::uint32_t>(distance) != static_cast<std::uint32_t>(key >> 32)) continue;
    if (reached_.size() == max_count) {
      truncated_ = true;
      break;
    }
    reached_.push_back({vertex, distance});
    const auto row = static_cast<std::size_t>(vertex);
    for (std::uint32_t i = segments_.offsets[row]; i < segments_.offsets[row + 1]; ++i)
      relax(segments_.targets[i], distance + segments_.lengths[i]);
  }
  return reached_;
}

void SegmentMarch::relax(Index target, float distance) {
  if (!(distance <= radius_)) return;
  Node& node = nodes_[static_cast<std::size_t>(target)];
  if (node.mark == mark_ && node.distance <= distance) return;
  node = {distance, mark_};
  heap_.push_back(std::uint64_t{std::bit_cast<std::uint32_t>(distance)} << 32 | static_cast<std::uint32_t>(target));
  std::push_heap(heap_.begin(), heap_.end(), std::greater<>());
}

}  // namespace beltrami::triangulated
