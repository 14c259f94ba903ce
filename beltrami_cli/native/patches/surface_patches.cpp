#include "patches/surface_patches.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>
#include <utility>

#include "points/tangent_plane.hpp"

namespace beltrami::patches {
namespace {

// Vertices around one that its lattice is looked for in, more if nodes are left without one, and that its patches are
// compared with.
constexpr std::array<std::size_t, 2> enough_for_lattice{36, 50};
constexpr std::size_t enough_candidates = 200;

// In units of the lattice: how far from its node a vertex may be, and how far off the tangent plane.
constexpr double furthest = 0.8, highest = 2.0;

// Squared distances from nodes that differ by less are equal.
constexpr double alike = 1e-6;

// Vertices that are handled together, and parts between whose ends sums are added.
constexpr std::size_t chunk = 1024, starts_in_part = 256, parts_in_wave = 32;

// As in grids, see tile_patches.cpp.
constexpr float far_away = 1e9F, too_far = 1e17F;

struct Variant {
  EstimateGroup estimate_group;
  CompareRows compare_rows;
};

using points::dot;

// The axis that the rows of a lattice follow: the first, unless it is nearly normal to the surface.
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

// The number of a node, by its place from the middle.
std::size_t node_at(int row, int column) {
  return static_cast<std::size_t>((row + lattice_reach) * (2 * lattice_reach + 1) + column + lattice_reach);
}

// The rows or columns of nodes that are near enough to a place beside the lattice. Positive numbers are rounded down by
// conversion, and calls of floor and ceil would take longer than all else.
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
  // The sign of a fitted normal means nothing; up is on the side of the other axis.
  const double across = 1 / step, upwards = std::copysign(across, dot(up, axes[1 - leading]));
  const auto priority_of = [&](std::int32_t other) { return priorities[static_cast<std::size_t>(other)]; };
  std::array<double, nodes> nearest;
  nearest.fill(furthest * furthest);
  for (std::size_t k = 0; k < offsets.size(); ++k) {
    const double x = dot(offsets[k], right) * across, y = dot(offsets[k], up) * upwards;
    const double height = dot(offsets[k], plane.normal) * across;
    constexpr double beside = lattice_reach + furthest;
    if (!(std::abs(height) <= highest && std::abs(x) <= beside && std::abs(y) <= beside)) continue;
    for (int row = first_near(y); row <= last_near(y); ++row)
      for (int column = first_near(x); column <= last_near(x); ++column) {
        if (row == 0 && column == 0) continue;
        const double distance = (x - column) * (x - column) + (y - row) * (y - row);
        const std::size_t node = node_at(row, column);
        const double gain = nearest[node] - distance;
        // Of two at one distance, the choice must not depend on rounding.
        const bool earlier =
            found[node] >= 0 && std::abs(gain) <= alike && priority_of(around[k + 1]) < priority_of(found[node]);
        if (gain > (found[node] < 0 ? 0 : alike) || earlier) {
          nearest[node] = distance;
          found[node] = around[k + 1];
        }
      }
  }
  return found;
}

}  // namespace

// The vertices around one, ring by ring along edges.
class SurfacePatches::VertexRings {
 public:
  // Finds the vertices around one, itself first: whole rings, until there are `enough`.
  std::span<const std::int32_t> around(std::int32_t vertex, std::size_t enough, std::span<const std::size_t> first,
                                       std::span<const std::int32_t> neighbours) {
    seen_.resize(first.size() - 1, 0);
    ++visit_;
    found_.assign(1, vertex);
    seen_[static_cast<std::size_t>(vertex)] = visit_;
    for (std::size_t ring = 0; ring < found_.size() && found_.size() < enough;) {
      const std::size_t end = found_.size();
      for (; ring < end; ++ring) {
        const auto own = static_cast<std::size_t>(found_[ring]);
        for (std::size_t i = first[own]; i < first[own + 1] && found_.size() < most; ++i) {
          std::uint32_t& seen = seen_[static_cast<std::size_t>(neighbours[i])];
          if (seen != visit_) found_.push_back(neighbours[i]);
          seen = visit_;
        }
      }
    }
    return found_;
  }

 private:
  static constexpr std::size_t most = 512;  // beside a hub

  std::vector<std::uint32_t> seen_;
  std::vector<std::int32_t> found_;
  std::uint32_t visit_ = 0;
};

