#include "triangulated/vertex_groups.hpp"

#include <algorithm>
#include <limits>
#include <numeric>
#include <vector>

#include "parallel.hpp"

namespace beltrami::triangulated {
namespace {

constexpr std::size_t groups_per_block = 256;

// Minimum share of segments within groups. On even surfaces about every third segment is; with fewer, vertices that are
// close in space are not neighbours: leaves of a tree, stacked sheets, meaningless positions.
constexpr std::size_t usual_share = 8;

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

// The vertices of one block, [first, first + size), and the segments between them.
class Block {
 public:
  Block(const Segments& segments, std::size_t first, std::size_t size) : segments_(segments), first_(first), size_(size) {}

  // Number of segments within groups.
  std::size_t count_inside(std::span<const Index> members) const {
    std::vector<std::size_t> group(size_);
    for (std::size_t i = 0; i < size_; ++i) group[static_cast<std::size_t>(members[i]) - first_] = i / group_size;
    std::size_t inside = 0;
    for (std::size_t i = 0; i < size_; ++i)
      for_each_target(i, [&](std::size_t target) { inside += group[i] == group[target]; });
    return inside;
  }

  std::size_t count_all() const { return segments_.offsets[first_ + size_] - segments_.offsets[first_]; }

  // Grows one group after another along segments, each from the first remaining vertex.
  std::vector<Index> gather() const {
    std::vector<Index> members;
    members.reserve(size_);
    std::vector<bool> taken(size_, false);
    const auto take = [&](std::size_t i) {
      if (taken[i]) return;
      taken[i] = true;
      members.push_back(static_cast<Index>(first_ + i));
    };
    for (std::size_t seed = 0; seed < size_; ++seed) {
      std::size_t next = members.size();
      const std::size_t full = (next / group_size + 1) * group_size;
      for (take(seed); next < members.size() && members.size() < full; ++next)
        for_each_target(static_cast<std::size_t>(members[next]) - first_, [&](std::size_t target) {
          if (members.size() < full) take(target);
        });
    }
    return members;
  }

 private:
  template <class Visit>
  void for_each_target(std::size_t i, Visit visit) const {
    for (std::uint32_t k = segments_.offsets[first_ + i]; k < segments_.offsets[first_ + i + 1]; ++k)
      if (const std::size_t target = static_cast<std::size_t>(segments_.targets[k]) - first_; target < size_) visit(target);
  }

  const Segments& segments_;
  std::size_t first_, size_;
};

// Calls visit(segment) for the segments between members of a group, given the number of each vertex among all members.
template <class Visit>
void for_each_inner(const Segments& segments, std::span<const Index> members, const std::vector<std::uint32_t>& numbers,
                    std::size_t group, const Visit& visit) {
  for (std::size_t i = group * group_size; i < std::min((group + 1) * group_size, members.size()); ++i) {
    const auto from = static_cast<std::size_t>(members[i]);
    for (std::uint32_t place = segments.offsets[from]; place < segments.offsets[from + 1]; ++place) {
      const std::uint32_t to = numbers[static_cast<std::size_t>(segments.targets[place])];
      if (to > i && to / group_size == group)
        visit({place, static_cast<std::uint16_t>(i % group_size), static_cast<std::uint16_t>(to % group_size)});
    }
  }
}

void list_inner_segments(VertexGroups& groups, const Segments& segments, unsigned threads) {
  std::vector<std::uint32_t> numbers(groups.members.size());  // [vertex]: its place among the members
  for (std::size_t i = 0; i < numbers.size(); ++i)
    numbers[static_cast<std::size_t>(groups.members[i])] = static_cast<std::uint32_t>(i);
  groups.inner_offsets.assign(groups.count() + 1, 0);
  const auto for_each_group = [&](const auto& body) {
    parallel_chunks(groups.count(), groups_per_block, threads, [&](std::size_t begin, std::size_t end, unsigned) {
      for (std::size_t group = begin; group < end; ++group) body(group);
    });
  };
  for_each_group([&](std::size_t group) {
    for_each_inner(segments, groups.members, numbers, group, [&](const InnerSegment&) { ++groups.inner_offsets[group + 1]; });
  });
  std::partial_sum(groups.inner_offsets.begin(), groups.inner_offsets.end(), groups.inner_offsets.begin());
  groups.inner.resize(groups.inner_offsets.back());
  for_each_group([&](std::size_t group) {
    InnerSegment* next = groups.inner.data() + groups.inner_offsets[group];
    for_each_inner(segments, groups.members, numbers, group, [&](const InnerSegment& segment) { *next++ = segment; });
  });
}

}  // namespace

VertexGroup VertexGroups::group(std::size_t number) const {
  const std::size_t begin = number * group_size, first = inner_offsets[number];
  return {{members.data() + begin, std::min(group_size, members.size() - begin)},
          {inner.data() + first, inner_offsets[number + 1] - first}};
}

VertexGroups make_groups(Rows<double> positions, const Segments& segments, unsigned threads) {
  VertexGroups groups;
  groups.members.resize(static_cast<std::size_t>(segments.vertex_count()));
  std::iota(groups.members.begin(), groups.members.end(), Index{0});
  const Bisection bisection(positions);
  parallel_chunks(groups.members.size(), groups_per_block * group_size, threads,
                  [&](std::size_t begin, std::size_t end, unsigned) {
                    const std::span<Index> members(groups.members.data() + begin, end - begin);
                    // Without positions, the given order is used.
                    if (positions.width > 0) bisection.cut(members);
                    const Block block(segments, begin, members.size());
                    const std::size_t inside = block.count_inside(members);
                    if (inside * usual_share >= block.count_all()) return;
                    const auto gathered = block.gather();
                    if (block.count_inside(gathered) > inside) std::copy(gathered.begin(), gathered.end(), members.begin());
                  });
  list_inner_segments(groups, segments, threads);
  return groups;
}

}  // namespace beltrami::triangulated
