#include "triangulated/segment_march.hpp"

#include <algorithm>
#include <functional>

namespace beltrami::triangulated {

SegmentMarch::SegmentMarch(const Segments& segments, const HubLists& hubs)
    : segments_(segments), hubs_(hubs), nodes_(static_cast<std::size_t>(segments.vertex_count())) {}

std::span<const Reached> SegmentMarch::march(Index source, float radius, std::size_t max_count) {
  heap_.clear();
  waiting_.clear();
  reached_.clear();
  truncated_ = false;
  radius_ = radius;
  if (++mark_ == 0) {
    std::fill(nodes_.begin(), nodes_.end(), Node{});
    mark_ = 1;
  }
  relax(source, 0);
  while (!heap_.empty() || !waiting_.empty()) {
    if (!waiting_.empty() && (heap_.empty() || waiting_.front().key < heap_.nearest())) {
      take_hub_segment();
      continue;
    }
    const std::uint64_t key = heap_.pop();
    if (is_stale(key)) continue;
    if (reached_.size() == max_count) {
      truncated_ = true;
      break;
    }
    reached_.push_back({vertex_of(key), distance_of(key)});
    pass_on(vertex_of(key), distance_of(key));
    // One more than the kernel takes, to detect that it is truncated.
    const std::size_t wanted = max_count - reached_.size() + 1;
    if (heap_.size() / 2 <= wanted) continue;
    // Others are never taken, since distances only decrease.
    if (const auto furthest = heap_.keep_nearest(wanted, [&](std::uint64_t each) { return is_stale(each); }))
      radius_ = distance_of(*furthest);
  }
  return reached_;
}

bool SegmentMarch::is_stale(std::uint64_t key) const {
  return distance_of(key) != nodes_[static_cast<std::size_t>(vertex_of(key))].distance;
}

void SegmentMarch::relax(Index target, float distance) {
  if (!(distance <= radius_)) return;
  Node& node = nodes_[static_cast<std::size_t>(target)];
  if (node.mark == mark_ && node.distance <= distance) return;
  node = {distance, mark_};
  heap_.push(make_key(distance, target));
}

void SegmentMarch::pass_on(Index vertex, float distance) {
  const std::uint32_t* offset = segments_.offsets.data() + vertex;
  if (offset[1] - offset[0] > most_segments) {
    const auto found = std::lower_bound(hubs_.hubs.begin(), hubs_.hubs.end(), vertex);
    const auto hub = static_cast<std::uint32_t>(found - hubs_.hubs.begin());
    wait_for(hub, hubs_.offsets[hub]);
    return;
  }
  for (std::uint32_t i = offset[0]; i < offset[1]; ++i) relax(segments_.targets[i], distance + segments_.lengths[i]);
}

void SegmentMarch::wait_for(std::uint32_t hub, std::uint32_t next) {
  if (next == hubs_.offsets[hub + 1]) return;
  const std::uint32_t place = hubs_.places[next];
  const float distance = nodes_[static_cast<std::size_t>(hubs_.hubs[hub])].distance + segments_.lengths[place];
  if (!(distance <= radius_)) return;
  waiting_.push_back({make_key(distance, segments_.targets[place]), hub, next});
  std::push_heap(waiting_.begin(), waiting_.end(), std::greater<>());
}

void SegmentMarch::take_hub_segment() {
  std::pop_heap(waiting_.begin(), waiting_.end(), std::greater<>());
  const Waiting taken = waiting_.back();
  waiting_.pop_back();
  relax(vertex_of(taken.key), distance_of(taken.key));
  wait_for(taken.hub, taken.next + 1);
}

}  // namespace beltrami::triangulated