SurfacePatches::SurfacePatches(std::span<const Position> positions, std::span<const std::array<std::int32_t, 2>> edges,
                               const std::array<Position, 2>& axes, std::span<const std::uint64_t> priorities,
                               unsigned threads, const Poll& poll)
    : first_(positions.size() + 1, 0), neighbours_(2 * edges.size()), patches_(positions.size()) {
  for (const auto& edge : edges)
    for (const std::int32_t end : edge) ++first_[static_cast<std::size_t>(end) + 1];
  for (std::size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
  std::vector<std::size_t> next(first_.begin(), first_.end() - 1);
  for (const auto& [a, b] : edges) {
    neighbours_[next[static_cast<std::size_t>(a)]++] = b;
    neighbours_[next[static_cast<std::size_t>(b)]++] = a;
  }
  std::vector<VertexRings> rings(threads);
  find_patches(positions, axes, priorities, rings, poll);
  find_candidates(choose_starts(priorities), rings, poll);
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

// A vertex starts a group unless it is in the patch of one that does, other than at a corner. Isolated ones keep their
// colours.
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
        const std::int32_t beside = patches_[vertex][node_at(row, column)];
        if (beside >= 0) covered[static_cast<std::size_t>(beside)] = true;
      }
  }
  // Neighbours together, which share most of their candidates.
  std::sort(starts.begin(), starts.end());
  return starts;
}

void SurfacePatches::find_candidates(const std::vector<std::int32_t>& starts, std::span<VertexRings> rings, const Poll& poll) {
  candidates_.resize((starts.size() + starts_in_part - 1) / starts_in_part);
  const auto find = [&](std::size_t begin, std::size_t end, unsigned worker) {
    for (std::size_t part = begin; part < end; ++part) {
      Candidates& own = candidates_[part];
      own.first.push_back(0);
      for (std::size_t i = part * starts_in_part; i < std::min(starts.size(), (part + 1) * starts_in_part); ++i) {
        const auto around = rings[worker].around(starts[i], enough_candidates, first_, neighbours_);
        own.vertices.insert(own.vertices.end(), around.begin(), around.end());
        own.first.push_back(own.vertices.size());
      }
      own.vertices.shrink_to_fit();
    }
  };
  parallel_chunks(candidates_.size(), 1, static_cast<unsigned>(rings.size()), find, poll);
}

// What the groups of some starts add to: vertices under numbers of their own, so that little memory is touched at a time.
struct SurfacePatches::Part {
  std::vector<std::int32_t> members;
  std::vector<std::array<float, 2>> sums;  // of estimates and of their weights, a plane a channel

  // Adds the sums to those of the whole surface, which have a row a vertex.
  void add_to(const Sums& whole, std::size_t channels) const {
    for (std::size_t i = 0; i < members.size(); ++i)
      for (std::size_t c = 0; c < channels; ++c) {
        const std::size_t to = static_cast<std::size_t>(members[i]) * channels + c, from = c * members.size() + i;
        whole.estimates[to] += sums[from][0];
        whole.weights[to] += sums[from][1];
      }
  }
};

// Handles one part after the other; one for each thread.
class SurfacePatches::Worker {
 public:
  void run(const SurfacePatches& surface, const Colours& colours, bool has_pilot, const Candidates& candidates,
           const Variant& variant, Part& part) {
    collect(surface, candidates.vertices, part.members);
    mix(colours, part.members);
    const float* relative = colours.relative != nullptr ? relative_.data() : nullptr;
    const Channels channels{noisy_.data(),       pilot_.data(),    colours.variances,
                            colours.shrinkage,   colours.least_ratio, colours.strength,
                            relative,            colours.channels, part.members.size()};
    describe(surface, channels);
    part.sums.assign(noisy_.size(), {0, 0});
    const std::size_t size = has_pilot ? medium : few;
    for (std::size_t i = 0; i + 1 < candidates.first.size(); ++i) {
      const auto around = std::span(std::as_const(around_)).subspan(candidates.first[i], candidates.first[i + 1] - candidates.first[i]);
      const std::size_t found = choose(surface, around, channels.count, size, variant);
      place(surface, around, size, found);
      estimate(channels, has_pilot, part.sums, variant);
    }
    for (const std::int32_t member : part.members) number_[static_cast<std::size_t>(member)] = -1;
    for (const std::int32_t candidate : candidates_) rank_[static_cast<std::size_t>(candidate)] = -1;
  }

