// Compiled once for each instruction set, see instruction_set.hpp.
#include "triangulated/group_sweep.hpp"

#include "triangulated/group_average.hpp"
#include "triangulated/group_distances.hpp"

namespace beltrami::triangulated::BELTRAMI_VARIANT {

std::optional<KernelStatistics> sweep_group(const GroupJob& job, const VertexGroup& group, GroupScratch& scratch) {
  const std::optional<Region> region = GroupDistances(*job.segments, job.parameters, scratch).find(group);
  if (!region) return std::nullopt;
  return GroupAverage(job, group.sources, *region, scratch.order).run();
}

}  // namespace beltrami::triangulated::BELTRAMI_VARIANT
