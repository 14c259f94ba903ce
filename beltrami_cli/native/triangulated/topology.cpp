#include "triangulated/topology.hpp"

#include <algorithm>
#include <limits>
#include <numeric>
#include <stdexcept>

namespace beltrami::triangulated {
namespace {

using Pair = std::array<Index, 2>;

// Exclusive prefix sum in place: counts become offsets, with the total at the end.
void counts_to_offsets(std::vector<Index>& counts) {
  std::exclusive_scan(counts.begin(), counts.end(), counts.begin(), Index{0});
}

// Sorts the rows by their first entry (a counting sort, as vertices are many and rows per vertex few), then
// the rows of each vertex by the rest, and drops repeated rows.
template <std::size_t N>
void sort_unique(std::vector<std::array<Index, N>>& rows, Index vertex_count) {
  std::vector<Index> offsets(static_cast<std::size_t>(vertex_count) + 1, 0);
  for (const auto& row : rows) ++offsets[static_cast<std::size_t>(row[0])];
  counts_to_offsets(offsets);
  std::vector<std::array<Index, N>> sorted(rows.size());
  auto cursor = offsets;
  for (const auto& row : rows) sorted[static_cast<std::size_t>(cursor[static_cast<std::size_t>(row[0])]++)] = row;
  for (std::size_t v = 0; v + 1 < offsets.size(); ++v)
    std::sort(sorted.begin() + offsets[v], sorted.begin() + offsets[v + 1]);
  sorted.erase(std::unique(sorted.begin(), sorted.end()), sorted.end());
  rows = std::move(sorted);
}

// Splits the input into proper triangles and the edges of triangles that repeat a vertex.
void collect_faces(std::span<const Index> corners, Index vertex_count, std::vector<std::array<Index, 3>>& faces,
                   std::vector<Pair>& edges) {
  faces.reserve(corners.size() / 3);
  for (std::size_t i = 0; i + 2 < corners.size(); i += 3) {
    std::array<Index, 3> face{corners[i], corners[i + 1], corners[i + 2]};
    std::sort(face.begin(), face.end());
    if (face[0] < 0 || face[2] >= vertex_count) throw std::invalid_argument("a face refers to a vertex that is not there");
    if (face[0] != face[1] && face[1] != face[2]) {
      faces.push_back(face);
    } else if (face[0] != face[2]) {
      edges.push_back({face[0], face[2]});
    }
  }
}

void collect_edges(Topology& topology, std::vector<Pair> edges) {
  edges.reserve(edges.size() + 3 * topology.faces.size());
  for (const auto& [a, b, c] : topology.faces) {
    edges.push_back({a, b});
    edges.push_back({a, c});
    edges.push_back({b, c});
  }
  sort_unique(edges, topology.vertex_count);
  edges.shrink_to_fit();
  topology.edges = std::move(edges);
}

void find_face_edges(Topology& topology) {
  std::vector<Index> first(static_cast<std::size_t>(topology.vertex_count) + 1, 0);
  for (const auto& edge : topology.edges) ++first[static_cast<std::size_t>(edge[0])];
  counts_to_offsets(first);
  const auto find = [&](Index low, Index high) {
    const auto begin = topology.edges.begin() + first[static_cast<std::size_t>(low)];
    const auto end = topology.edges.begin() + first[static_cast<std::size_t>(low) + 1];
    return static_cast<Index>(std::lower_bound(begin, end, Pair{low, high}) - topology.edges.begin());
  };
  topology.face_edges.reserve(topology.faces.size());
  for (const auto& [a, b, c] : topology.faces) topology.face_edges.push_back({find(b, c), find(a, c), find(a, b)});
}

// Pairs the two corners that face an edge; edges with one or with more than two faces stay unpaired. Returns
// the number of faces on each edge.
std::vector<Index> pair_corners(Topology& topology) {
  std::vector<Index> face_count(topology.edges.size(), 0);
  std::vector<Corner> first(topology.edges.size(), none);
  topology.twins.assign(3 * topology.faces.size(), none);
  for (Corner corner = 0; corner < static_cast<Corner>(topology.twins.size()); ++corner) {
    const auto edge = static_cast<std::size_t>(topology.edge_facing(corner));
    const Index earlier = face_count[edge]++;
    if (earlier == 0) {
      first[edge] = corner;
    } else if (earlier == 1) {
      topology.twins[static_cast<std::size_t>(corner)] = first[edge];
      topology.twins[static_cast<std::size_t>(first[edge])] = corner;
    } else if (const Corner partner = topology.twins[static_cast<std::size_t>(first[edge])]; partner != none) {
      topology.twins[static_cast<std::size_t>(first[edge])] = none;
      topology.twins[static_cast<std::size_t>(partner)] = none;
    }
  }
  return face_count;
}

void make_links(Topology& topology) {
  auto& offsets = topology.link_offsets;
  offsets.assign(static_cast<std::size_t>(topology.vertex_count) + 1, 0);
  for (const auto& edge : topology.edges)
    for (const Index vertex : edge) ++offsets[static_cast<std::size_t>(vertex)];
  counts_to_offsets(offsets);
  auto cursor = offsets;
  topology.link_targets.resize(2 * topology.edges.size());
  topology.edge_links.reserve(topology.edges.size());
  for (const auto& [low, high] : topology.edges) {
    const Index forward = cursor[static_cast<std::size_t>(low)]++;
    const Index backward = cursor[static_cast<std::size_t>(high)]++;
    topology.link_targets[static_cast<std::size_t>(forward)] = high;
    topology.link_targets[static_cast<std::size_t>(backward)] = low;
    topology.edge_links.push_back({forward, backward});
  }
}

void make_slots(Topology& topology, const std::vector<Index>& face_count) {
  auto& offsets = topology.slot_offsets;
  offsets.assign(topology.link_targets.size() + 1, 0);
  for (std::size_t edge = 0; edge < topology.edges.size(); ++edge)
    for (const Index link : topology.edge_links[edge]) offsets[static_cast<std::size_t>(link)] = face_count[edge];
  counts_to_offsets(offsets);
  auto cursor = offsets;
  topology.corner_slots.resize(3 * topology.faces.size());
  for (std::size_t corner = 0; corner < topology.corner_slots.size(); ++corner) {
    const auto& face = topology.faces[corner / 3];
    const auto& face_edges = topology.face_edges[corner / 3];
    const std::size_t k = corner % 3;
    for (std::size_t side = 0; side < 2; ++side) {
      const std::size_t origin = (k + 1 + side) % 3;
      const auto edge = static_cast<std::size_t>(face_edges[3 - k - origin]);
      const Index link = topology.edge_links[edge][face[origin] < face[k] ? 0 : 1];
      topology.corner_slots[corner][side] = cursor[static_cast<std::size_t>(link)]++;
    }
  }
}

}  // namespace

Topology make_topology(std::span<const Index> face_corners, Index vertex_count, Links links) {
  // Each triangle makes six slots, and a slot must have an index.
  if (face_corners.size() / 3 > static_cast<std::size_t>(std::numeric_limits<Index>::max()) / 6)
    throw std::length_error("the mesh has more triangles than 32-bit indices can count");
  Topology topology;
  topology.vertex_count = vertex_count;
  std::vector<Pair> edges;
  collect_faces(face_corners, vertex_count, topology.faces, edges);
  sort_unique(topology.faces, vertex_count);
  collect_edges(topology, std::move(edges));
  find_face_edges(topology);
  const auto face_count = pair_corners(topology);
  if (links == Links::left_out) return topology;
  make_links(topology);
  make_slots(topology, face_count);
  return topology;
}

}  // namespace beltrami::triangulated