 private:
  // Numbers the candidates of all starts, and the vertices of their patches.
  void collect(const SurfacePatches& surface, std::span<const std::int32_t> all, std::vector<std::int32_t>& members) {
    number_.resize(surface.patches_.size(), -1);
    rank_.resize(surface.patches_.size(), -1);
    members.clear();
    candidates_.clear();
    around_.clear();
    for (const std::int32_t candidate : all) {
      std::int32_t& rank = rank_[static_cast<std::size_t>(candidate)];
      if (rank < 0) {
        rank = static_cast<std::int32_t>(candidates_.size());
        candidates_.push_back(candidate);
      }
      around_.push_back(rank);
    }
    for (const std::int32_t candidate : candidates_)
      for (const std::int32_t vertex : surface.patches_[static_cast<std::size_t>(candidate)]) {
        if (vertex < 0 || number_[static_cast<std::size_t>(vertex)] >= 0) continue;
        number_[static_cast<std::size_t>(vertex)] = static_cast<std::int32_t>(members.size());
        members.push_back(vertex);
      }
  }

  void mix(const Colours& colours, const std::vector<std::int32_t>& members) {
    const std::size_t n = colours.channels, count = members.size();
    noisy_.resize(n * count);
    pilot_.resize(n * count);
    relative_.resize(colours.relative != nullptr ? count : 0);
    for (std::size_t i = 0; i < relative_.size(); ++i) relative_[i] = colours.relative[members[i]];
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t row = static_cast<std::size_t>(members[i]) * n;
      for (std::size_t to = 0; to < n; ++to) {
        float noisy = 0, pilot = 0;
        for (std::size_t from = 0; from < n; ++from) {
          noisy += colours.mixing[to * n + from] * colours.noisy[row + from];
          pilot += colours.mixing[to * n + from] * colours.pilot[row + from];
        }
        noisy_[to * count + i] = noisy;
        pilot_[to * count + i] = pilot;
      }
    }
  }

  static std::size_t length_of(std::size_t channels) { return (channels * nodes + 15) / 16 * 16; }

  // Makes rows of the pilot's patches; nodes without a vertex are far from all colours.
  void describe(const SurfacePatches& surface, const Channels& channels) {
    const std::size_t length = length_of(channels.count);
    features_.assign(candidates_.size() * length, 0);
    for (std::size_t i = 0; i < candidates_.size(); ++i) {
      const Nodes& own = surface.patches_[static_cast<std::size_t>(candidates_[i])];
      for (std::size_t node = 0; node < nodes; ++node) {
        const std::int32_t vertex = own[node] < 0 ? -1 : number_[static_cast<std::size_t>(own[node])];
        for (std::size_t c = 0; c < channels.count; ++c)
          features_[i * length + c * nodes + node] =
              vertex < 0 ? far_away : channels.pilot[c * channels.stride + static_cast<std::size_t>(vertex)];
      }
    }
  }

  // Sorts the candidates that have all nodes of the first by the squared differences of the pilot, nearest first.
  std::size_t choose(const SurfacePatches& surface, std::span<const std::int32_t> around, std::size_t channels,
                     std::size_t size, const Variant& variant) {
    const std::size_t length = length_of(channels);
    const Nodes& own = surface.patches_[static_cast<std::size_t>(candidates_[static_cast<std::size_t>(around[0])])];
    mask_.assign(length, 0);
    for (std::size_t c = 0; c < channels; ++c)
      for (std::size_t node = 0; node < nodes; ++node) mask_[c * nodes + node] = own[node] < 0 ? 0.0F : 1.0F;
    distances_.resize(around.size());
    variant.compare_rows(features_.data(), length, mask_.data(), around.data(), around.size(), distances_.data());
    // Positive floats are ordered as their bits are.
    keys_.assign(1, 0);
    for (std::size_t k = 1; k < around.size(); ++k)
      if (distances_[k] < too_far) keys_.push_back(std::uint64_t{std::bit_cast<std::uint32_t>(distances_[k])} << 32 | k);
    const std::size_t found = std::min(size, keys_.size());
    const auto wanted = keys_.begin() + static_cast<std::ptrdiff_t>(found);
    if (found < keys_.size()) std::nth_element(keys_.begin(), wanted, keys_.end());
    std::sort(keys_.begin(), wanted);
    return found;
  }

  // Finds the members at the nodes that the first patch has, for the patches that were chosen.
  void place(const SurfacePatches& surface, std::span<const std::int32_t> around, std::size_t size, std::size_t found) {
    const auto patch_of = [&](std::size_t k) -> const Nodes& {
      const std::int32_t rank = around[keys_[k] & 0xFFFFFFFF];
      return surface.patches_[static_cast<std::size_t>(candidates_[static_cast<std::size_t>(rank)])];
    };
    group_.size = size;
    group_.length = short_row;
    group_.found = found;
    group_.count = 0;
    const Nodes& own = patch_of(0);
    for (std::size_t node = 0; node < nodes; ++node)
      if (own[node] >= 0) group_.used[group_.count++] = static_cast<std::uint8_t>(node);
    places_.resize(size * nodes);
    for (std::size_t k = 0; k < found; ++k) {
      const Nodes& patch = patch_of(k);
      for (std::size_t p = 0; p < group_.count; ++p)
        places_[k * nodes + p] = number_[static_cast<std::size_t>(patch[group_.used[p]])];
    }
  }

  // Adds the estimates of the group at its places.
  void estimate(const Channels& channels, bool has_pilot, std::vector<std::array<float, 2>>& sums, const Variant& variant) {
    const auto count = static_cast<float>(group_.count);
    for (auto* rows : {&group_.noisy, &group_.pilot}) rows->fill(0);  // patches before this one may have other nodes
    for (std::size_t channel = 0; channel < channels.count; ++channel) {
      const std::size_t plane = channel * channels.stride;
      const float *noisy = channels.noisy + plane, *pilot = channels.pilot + plane;
      float mean = 0;
      for (std::size_t p = 0; p < group_.count; ++p) mean += pilot[places_[p]];
      mean /= count;
      group_.shrinkage = channels.shrinkage[channel];
      group_.least_ratio = channels.least_ratio;
      group_.strength = channels.strength;
      group_.energy.fill(count * channels.variances[channel]);
      for (std::size_t k = 0; channels.relative != nullptr && k < group_.found; ++k) {
        float total = 0;
        for (std::size_t p = 0; p < group_.count; ++p) total += channels.relative[places_[k * nodes + p]];
        group_.energy[k] = total * channels.variances[channel];
      }
      each_value([&](std::size_t place, std::size_t at, std::size_t) {
        group_.noisy[at] = noisy[place] - mean;
        group_.pilot[at] = pilot[place] - mean;
      });
      variant.estimate_group(group_, has_pilot);
      each_value([&](std::size_t place, std::size_t at, std::size_t k) {
        std::array<float, 2>& own = sums[plane + place];
        own[0] += (group_.estimates[at] + mean) * group_.weights[k];
        own[1] += group_.weights[k];
      });
    }
  }

  // Calls f(place, index in the group's rows, patch) for each value of the patches.
  template <class F>
  void each_value(F f) const {
    for (std::size_t k = 0; k < group_.found; ++k)
      for (std::size_t p = 0; p < group_.count; ++p)
        f(static_cast<std::size_t>(places_[k * nodes + p]), k * short_row + group_.used[p], k);
  }

  std::vector<std::int32_t> number_, rank_, candidates_, around_, places_;
  std::vector<float> noisy_, pilot_, relative_, features_, mask_, distances_;
  std::vector<std::uint64_t> keys_;
  Group group_{};
};

