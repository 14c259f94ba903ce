#include "triangulated/segments.hpp"

#include <limits>
#include <numeric>
#include <stdexcept>

namespace beltrami::triangulated {
namespace {

Index apex(const Topology& topology, Corner corner) {
  return topology.faces[static_cast<std::size_t>(corner / 3)][static_cast<std::size_t>(corner % 3)];
}

// Calls visit(a, b, id) for every segment, in the order of ids.
template <class Visit>
void for_each_segment(const Topology& topology, Visit visit) {
  const auto edge_count = static_cast<std::uint32_t>(topology.edges.size());
  for (std::uint32_t edge = 0; edge < edge_count; ++edge) visit(topology.edges[edge][0], topology.edges[edge][1], edge);
  const auto corner_count = static_cast<Corner>(topology.twins.size());
  const auto twin_of = [&](Corner corner) { return topology.twins[static_cast<std::size_t>(corner)]; };
  for (Corner corner = 0; corner < corner_count; ++corner) {
    if (twin_of(corner) <= corner) continue;
    const Index edge = topology.face_edges[static_cast<std::size_t>(corner / 3)][static_cast<std::size_t>(corner % 3)];
    visit(apex(topology, corner), apex(topology, twin_of(corner)), edge_count + static_cast<std::uint32_t>(edge));
  }
  for (Corner corner = 0; corner < corner_count; ++corner) {
    const Corner face = corner - corner % 3;
    const Corner one = twin_of(face + (corner + 1) % 3), other = twin_of(face + (corner + 2) % 3);
    if (one == none || other == none) continue;
    const Index a = apex(topology, one), b = apex(topology, other);
    if (a != b) visit(a, b, 2 * edge_count + static_cast<std::uint32_t>(corner));
  }
}

}  // namespace

Segments make_segments(const Topology& topology) {
  Segments segments;
  segments.offsets.assign(static_cast<std::size_t>(topology.vertex_count) + 1, 0);
  std::uint64_t count = 0;
  for_each_segment(topology, [&](Index a, Index b, std::uint32_t) {
    ++segments.offsets[static_cast<std::size_t>(a)];
    ++segments.offsets[static_cast<std::size_t>(b)];
    count += 2;
  });
  if (count >= std::numeric_limits<std::uint32_t>::max())
    throw std::length_error("the mesh has more segments than 32-bit numbers can count");
  std::exclusive_scan(segments.offsets.begin(), segments.offsets.end(), segments.offsets.begin(), std::uint32_t{0});
  const auto spare = static_cast<std::uint32_t>(count);
  segments.targets.resize(count);
  segments.lengths.assign(count + spare_lengths, no_segment);
  segments.places.assign(2 * topology.edges.size() + topology.twins.size(), {spare, spare});
  auto cursor = segments.offsets;
  for_each_segment(topology, [&](Index a, Index b, std::uint32_t id) {
    const std::uint32_t from_a = cursor[static_cast<std::size_t>(a)]++, from_b = cursor[static_cast<std::size_t>(b)]++;
    segments.targets[from_a] = b;
    segments.targets[from_b] = a;
    segments.places[id] = {from_a, from_b};
  });
  return segments;
}

}  // namespace beltrami::triangulated
