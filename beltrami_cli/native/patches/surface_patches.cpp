#include "patches/surface_patches.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "points/tangent_plane.hpp"

namespace beltrami::patches {
namespace {

// Number of vertices among which a lattice is searched, more if nodes remain without one, and with whose patches a
// patch is compared, without and with a pilot. More in the first estimate make no difference to the second.
constexpr std::array<std::size_t, 2> enough_for_lattice{36, 50};
constexpr std::size_t few_candidates = 85, enough_candidates = 200;

// Maximum distance of a vertex from its node, and from the tangent plane, in units of the lattice.
constexpr double furthest = 0.8, highest = 2.0;

// Tolerance within which squared distances from nodes are equal.
constexpr double tie = 1e-6;

// Vertices processed together, and number of parts whose sums are added at a time.
constexpr std::size_t chunk = 1024, parts_in_wave = 32;

using points::dot;

// The axis of the rows of a lattice: the first, unless it is nearly normal to the surface.
std::size_t leading_axis(const points::TangentPlane& plane, const std::array<Position, 2>& axes) {
  const double along = dot(axes[0], plane.normal);
  return along * along < 0.8 * dot(axes[0], axes[0]) ? 0 : 1;
}

Position direction_in(const points::TangentPlane& plane, const Position& axis) {
  const double height = dot(axis, plane.normal);
  Position direction;
  for (std::size_t i = 0; i < 3; ++i) direction[i] = axis[i] - height * plane.normal[i];
  const double length = std::sqrt(dot(direction, direction));
  if (!(length > 0)) return plane.first;
  for (double& component : direction) component /= length;
  return direction;
}

// The number of a node, given its offset from the middle.
std::size_t node_at(int row, int column) {
  return static_cast<std::size_t>((row + lattice_reach) * (2 * lattice_reach + 1) + column + lattice_reach);
}

// The rows or columns of nodes near a position. Conversion rounds positive numbers down; calls of floor and ceil would
// dominate the time.
constexpr int far_beside = 8;
int first_near(double place) {
  return std::max(-lattice_reach, far_beside - static_cast<int>(far_beside + furthest - place));
}
int last_near(double place) { return std::min(lattice_reach, static_cast<int>(place + furthest + far_beside) - far_beside); }

Position cross(const Position& a, const Position& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

Nodes lattice_of(std::int32_t vertex, std::span<const std::int32_t> around, std::span<const Position> positions,
                 double step, const std::array<Position, 2>& axes, std::span<const std::uint64_t> priorities,
                 std::vector<Position>& offsets) {
  offsets.clear();
  for (const std::int32_t other : around.subspan(1)) {
    Position& offset = offsets.emplace_back();
    for (std::size_t i = 0; i < 3; ++i)
      offset[i] = positions[static_cast<std::size_t>(other)][i] - positions[static_cast<std::size_t>(vertex)][i];
  }
  Nodes found;
  found.fill(-1);
  found[nodes / 2] = vertex;
  if (!(step > 0)) return found;
  const double reach = (lattice_reach + 1) * step;
  const points::TangentPlane plane = points::fit_tangent_plane(offsets, reach * reach);
  const std::size_t leading = leading_axis(plane, axes);
  const Position right = direction_in(plane, axes[leading]), up = cross(plane.normal, right);
  // The sign of a fitted normal is arbitrary; up is the side of the other axis.
  const double across = 1 / step, upwards = std::copysign(across, dot(up, axes[1 - leading]));
  const auto priority_of = [&](std::int32_t other) { return priorities[static_cast<std::size_t>(other)]; };
  std::array<double, nodes> nearest;
  nearest.fill(furthest * furthest);
  for (std::size_t k = 0; k < offsets.size(); ++k) {
    const double x = dot(offsets[k], right) * across, y = dot(offsets[k], up) * upwards;
    const double height = dot(offsets[k], plane.normal) * across;
    constexpr double widest = lattice_reach + furthest;
    if (!(std::abs(height) <= highest && std::abs(x) <= widest && std::abs(y) <= widest)) continue;
    for (int row = first_near(y); row <= last_near(y); ++row)
      for (int column = first_near(x); column <= last_near(x); ++column) {
        if (row == 0 && column == 0) continue;
        const double distance = (x - column) * (x - column) + (y - row) * (y - row);
        const std::size_t node = node_at(row, column);
        const double gain = nearest[node] - distance;
        // Between two at one distance, the choice must not depend on rounding.
        const bool earlier =
            found[node] >= 0 && std::abs(gain) <= tie && priority_of(around[k + 1]) < priority_of(found[node]);
        if (gain > (found[node] < 0 ? 0 : tie) || earlier) {
          nearest[node] = distance;
          found[node] = around[k + 1];
        }
      }
  }
  return found;
}

}  // namespace

// The vertices around a vertex, ring by ring along edges.
class SurfacePatches::VertexRings {
 public:
  // Finds the vertices around a vertex, itself first: whole rings, until there are `enough`.
  std::span<const std::int32_t> around(std::int32_t vertex, std::size_t enough, std::span<const std::size_t> first,
                                       std::span<const std::int32_t> neighbours) {
    seen_.resize(first.size() - 1, 0);
    const std::uint32_t visit = ++visit_;
    std::uint32_t* seen = seen_.data();
    std::size_t count = 1;
    found_[0] = vertex;
    seen[vertex] = visit;
    ends_.clear();
    for (std::size_t ring = 0; ring < count && count < enough;) {
      const std::size_t end = count;
      for (; ring < end; ++ring) {
        const auto from = static_cast<std::size_t>(found_[ring]);
        for (std::size_t i = first[from]; i < first[from + 1] && count < most; ++i) {
          const std::int32_t neighbour = found_[count] = neighbours[i];
          count += seen[neighbour] != visit;
          seen[neighbour] = visit;
        }
      }
      ends_.push_back(count);
    }
    return std::span(found_).first(count);
  }

