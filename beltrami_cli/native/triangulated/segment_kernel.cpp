#include "triangulated/segment_kernel.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <functional>
#include <memory>
#include <span>
#include <utility>

#include "parallel.hpp"
#include "triangulated/group_sweep.hpp"

namespace beltrami::triangulated {
namespace {

constexpr std::size_t items_per_chunk = 4096;

void measure_in_space(LengthTables& tables, Rows<double> positions, const float* scales, std::size_t begin, std::size_t end) {
  for (std::size_t i = begin; i < end; ++i) {
    const auto [low, high] = tables.edges[i];
    const double *a = positions[low], *b = positions[high];
    float space = 0;
    for (std::size_t axis = 0; axis < positions.width; ++axis) {
      const auto difference = static_cast<float>(a[axis] - b[axis]);
      space += difference * difference;
    }
    tables.in_space[i] = scales == nullptr ? space : space * (scales[low] * scales[high]);
  }
}

// Size of a work item, about a tenth of a millisecond: small enough to distribute a small mesh evenly, large enough
// that distribution is free.
constexpr std::size_t groups_per_chunk = 16;

struct SegmentWorker {
  SegmentWorker(const Segments& segments) : scratch(static_cast<std::size_t>(segments.vertex_count())) {}
  GroupScratch scratch;
  std::unique_ptr<SegmentMarch> marching;  // made when a group needs it
  KernelStatistics statistics;
};

}  // namespace

SegmentLengths::SegmentLengths(Topology topology) {
  tables_.planes = make_planes(topology);
  topology.face_edges = {};
  tables_.segments = make_segments(topology, tables_.planes);
  tables_.edges = std::move(topology.edges);
  tables_.in_space.assign(tables_.edges.size() + spare_lengths, 0);
  tables_.squared.assign(tables_.edges.size() + spare_lengths, 0);
}

bool SegmentLengths::have_changed(Rows<double> positions, const float* scales) {
  const auto count = static_cast<std::size_t>(segments().vertex_count());
  const std::span now(positions.data, count * positions.width);
  const std::span scales_now(scales, scales == nullptr ? 0 : count);
  if (std::equal(now.begin(), now.end(), positions_.begin(), positions_.end()) &&
      std::equal(scales_now.begin(), scales_now.end(), scales_.begin(), scales_.end()))
    return false;
  positions_.assign(now.begin(), now.end());
  scales_.assign(scales_now.begin(), scales_now.end());
  return true;
}

bool SegmentLengths::update(Rows<double> positions, Rows<float> colours, double beta, const float* scales,
                            unsigned threads) {
  const bool changed = have_changed(positions, scales);
  const LengthSweep& sweep = BELTRAMI_VARIANT_OF(length_sweep, choose_instruction_set());
  const auto squared_beta = static_cast<float>(beta * beta);
  const std::size_t edge_count = tables_.edges.size(), face_count = tables_.planes.count;
  parallel_chunks(edge_count, items_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    if (changed) measure_in_space(tables_, positions, scales, begin, end);
    sweep.measure_edges(tables_, colours, squared_beta, begin, end);
  });
  // Edges and triangles are sorted by their vertices, so that corresponding parts of both write to the same lists.
  const std::size_t chunks = (std::max(edge_count, face_count) + items_per_chunk - 1) / items_per_chunk;
  parallel_chunks(chunks, 1, threads, [&](std::size_t chunk, std::size_t, unsigned) {
    const auto part = [&](std::size_t count, std::size_t i) { return i == chunks ? count : count / chunks * i / 16 * 16; };
    sweep.set_lengths(tables_, part(edge_count, chunk), part(edge_count, chunk + 1));
    sweep.cross_edges(tables_, part(face_count, chunk), part(face_count, chunk + 1));
  });
  return changed;
}

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
    if (!waiting_.empty() && (heap_.empty() || waiting_.front().key < heap_.front())) {
      take_hub_segment();
      continue;
    }
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
    pass_on(vertex, distance);
    // One more than the kernel takes, to detect that it is truncated.
    const std::size_t wanted = max_count - reached_.size() + 1;
    if (heap_.size() / 2 > wanted) keep_nearest(wanted);
  }
  return reached_;
}

