#include "triangulated/stencils.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "parallel.hpp"
#include "triangulated/unfolding.hpp"

namespace beltrami::triangulated {
namespace {

constexpr std::size_t faces_per_chunk = 4096;
constexpr std::size_t edges_per_chunk = 16384;

// A split as it is found, before the splits are grouped by their support.
struct FoundSplit {
  Index support;
  SplitLink link;
};

struct ChunkFindings {
  std::vector<FoundSplit> splits;
  std::int64_t obtuse_corners = 0;
};

// Coefficients for the update of C by A (just accepted) with the partner `vertex` = B, from squared lengths:
// a faces A, b faces B, c faces C.
Partner make_partner(Index vertex, double squared_a, double squared_b, double squared_c) {
  if (!(squared_c > 0)) return {vertex, 0, 0, 0};
  const double k = (squared_b + squared_c - squared_a) / (2 * squared_c);
  const double squared_height = std::max(0.0, squared_b - k * k * squared_c);
  return {vertex, static_cast<float>(k), static_cast<float>(squared_height),
          static_cast<float>(squared_height / squared_c)};
}

class FaceUpdate {
 public:
  FaceUpdate(Stencils& stencils, const Topology& topology, const std::vector<double>& squared_lengths,
             ObtuseCorners obtuse)
      : stencils_(stencils), topology_(topology), squared_lengths_(squared_lengths), obtuse_(obtuse) {}

  void corner(Corner corner, ChunkFindings& found) const {
    const auto face_index = static_cast<std::size_t>(corner / 3);
    const auto& face = topology_.faces[face_index];
    const auto& edges = topology_.face_edges[face_index];
    const auto k = static_cast<std::size_t>(corner % 3);
    const std::size_t ka = (k + 1) % 3, kb = (k + 2) % 3;
    const double a = squared_lengths_[static_cast<std::size_t>(edges[ka])];
    const double b = squared_lengths_[static_cast<std::size_t>(edges[kb])];
    const double c = squared_lengths_[static_cast<std::size_t>(edges[k])];
    const auto [slot_a, slot_b] = topology_.corner_slots[static_cast<std::size_t>(corner)];
    Partner& partner_of_a = stencils_.partners[static_cast<std::size_t>(slot_a)];
    Partner& partner_of_b = stencils_.partners[static_cast<std::size_t>(slot_b)];
    if (a + b >= c) {
      partner_of_a = make_partner(face[kb], a, b, c);
      partner_of_b = make_partner(face[ka], b, a, c);
      return;
    }
    ++found.obtuse_corners;
    const auto support = obtuse_ == ObtuseCorners::unfold ? unfold(topology_, squared_lengths_, corner) : std::nullopt;
    if (!support) {
      partner_of_a = {face[kb], 0, 0, 0};
      partner_of_b = {face[ka], 0, 0, 0};
      return;
    }
    const double d = support->squared_target;
    partner_of_a = make_partner(support->vertex, d, b, support->squared_first);
    partner_of_b = make_partner(support->vertex, d, a, support->squared_second);
    found.splits.push_back({support->vertex,
                            {face[k], static_cast<float>(std::sqrt(d)),
                             {make_partner(face[ka], b, d, support->squared_first),
                              make_partner(face[kb], a, d, support->squared_second)}}});
  }

 private:
  Stencils& stencils_;
  const Topology& topology_;
  const std::vector<double>& squared_lengths_;
  ObtuseCorners obtuse_;
};

// Groups splits by their support. Chunks come in the order of faces, so the result does not depend on threads.
void group_splits(Stencils& stencils, const std::vector<ChunkFindings>& chunks) {
  std::fill(stencils.split_offsets.begin(), stencils.split_offsets.end(), 0);
  stencils.obtuse_corners = 0;
  for (const auto& chunk : chunks) {
    stencils.obtuse_corners += chunk.obtuse_corners;
    for (const auto& split : chunk.splits) ++stencils.split_offsets[static_cast<std::size_t>(split.support)];
  }
  std::exclusive_scan(stencils.split_offsets.begin(), stencils.split_offsets.end(), stencils.split_offsets.begin(), Index{0});
  stencils.splits.resize(static_cast<std::size_t>(stencils.split_offsets.back()));
  auto cursor = stencils.split_offsets;
  for (const auto& chunk : chunks)
    for (const auto& split : chunk.splits)
      stencils.splits[static_cast<std::size_t>(cursor[static_cast<std::size_t>(split.support)]++)] = split.link;
}

}  // namespace

Stencils make_stencils(Topology& topology) {
  Stencils stencils;
  stencils.link_offsets = std::move(topology.link_offsets);
  stencils.links.resize(topology.link_targets.size() + 1);
  for (std::size_t link = 0; link < topology.link_targets.size(); ++link)
    stencils.links[link] = {topology.link_targets[link], 0, topology.slot_offsets[link]};
  stencils.links.back() = {none, 0, topology.slot_offsets.back()};
  stencils.partners.resize(static_cast<std::size_t>(topology.slot_offsets.back()));
  stencils.split_offsets.assign(static_cast<std::size_t>(topology.vertex_count) + 1, 0);
  topology.link_targets = {};
  topology.slot_offsets = {};
  return stencils;
}

void update_stencils(Stencils& stencils, const Topology& topology, const std::vector<double>& squared_lengths,
                     ObtuseCorners obtuse, unsigned threads) {
  parallel_chunks(topology.edges.size(), edges_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    for (std::size_t edge = begin; edge < end; ++edge) {
      const auto length = static_cast<float>(std::sqrt(squared_lengths[edge]));
      for (const Index link : topology.edge_links[edge]) stencils.links[static_cast<std::size_t>(link)].length = length;
    }
  });
  std::vector<ChunkFindings> chunks((topology.faces.size() + faces_per_chunk - 1) / faces_per_chunk);
  const FaceUpdate update(stencils, topology, squared_lengths, obtuse);
  parallel_chunks(topology.faces.size(), faces_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    auto& found = chunks[begin / faces_per_chunk];
    for (std::size_t corner = 3 * begin; corner < 3 * end; ++corner) update.corner(static_cast<Corner>(corner), found);
  });
  group_splits(stencils, chunks);
}

}  // namespace beltrami::triangulated
