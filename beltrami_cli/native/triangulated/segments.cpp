#include "triangulated/segments.hpp"

#include <algorithm>
#include <numeric>
#include <stdexcept>
#include <utility>

namespace beltrami::triangulated {
namespace {

Index apex(const Topology& topology, Corner corner) {
  return topology.faces[static_cast<std::size_t>(corner / 3)][static_cast<std::size_t>(corner % 3)];
}

// Calls over_edge(a, b, edge), across_edge(a, b, corner at a, corner at b), round_corner(a, b, corner) for every segment.
template <class OverEdge, class AcrossEdge, class RoundCorner>
void for_each_segment(const Topology& topology, OverEdge over_edge, AcrossEdge across_edge, RoundCorner round_corner) {
  for (std::size_t edge = 0; edge < topology.edges.size(); ++edge)
    over_edge(topology.edges[edge][0], topology.edges[edge][1], edge);
  const auto corner_count = static_cast<Corner>(topology.twins.size());
  const auto twin_of = [&](Corner corner) { return topology.twins[static_cast<std::size_t>(corner)]; };
  for (Corner corner = 0; corner < corner_count; ++corner)
    if (const Corner twin = twin_of(corner); twin > corner)
      across_edge(apex(topology, corner), apex(topology, twin), corner, twin);
  for (Corner corner = 0; corner < corner_count; ++corner) {
    const Corner face = corner - corner % 3;
    const Corner one = twin_of(face + (corner + 1) % 3), other = twin_of(face + (corner + 2) % 3);
    if (one == none || other == none) continue;
    const Index a = apex(topology, one), b = apex(topology, other);
    if (a != b) round_corner(a, b, corner);
  }
}

// The start of the list of each vertex, and the total length.
std::vector<std::uint32_t> make_offsets(const Topology& topology) {
  std::vector<std::uint32_t> offsets(static_cast<std::size_t>(topology.vertex_count) + 1, 0);
  std::uint64_t count = 0;
  const auto add = [&](Index a, Index b, auto...) {
    ++offsets[static_cast<std::size_t>(a)];
    ++offsets[static_cast<std::size_t>(b)];
    count += 2;
  };
  for_each_segment(topology, add, add, add);
  if (count >= no_place) throw std::length_error("the mesh has more segments than 32-bit numbers can count");
  std::exclusive_scan(offsets.begin(), offsets.end(), offsets.begin(), std::uint32_t{0});
  return offsets;
}

}  // namespace

TrianglePlanes make_planes(const Topology& topology) {
  TrianglePlanes planes;
  planes.count = topology.faces.size();
  planes.stride = (planes.count + 15) / 16 * 16;
  for (auto* plane : {&planes.edges, &planes.beyond_low, &planes.beyond_high}) plane->assign(3 * planes.stride, 0);
  for (Corner corner = 0; corner < static_cast<Corner>(topology.twins.size()); ++corner) {
    const std::size_t at = planes.at(corner);
    planes.edges[at] = topology.edge_facing(corner);
    const Corner twin = topology.twins[static_cast<std::size_t>(corner)];
    if (twin == none) continue;
    // Corners of faces ascend, so the last but the apex is the higher end; the edge to the lower end faces it.
    const auto& edges = topology.face_edges[static_cast<std::size_t>(twin / 3)];
    const auto apex = static_cast<std::size_t>(twin % 3);
    planes.beyond_low[at] = edges[apex == 2 ? 1 : 2];
    planes.beyond_high[at] = edges[apex == 0 ? 1 : 0];
  }
  return planes;
}

Segments make_segments(const Topology& topology, const TrianglePlanes& planes) {
  Segments segments;
  segments.offsets = make_offsets(topology);
  segments.targets.assign(segments.offsets.back() + spare_lengths, 0);
  segments.lengths.assign(segments.targets.size(), no_segment);
  segments.over_edges.resize(topology.edges.size());
  segments.across_edges.assign(3 * planes.stride, no_place);
  segments.round_corners.assign(3 * planes.stride, {no_place, no_place});
  auto cursor = segments.offsets;
  const auto list = [&](Index a, Index b) {
    const std::array places{cursor[static_cast<std::size_t>(a)]++, cursor[static_cast<std::size_t>(b)]++};
    segments.targets[places[0]] = b;
    segments.targets[places[1]] = a;
    return places;
  };
  for_each_segment(
      topology, [&](Index a, Index b, std::size_t edge) { segments.over_edges[edge] = list(a, b); },
      [&](Index a, Index b, Corner at_a, Corner at_b) {
        const auto [from_a, from_b] = list(a, b);
        segments.across_edges[planes.at(at_a)] = from_a;
        segments.across_edges[planes.at(at_b)] = from_b;
      },
      [&](Index a, Index b, Corner corner) { segments.round_corners[planes.at(corner)] = list(a, b); });
  return segments;
}

HubLists sort_hubs(const Segments& segments) {
  HubLists lists{{}, {0}, {}};
  for (Index vertex = 0; vertex < segments.vertex_count(); ++vertex) {
    const std::uint32_t* offset = segments.offsets.data() + vertex;
    if (offset[1] - offset[0] <= most_segments) continue;
    lists.hubs.push_back(vertex);
    for (std::uint32_t place = offset[0]; place < offset[1]; ++place)
      if (segments.lengths[place] < no_segment) lists.places.push_back(place);
    std::sort(lists.places.begin() + lists.offsets.back(), lists.places.end(), [&](std::uint32_t a, std::uint32_t b) {
      return std::pair(segments.lengths[a], segments.targets[a]) < std::pair(segments.lengths[b], segments.targets[b]);
    });
    lists.offsets.push_back(static_cast<std::uint32_t>(lists.places.size()));
  }
  return lists;
}

}  // namespace beltrami::triangulated