// Truncates the heap to the nearest vertices. Others are never taken, since distances only decrease.
void SegmentMarch::keep_nearest(std::size_t count) {
  std::erase_if(heap_, [&](std::uint64_t key) {
    return key != make_key(nodes_[key & 0xffffffffU].distance, static_cast<Index>(key & 0xffffffffU));
  });
  if (heap_.size() > count) {
    std::nth_element(heap_.begin(), heap_.begin() + static_cast<std::ptrdiff_t>(count) - 1, heap_.end());
    heap_.resize(count);
    radius_ = std::bit_cast<float>(static_cast<std::uint32_t>(heap_.back() >> 32));
  }
  std::make_heap(heap_.begin(), heap_.end(), std::greater<>());
}

void SegmentMarch::relax(Index target, float distance) {
  if (!(distance <= radius_)) return;
  Node& node = nodes_[static_cast<std::size_t>(target)];
  if (node.mark == mark_ && node.distance <= distance) return;
  node = {distance, mark_};
  heap_.push_back(make_key(distance, target));
  std::push_heap(heap_.begin(), heap_.end(), std::greater<>());
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
  const float distance = std::bit_cast<float>(static_cast<std::uint32_t>(taken.key >> 32));
  relax(static_cast<Index>(taken.key & 0xffffffffU), distance);
  wait_for(taken.hub, taken.next + 1);
}

SegmentKernel::SegmentKernel(std::span<const Index> face_corners, Index vertex_count)
    : lengths_(make_topology(face_corners, vertex_count, Links::left_out)) {}

void SegmentKernel::update_metric(Rows<double> positions, Rows<float> colours, double beta, const float* scales,
                                  unsigned threads) {
  if (lengths_.update(positions, colours, beta, scales, threads) || groups_.members.empty())
    groups_ = make_groups(positions, lengths_.segments(), threads);
  hubs_ = sort_hubs(lengths_.segments());
}

KernelStatistics SegmentKernel::smooth(Rows<float> colours, const float* weights, const KernelParameters& parameters,
                                       float* smoothed, unsigned threads, const Poll& poll) {
  const SweepGroup sweep = BELTRAMI_VARIANT_OF(sweep_group, choose_instruction_set());
  const GroupJob job{&lengths_.segments(), colours, weights, parameters, smoothed};
  const auto is_wanted = [&](Index source) { return source >= parameters.first && source < parameters.last; };
  const auto useful = static_cast<unsigned>(std::clamp<std::size_t>(threads, 1, groups_.count() / groups_per_chunk + 1));
  std::vector<std::unique_ptr<SegmentWorker>> workers(useful);
  parallel_chunks(
      groups_.count(), groups_per_chunk, useful,
      [&](std::size_t begin, std::size_t end, unsigned index) {
        if (!workers[index]) workers[index] = std::make_unique<SegmentWorker>(lengths_.segments());
        SegmentWorker& worker = *workers[index];
        for (std::size_t group = begin; group < end; ++group) {
          const VertexGroup members = groups_.group(group);
          if (std::none_of(members.sources.begin(), members.sources.end(), is_wanted)) continue;
          if (const auto done = sweep(job, members, worker.scratch)) {
            worker.statistics += *done;
            continue;
          }
          if (!worker.marching) worker.marching = std::make_unique<SegmentMarch>(lengths_.segments(), hubs_);
          march_group(members.sources, colours, weights, parameters, smoothed, *worker.marching, worker.statistics);
        }
      },
      poll ? Poll([&](std::size_t done) { return poll(std::min(done * group_size, groups_.members.size())); }) : Poll());
  KernelStatistics statistics;
  for (const auto& worker : workers)
    if (worker) statistics += worker->statistics;
  return statistics;
}

void SegmentKernel::march_group(std::span<const Index> sources, Rows<float> colours, const float* weights,
                                const KernelParameters& parameters, float* smoothed, SegmentMarch& marching,
                                KernelStatistics& statistics) const {
  std::vector<double> sums(colours.width);
  for (const Index source : sources) {
    const auto samples = marching.march(source, parameters.radius, parameters.max_samples);
    average(samples, colours, weights, 1 / (4 * parameters.time_step), sums,
            smoothed + static_cast<std::size_t>(source) * colours.width);
    statistics += {static_cast<std::int64_t>(samples.size()), marching.truncated() ? 1 : 0};
  }
}

std::vector<Reached> SegmentKernel::distances(Index source, float radius, std::size_t max_count) const {
  SegmentMarch marching(lengths_.segments(), hubs_);
  const auto reached = marching.march(source, radius, max_count);
  return {reached.begin(), reached.end()};
}

}  // namespace beltrami::triangulated