  // Number of vertices in the first whole rings with `enough`: the order within a ring is arbitrary.
  std::size_t whole_rings(std::size_t enough) const {
    const auto end = std::find_if(ends_.begin(), ends_.end(), [&](std::size_t count) { return count >= enough; });
    return end != ends_.end() ? *end : ends_.empty() ? 1 : ends_.back();
  }

 private:
  static constexpr std::size_t most = 512;  // around a hub

  std::vector<std::uint32_t> seen_;
  std::array<std::int32_t, most> found_{};
  std::vector<std::size_t> ends_;  // of rings
  std::uint32_t visit_ = 0;
};

SurfacePatches::SurfacePatches(std::span<const Position> positions, std::span<const std::array<std::int32_t, 2>> edges,
                               const std::array<Position, 2>& axes, std::span<const std::uint64_t> priorities,
                               unsigned threads, const std::int32_t* blocks, const Poll& poll)
    : first_(positions.size() + 1, 0), neighbours_(2 * edges.size()), patches_(positions.size()) {
  for (const auto& edge : edges)
    for (const std::int32_t end : edge) ++first_[static_cast<std::size_t>(end) + 1];
  for (std::size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
  std::vector<std::size_t> next(first_.begin(), first_.end() - 1);
  for (const auto& [a, b] : edges) {
    neighbours_[next[static_cast<std::size_t>(a)]++] = b;
    neighbours_[next[static_cast<std::size_t>(b)]++] = a;
  }
  std::vector<VertexRings> rings(std::max(1U, threads));
  find_patches(positions, axes, priorities, rings, poll);
  std::vector<std::int32_t> starts = choose_starts(priorities);
  if (blocks != nullptr) std::erase_if(starts, [&](std::int32_t start) { return blocks[start] < 0; });
  find_candidates(starts, blocks, rings, poll);
}

void SurfacePatches::find_patches(std::span<const Position> positions, const std::array<Position, 2>& axes,
                                  std::span<const std::uint64_t> priorities, std::span<VertexRings> rings,
                                  const Poll& poll) {
  std::vector<std::vector<Position>> offsets(rings.size());
  const auto find = [&](std::size_t begin, std::size_t end, unsigned worker) {
    for (std::size_t vertex = begin; vertex < end; ++vertex) {
      double total = 0;
      for (std::size_t i = first_[vertex]; i < first_[vertex + 1]; ++i) {
        Position edge;
        for (std::size_t axis = 0; axis < 3; ++axis)
          edge[axis] = positions[static_cast<std::size_t>(neighbours_[i])][axis] - positions[vertex][axis];
        total += std::sqrt(dot(edge, edge));
      }
      const auto degree = static_cast<double>(first_[vertex + 1] - first_[vertex]);
      const double step = degree > 0 ? total / degree : 0;
      for (const std::size_t enough : enough_for_lattice) {
        const auto around = rings[worker].around(static_cast<std::int32_t>(vertex), enough, first_, neighbours_);
        patches_[vertex] =
            lattice_of(static_cast<std::int32_t>(vertex), around, positions, step, axes, priorities, offsets[worker]);
        if (std::find(patches_[vertex].begin(), patches_[vertex].end(), -1) == patches_[vertex].end()) break;
      }
    }
  };
  parallel_chunks(patches_.size(), chunk, static_cast<unsigned>(rings.size()), find, poll);
}

// A vertex starts a group unless it is in the patch of another start, other than at a corner. Isolated vertices keep
// their colours.
std::vector<std::int32_t> SurfacePatches::choose_starts(std::span<const std::uint64_t> priorities) const {
  std::vector<std::int32_t> starts;
  std::vector<std::int32_t> order(patches_.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
    return std::pair(priorities[static_cast<std::size_t>(a)], a) < std::pair(priorities[static_cast<std::size_t>(b)], b);
  });
  std::vector<bool> covered(patches_.size(), false);
  for (const std::int32_t start : order) {
    const auto vertex = static_cast<std::size_t>(start);
    if (covered[vertex] || first_[vertex] == first_[vertex + 1]) continue;
    starts.push_back(start);
    for (int row = -lattice_reach; row <= lattice_reach; ++row)
      for (int column = -lattice_reach; column <= lattice_reach; ++column) {
        if (std::abs(row) == lattice_reach && std::abs(column) == lattice_reach) continue;
        const std::int32_t neighbour = patches_[vertex][node_at(row, column)];
        if (neighbour >= 0) covered[static_cast<std::size_t>(neighbour)] = true;
      }
  }
  // Neighbours are processed together, since they share most candidates.
  std::sort(starts.begin(), starts.end());
  return starts;
}

void SurfacePatches::find_candidates(const std::vector<std::int32_t>& starts, const std::int32_t* blocks,
                                     std::span<VertexRings> rings, const Poll& poll) {
  const auto block_of = [&](std::int32_t vertex) {
    return blocks != nullptr ? blocks[vertex] : vertex / static_cast<std::int32_t>(block_size);
  };
  std::vector<std::size_t> ends;  // of the starts of each part
  for (std::size_t i = 0; i < starts.size(); ++i)
    if (i + 1 == starts.size() || block_of(starts[i]) != block_of(starts[i + 1])) ends.push_back(i + 1);
  parts_.resize(ends.size());
  std::vector<std::vector<std::int32_t>> ranks(rings.size());
  const auto find = [&](std::size_t begin, std::size_t end, unsigned worker) {
    std::vector<std::int32_t>& rank = ranks[worker];
    rank.resize(patches_.size(), -1);
    for (std::size_t number = begin; number < end; ++number) {
      Part& part = parts_[number];
      const std::size_t first = number == 0 ? 0 : ends[number - 1], last = ends[number];
      part.first.push_back(0);
      for (std::size_t i = first; i < last; ++i) {
        for (const std::int32_t vertex : rings[worker].around(starts[i], enough_candidates, first_, neighbours_)) {
          std::int32_t& place = rank[static_cast<std::size_t>(vertex)];
          if (place < 0) {
            place = static_cast<std::int32_t>(part.vertices.size());
            part.vertices.push_back(vertex);
          }
          part.candidates.push_back(place);
        }
        part.without_pilot.push_back(rings[worker].whole_rings(few_candidates));
        part.first.push_back(part.candidates.size());
      }
      for (const std::int32_t vertex : part.vertices) rank[static_cast<std::size_t>(vertex)] = -1;
      part.vertices.shrink_to_fit();
      part.candidates.shrink_to_fit();
    }
  };
  parallel_chunks(parts_.size(), 1, static_cast<unsigned>(rings.size()), find, poll);
}

void SurfacePatches::collaborate(const Colours& colours, bool has_pilot, const Sums& sums, unsigned threads,
                                 const Poll& poll) const {
  const auto sum_part_of = BELTRAMI_VARIANT_OF(sum_part, choose_instruction_set());
  const std::size_t n = colours.channels, count = patches_.size(), parts = parts_.size();
  std::vector<PartSums> wave(std::min(parts, parts_in_wave));
  std::vector<PartScratch> scratch(std::max(1U, threads));
  for (std::size_t first = 0; first < parts; first += wave.size()) {
    const std::size_t here = std::min(wave.size(), parts - first);
    parallel_chunks(
        here, 1, threads,
        [&](std::size_t begin, std::size_t end, unsigned worker) {
          for (std::size_t i = begin; i < end; ++i)
            sum_part_of(patches_, parts_[first + i], colours, has_pilot, wave[i], scratch[worker]);
        },
        poll ? Poll([&](std::size_t done) { return poll((first + done) * count / parts); }) : Poll());
    // In the order of the parts, so that sums do not depend on the threads.
    for (std::size_t part = 0; part < here; ++part)
      for (std::size_t i = 0; i < wave[part].members.size(); ++i)
        for (std::size_t c = 0; c < n; ++c) {
          const std::size_t to = static_cast<std::size_t>(wave[part].members[i]) * n + c;
          const auto [estimate, weight] = wave[part].sums[i * n + c];
          sums.estimates[to] += estimate;
          sums.weights[to] += weight;
        }
  }
}

}  // namespace beltrami::patches
