// Disjoint sets of numbers, as a forest with path halving.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

namespace beltrami {

class DisjointSets {
 public:
  explicit DisjointSets(std::size_t count) : parent_(count) { std::iota(parent_.begin(), parent_.end(), 0); }

  // Returns the least number of a set.
  std::int32_t root(std::int32_t item) {
    while (parent(item) != item) item = parent(item) = parent(parent(item));
    return item;
  }

  void unite(std::int32_t a, std::int32_t b) {
    const std::int32_t root_a = root(a), root_b = root(b);
    parent(std::max(root_a, root_b)) = std::min(root_a, root_b);
  }

 private:
  std::int32_t& parent(std::int32_t item) { return parent_[static_cast<std::size_t>(item)]; }

  std::vector<std::int32_t> parent_;
};

}  // namespace beltrami
