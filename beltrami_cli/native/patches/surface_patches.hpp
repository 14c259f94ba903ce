// Collaborative patches on a triangulated surface, see groups.hpp.
//
// A patch consists of the vertices nearest to the nodes of a small square lattice in the tangent plane of a vertex,
// with a spacing of one mean edge length; nothing is interpolated. The lattice is rotated towards a direction in space
// that is the same for all. Its vertices are found along edges, so that the other side of a thin sheet is excluded.
// Nodes beyond the border of the surface have no vertex.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "instruction_set.hpp"
#include "parallel.hpp"
#include "patches/groups.hpp"

namespace beltrami::patches {

constexpr int lattice_reach = 2;
constexpr std::size_t nodes = (2 * lattice_reach + 1) * (2 * lattice_reach + 1);

// Vertices per block. About two hundred of them start groups, and the sums of a block are added to the total at once.
constexpr std::size_t block_size = 4096;

using Position = std::array<double, 3>;
using Nodes = std::array<std::int32_t, nodes>;  // vertices, -1 where there is none

// The starts of a block, and the vertices with whose patches theirs are compared.
struct Part {
  std::vector<std::int32_t> vertices;
  std::vector<std::int32_t> candidates;    // of all starts, places in `vertices`; of each, itself first
  std::vector<std::size_t> first;          // of each start, and one beyond the last
  std::vector<std::size_t> without_pilot;  // of each start: how many of them are compared then
};

// Sums of the groups of a part, with the vertices of its patches renumbered so that little memory is accessed at a time.
struct PartSums {
  std::vector<std::int32_t> members;
  std::vector<std::array<float, 2>> sums;  // of estimates and of their weights, a row of channels a member
};

// Scratch memory of one thread.
struct PartScratch {
  std::vector<std::int32_t> numbers;           // [vertex]: its number among the members, -1 for others
  std::vector<Nodes> patches;                  // of candidates: numbers of members
  std::vector<float> noisy, pilot, relative;   // of members, with mixed channels
  // Of candidates: values and sums of estimates at all nodes, and sums of weights.
  std::vector<float> noisy_rows, pilot_rows, sum_rows, weights;
  std::vector<std::uint8_t> is_chosen;
  std::vector<float> compared;  // 1 at the nodes of a row that are compared, else 0
  std::vector<std::uint64_t> keys;
  Group group{};
};

// Sums the estimates of the groups that start in a part; `patches` of all vertices.
BELTRAMI_DECLARE_VARIANTS(void sum_part(std::span<const Nodes> patches, const Part& part, const Colours& colours,
                                        bool has_pilot, PartSums& to, PartScratch& scratch))

class SurfacePatches {
 public:
  // axes: directions to which lattices are rotated; the second where the first is normal to the surface. priorities: of
  // vertices as starts of groups, the least first, so that the order of vertices does not matter. blocks: numbers,
  // ascending except -1, of the blocks of vertices whose groups are summed one after another; -1: groups that start at
  // the vertex are omitted. nullptr: blocks of `block_size` vertices. Throws Cancelled if poll returned false.
  SurfacePatches(std::span<const Position> positions, std::span<const std::array<std::int32_t, 2>> edges,
                 const std::array<Position, 2>& axes, std::span<const std::uint64_t> priorities, unsigned threads,
                 const std::int32_t* blocks = nullptr, const Poll& poll = {});

  // Colours have one row per vertex. Adds the weighted estimates of mixed channels and their weights to `sums`, with
  // `channels` columns and one row per vertex. Throws Cancelled if poll returned false.
  void collaborate(const Colours& colours, bool has_pilot, const Sums& sums, unsigned threads, const Poll& poll = {}) const;

  std::size_t size() const { return patches_.size(); }

 private:
  class VertexRings;

  void find_patches(std::span<const Position> positions, const std::array<Position, 2>& axes,
                    std::span<const std::uint64_t> priorities, std::span<VertexRings> rings, const Poll& poll);
  std::vector<std::int32_t> choose_starts(std::span<const std::uint64_t> priorities) const;
  void find_candidates(const std::vector<std::int32_t>& starts, const std::int32_t* blocks, std::span<VertexRings> rings,
                       const Poll& poll);

  std::vector<std::size_t> first_;         // of each vertex's neighbours
  std::vector<std::int32_t> neighbours_;
  std::vector<Nodes> patches_;
  std::vector<Part> parts_;
};

}  // namespace beltrami::patches
