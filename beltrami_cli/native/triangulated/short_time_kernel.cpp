#include "triangulated/short_time_kernel.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace beltrami::triangulated {
namespace {

// Size of a work item, about a millisecond: small enough to distribute evenly, large enough that distribution is free.
constexpr std::size_t sources_per_chunk = 512;

struct MarchWorker {
  MarchWorker(const Stencils& stencils, const Selection& selection, std::size_t channels)
      : marching(stencils, selection), sums(channels) {}
  FastMarching marching;
  std::vector<double> sums;
  KernelStatistics statistics;
};

}  // namespace

void average(std::span<const Reached> samples, Rows<float> colours, const float* weights, float quarter_inverse_t,
             std::vector<double>& sums, float* smoothed) {
  const float* centre = colours[samples.front().vertex];
  std::fill(sums.begin(), sums.end(), 0.0);
  double total = 0;
  for (const auto& [vertex, distance] : samples) {
    float kernel = std::exp(-distance * distance * quarter_inverse_t);
    if (weights != nullptr) kernel *= weights[vertex];
    const float* colour = colours[vertex];
    total += static_cast<double>(kernel);
    for (std::size_t channel = 0; channel < sums.size(); ++channel)
      sums[channel] += static_cast<double>(kernel * (colour[channel] - centre[channel]));
  }
  for (std::size_t channel = 0; channel < sums.size(); ++channel) {
    const double change = total > 0 ? sums[channel] / total : 0;
    smoothed[channel] = static_cast<float>(static_cast<double>(centre[channel]) + change);
  }
}

KernelStatistics smooth(const Stencils& stencils, Rows<float> colours, const float* weights,
                        const KernelParameters& parameters, float* smoothed, unsigned threads, const Poll& poll,
                        const Selection& selection) {
  const std::size_t vertex_count = stencils.link_offsets.size() - 1;
  const float quarter_inverse_t = 1 / (4 * parameters.time_step);
  const auto useful = std::clamp<std::size_t>(threads, 1, vertex_count / sources_per_chunk + 1);
  std::vector<MarchWorker> workers(useful, MarchWorker(stencils, selection, colours.width));
  parallel_chunks(
      vertex_count, sources_per_chunk, static_cast<unsigned>(useful),
      [&](std::size_t begin, std::size_t end, unsigned index) {
        MarchWorker& worker = workers[index];
        const auto first = static_cast<std::size_t>(parameters.first), last = static_cast<std::size_t>(parameters.last);
        for (std::size_t source = std::max(begin, first); source < std::min(end, last); ++source) {
          if (selection.wanted != nullptr && !selection.wanted[source]) {
            const float* colour = colours[static_cast<Index>(source)];
            std::copy(colour, colour + colours.width, smoothed + source * colours.width);
            continue;
          }
          const auto samples =
              worker.marching.march(static_cast<Index>(source), parameters.radius, parameters.max_samples);
          average(samples, colours, weights, quarter_inverse_t, worker.sums, smoothed + source * colours.width);
          worker.statistics += {static_cast<std::int64_t>(samples.size()), worker.marching.truncated() ? 1 : 0};
        }
      },
      poll);
  KernelStatistics statistics;
  for (const auto& worker : workers) statistics += worker.statistics;
  return statistics;
}

}  // namespace beltrami::triangulated