void SurfacePatches::collaborate(const Colours& colours, bool has_pilot, const Sums& sums, unsigned threads,
                                 const Poll& poll) const {
  const InstructionSet set = choose_instruction_set();
  const Variant variant{BELTRAMI_VARIANT_OF(estimate_group, set), BELTRAMI_VARIANT_OF(compare_rows, set)};
  const std::size_t n = colours.channels, count = patches_.size();
  const std::size_t parts = candidates_.size();
  std::vector<Part> wave(std::min(parts, parts_in_wave));
  std::vector<Worker> workers(threads);
  for (std::size_t first = 0; first < parts; first += wave.size()) {
    const std::size_t here = std::min(wave.size(), parts - first);
    const Poll counted = poll ? Poll([&](std::size_t done) { return poll((first + done) * count / parts); }) : Poll();
    parallel_chunks(
        here, 1, threads,
        [&](std::size_t begin, std::size_t end, unsigned worker) {
          for (std::size_t i = begin; i < end; ++i)
            workers[worker].run(*this, colours, has_pilot, candidates_[first + i], variant, wave[i]);
        },
        counted);
    // In the order of the parts, so that sums do not depend on the threads.
    for (std::size_t i = 0; i < here; ++i) wave[i].add_to(sums, n);
  }
  std::vector<float> mixed(n);
  for (std::size_t vertex = 0; vertex < count; ++vertex) {
    float *estimate = sums.estimates + vertex * n, *weight = sums.weights + vertex * n;
    for (std::size_t c = 0; c < n; ++c) mixed[c] = weight[c] > 0 ? estimate[c] / weight[c] : 0;
    for (std::size_t c = 0; c < n; ++c) {
      float value = weight[c] > 0 ? 0 : colours.pilot[vertex * n + c];
      for (std::size_t from = 0; weight[c] > 0 && from < n; ++from) value += colours.unmixing[c * n + from] * mixed[from];
      estimate[c] = value;
    }
  }
}

}  // namespace beltrami::patches
