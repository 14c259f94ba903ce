#include "triangulated/fast_marching.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace beltrami::triangulated {
namespace {

// Vertices with more links are hubs: the time of a kernel that reaches one must not be proportional to its links.
constexpr Index most_links = 512;

}  // namespace

FastMarching::FastMarching(const Stencils& stencils, const Selection& selection)
    : stencils_(stencils), selection_(selection), nodes_(stencils.link_offsets.size() - 1) {}

std::span<const Reached> FastMarching::march(Index source, float radius, std::size_t max_count) {
  begin_march();
  radius_ = radius;
  remaining_ = max_count;
  bound_ = ~std::uint64_t{0};
  if (selection_.places != nullptr) centre_ = selection_.places[source];
  relax(source, 0);
  while (!heap_.empty()) {
    const std::uint64_t key = heap_.pop();
    const Index vertex = vertex_of(key);
    Node& node = nodes_[static_cast<std::size_t>(vertex)];
    if (node.mark == accepted_mark_) continue;
    if (reached_.size() == max_count) {
      truncated_ = true;
      break;
    }
    node.mark = accepted_mark_;
    reached_.push_back({vertex, node.distance});
    remaining_ = max_count - reached_.size() + 1;  // one more than the kernel takes, to detect that it is truncated
    update_from(vertex, node.distance);
  }
  return reached_;
}

// Truncates the heap to the vertices that can still be taken; further ones never are, since distances only decrease. So
// a hub does not fill it.
void FastMarching::keep_nearest() {
  const auto furthest = heap_.keep_nearest(remaining_, [&](std::uint64_t key) {
    const Node& node = nodes_[static_cast<std::size_t>(vertex_of(key))];
    return node.mark == accepted_mark_ || distance_of(key) != node.distance;
  });
  if (!furthest) return;
  bound_ = *furthest;
  radius_ = distance_of(bound_);
}

void FastMarching::begin_march() {
  heap_.clear();
  reached_.clear();
  truncated_ = false;
  if (close_mark_ >= 0xfffffffcU) {
    std::fill(nodes_.begin(), nodes_.end(), Node{});
    close_mark_ = 0;
  }
  close_mark_ += 2;
  accepted_mark_ = close_mark_ + 1;
}

void FastMarching::update_from(Index vertex, float distance) {
  const auto row = static_cast<std::size_t>(vertex);
  const Index first = stencils_.link_offsets[row], last = stencils_.link_offsets[row + 1];
  if (last - first > most_links)
    update_from_hub(vertex, distance);
  else
    for (Index link = first; link < last; ++link) update_over(link, distance);
  for (Index i = stencils_.split_offsets[row]; i < stencils_.split_offsets[row + 1]; ++i) {
    const SplitLink& split = stencils_.splits[static_cast<std::size_t>(i)];
    if (nodes_[static_cast<std::size_t>(split.target)].mark == accepted_mark_) continue;
    float best = distance + split.length;
    for (const Partner& partner : split.partners) best = through_partner(partner, distance, best);
    relax(split.target, best);
  }
}

void FastMarching::update_over(Index index, float distance) {
  const Link& link = stencils_.links[static_cast<std::size_t>(index)];
  if (nodes_[static_cast<std::size_t>(link.target)].mark == accepted_mark_) return;
  const Index last = stencils_.links[static_cast<std::size_t>(index) + 1].first_partner;
  float best = distance + link.length;
  for (Index p = link.first_partner; p < last; ++p)
    best = through_partner(stencils_.partners[static_cast<std::size_t>(p)], distance, best);
  relax(link.target, best);
}

// As update_over, for all links with accepted partners, and for the shortest of the others.
void FastMarching::update_from_hub(Index vertex, float distance) {
  const Hub& hub = hub_of(vertex);
  for (const Reached& reached : reached_) {
    auto each = std::ranges::lower_bound(hub.by_partner, reached.vertex, {}, &PartneredLink::partner);
    for (; each != hub.by_partner.end() && each->partner == reached.vertex; ++each) update_over(each->link, distance);
  }
  for (const Index index : hub.by_length) {
    const Link& link = stencils_.links[static_cast<std::size_t>(index)];
    if (distance + link.length > radius_) break;
    if (nodes_[static_cast<std::size_t>(link.target)].mark != accepted_mark_)
      relax(link.target, distance + link.length);
  }
}

const FastMarching::Hub& FastMarching::hub_of(Index vertex) {
  const auto [found, is_new] = hubs_.try_emplace(vertex);
  Hub& hub = found->second;
  if (!is_new) return hub;
  const auto row = static_cast<std::size_t>(vertex);
  for (Index index = stencils_.link_offsets[row]; index < stencils_.link_offsets[row + 1]; ++index) {
    hub.by_length.push_back(index);
    const auto at = static_cast<std::size_t>(index);
    for (Index p = stencils_.links[at].first_partner; p < stencils_.links[at + 1].first_partner; ++p)
      hub.by_partner.push_back({stencils_.partners[static_cast<std::size_t>(p)].vertex, index});
  }
  std::ranges::sort(hub.by_length, {}, [&](Index index) { return stencils_.links[static_cast<std::size_t>(index)].length; });
  std::ranges::sort(hub.by_partner, {}, &PartneredLink::partner);
  return hub;
}

float FastMarching::through_partner(const Partner& partner, float distance, float best) const {
  const Node& node = nodes_[static_cast<std::size_t>(partner.vertex)];
  if (node.mark != accepted_mark_) return best;
  const float u = node.distance - distance;
  const float s = std::sqrt(std::max(0.0F, partner.squared_height - partner.n * u * u));
  const bool from_within = partner.k * s > partner.n * u && (partner.k - 1) * s < partner.n * u;
  return from_within ? std::min(best, distance + partner.k * u + s) : best;
}

bool FastMarching::outside_window(Index vertex) const {
  const GridPlace place = selection_.places[vertex];
  return std::max(std::abs(place.row - centre_.row), std::abs(place.column - centre_.column)) >
         selection_.window_radius;
}

void FastMarching::relax(Index target, float distance) {
  const std::uint64_t key = make_key(distance, target);
  if (!(distance <= radius_) || key > bound_) return;
  if (selection_.places != nullptr && outside_window(target)) return;
  Node& node = nodes_[static_cast<std::size_t>(target)];
  if (node.mark == close_mark_ && node.distance <= distance) return;
  node = {distance, close_mark_};
  heap_.push(key);
  if (heap_.size() / 2 > remaining_) keep_nearest();
}

}  // namespace beltrami::triangulated
