#include "triangulated/segment_kernel.hpp"

#include <algorithm>
#include <memory>
#include <span>

#include "parallel.hpp"
#include "triangulated/group_sweep.hpp"

namespace beltrami::triangulated {
namespace {

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
  const auto sweep = BELTRAMI_VARIANT_OF(sweep_group, choose_instruction_set());
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
