// The kernels of one group, side by side in the lanes; compiled once for each instruction set from the same source.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "triangulated/metric.hpp"
#include "triangulated/segments.hpp"
#include "triangulated/short_time_kernel.hpp"
#include "triangulated/vertex_groups.hpp"

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
  // One number for each source; a register's worth, which must not lie in two lines of the cache.
  struct alignas(64) Row {
    std::array<float, group_size> lane;
  };
  explicit GroupScratch(std::size_t vertex_count) : place(vertex_count, 0) {}
  std::vector<std::uint16_t> place;    // [vertex]: 1 + its place in the region, 0 outside
  std::vector<Index> region;           // [place]: the vertices that any of the kernels reaches, as they are found
  std::vector<Row> rows;               // [place]: distances, later kernel values
  std::vector<float> least;            // [place]: the least of its distances
  std::vector<std::uint32_t> changed;  // [place]: whether any distance has fallen and was not passed on
  std::vector<std::uint32_t> held;     // the places that a kernel holds
};

// Writes the smoothed colours of up to 16 sources. Nothing is written, or told, if they reach too many vertices.
using SweepGroup = std::optional<KernelStatistics> (*)(const GroupJob& job, std::span<const Index> sources,
                                                       GroupScratch& scratch);

namespace baseline {
std::optional<KernelStatistics> sweep_group(const GroupJob& job, std::span<const Index> sources, GroupScratch& scratch);
}
#ifdef BELTRAMI_X86_VARIANTS
namespace x86_64_v3 {
std::optional<KernelStatistics> sweep_group(const GroupJob& job, std::span<const Index> sources, GroupScratch& scratch);
}
namespace x86_64_v4 {
std::optional<KernelStatistics> sweep_group(const GroupJob& job, std::span<const Index> sources, GroupScratch& scratch);
}
#endif

}  // namespace beltrami::triangulated
