// The kernels of one group, side by side in the lanes; compiled once for each instruction set from the same source.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "triangulated/metric.hpp"
#include "triangulated/segments.hpp"
#include "triangulated/short_time_kernel.hpp"

namespace beltrami::triangulated {

struct GroupJob {
  const Segments* segments;
  Rows<float> colours;
  const float* weights;  // w_q of every vertex, or nullptr for 1
  KernelParameters parameters;
  float* smoothed;
};

// Scratch memory of one thread, grown on first use and kept.
struct GroupScratch {
  // A segment within the region.
  struct Step {
    std::uint32_t place;  // of its target
    float length;
  };
  struct Steps {
    std::uint32_t begin, end;
  };
  explicit GroupScratch(std::size_t vertex_count) : place(vertex_count, 0) {}
  std::vector<std::uint16_t> place;  // [vertex]: 1 + its place in the region, 0 outside
  std::vector<float> lanes;          // 16 a vertex of the region: distances, later kernel values
  std::vector<std::uint32_t> changed;
  std::vector<Steps> steps_of;
  std::vector<Step> steps;
  std::vector<std::uint32_t> held;  // the places that a kernel holds
};

// Writes the smoothed colours of up to 16 sources, all in the region, which has at most 65534 vertices.
using SweepGroup = KernelStatistics (*)(const GroupJob& job, std::span<const Index> sources,
                                        std::span<const Index> region, GroupScratch& scratch);

namespace baseline {
KernelStatistics sweep_group(const GroupJob& job, std::span<const Index> sources, std::span<const Index> region,
                             GroupScratch& scratch);
}
#ifdef BELTRAMI_X86_VARIANTS
namespace x86_64_v3 {
KernelStatistics sweep_group(const GroupJob& job, std::span<const Index> sources, std::span<const Index> region,
                             GroupScratch& scratch);
}
namespace x86_64_v4 {
KernelStatistics sweep_group(const GroupJob& job, std::span<const Index> sources, std::span<const Index> region,
                             GroupScratch& scratch);
}
#endif

}  // namespace beltrami::triangulated
