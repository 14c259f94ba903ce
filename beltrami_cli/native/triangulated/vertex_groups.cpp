#include "triangulated/vertex_groups.hpp"

#include <algorithm>
#include <limits>
#include <numeric>

#include "parallel.hpp"
#include "triangulated/segment_march.hpp"

namespace beltrami::triangulated {
namespace {

constexpr std::size_t groups_per_block = 256;

// Rounding of lengths must not cut a region short.
constexpr float margin = 1.001F;

class Bisection {
 public:
  explicit Bisection(Rows<double> positions) : positions_(positions) {}

  void cut(std::span<Index> vertices) const {
    if (vertices.size() <= group_size) return;
    const std::size_t axis = longest_axis(vertices);
    const std::size_t groups = (vertices.size() + group_size - 1) / group_size;
    const auto middle = static_cast<std::ptrdiff_t>(groups / 2 * group_size);
    std::nth_element(vertices.begin(), vertices.begin() + middle, vertices.end(), [&](Index a, Index b) {
      const double at_a = positions_[a][axis], at_b = positions_[b][axis];
      return at_a != at_b ? at_a < at_b : a < b;
    });
    cut(vertices.first(static_cast<std::size_t>(middle)));
    cut(vertices.subspan(static_cast<std::size_t>(middle)));
  }

 private:
  std::size_t longest_axis(std::span<const Index> vertices) const {
    std::size_t longest = 0;
    double most = -1;
    for (std::size_t axis = 0; axis < positions_.width; ++axis) {
      double low = std::numeric_limits<double>::infinity(), high = -low;
      for (const Index vertex : vertices) {
        low = std::min(low, positions_[vertex][axis]);
        high = std::max(high, positions_[vertex][axis]);
      }
      if (high - low > most) {
        most = high - low;
        longest = axis;
      }
    }
    return longest;
  }

  Rows<double> positions_;
};

}  // namespace

std::span<const Index> VertexGroups::sources(std::size_t group) const {
  const std::size_t begin = group * group_size;
  return {members.data() + begin, std::min(group_size, members.size() - begin)};
}

std::span<const Index> VertexGroups::region(std::size_t group) const {
  const std::uint32_t begin = group % groups_per_block == 0 ? 0 : ends[group - 1];
  return {regions[group / groups_per_block].data() + begin, ends[group] - begin};
}

VertexGroups make_groups(Rows<double> positions, Index vertex_count, unsigned threads) {
  VertexGroups groups;
  groups.members.resize(static_cast<std::size_t>(vertex_count));
  std::iota(groups.members.begin(), groups.members.end(), Index{0});
  // Block by block, and without positions the order given must do.
  if (positions.width == 0) return groups;
  const Bisection bisection(positions);
  parallel_chunks(groups.members.size(), groups_per_block * group_size, threads,
                  [&](std::size_t begin, std::size_t end, unsigned) {
                    bisection.cut({groups.members.data() + begin, end - begin});
                  });
  return groups;
}

void find_regions(VertexGroups& groups, const Segments& segments, float radius, unsigned threads, const Poll& poll) {
  const std::size_t count = groups.count();
  groups.ends.assign(count, 0);
  groups.regions.assign((count + groups_per_block - 1) / groups_per_block, {});
  std::vector<SegmentMarch> marches(std::max(1U, threads), SegmentMarch(segments));
  const auto find = [&](std::size_t begin, std::size_t end, unsigned worker) {
    SegmentMarch& marching = marches[worker];
    auto& block = groups.regions[begin / groups_per_block];
    for (std::size_t group = begin; group < end; ++group) {
      const auto reached = marching.march(groups.sources(group), margin * radius, largest_region);
      if (!marching.truncated())
        for (const auto& [vertex, distance] : reached) block.push_back(vertex);
      groups.ends[group] = static_cast<std::uint32_t>(block.size());
    }
    block.shrink_to_fit();
  };
  parallel_chunks(count, groups_per_block, threads, find, poll);
}

}  // namespace beltrami::triangulated
