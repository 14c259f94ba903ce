// Vertices that a march has reached, and the heap of those that it may reach next.
#pragma once

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "triangulated/topology.hpp"

namespace beltrami::triangulated {

struct Reached {
  Index vertex;
  float distance;
};

// Non-negative floats order like their bit patterns; the vertex below them makes the order total.
inline std::uint64_t make_key(float distance, Index vertex) {
  return std::uint64_t{std::bit_cast<std::uint32_t>(distance)} << 32 | static_cast<std::uint32_t>(vertex);
}

inline Index vertex_of(std::uint64_t key) { return static_cast<Index>(key & 0xffffffffU); }
inline float distance_of(std::uint64_t key) { return std::bit_cast<float>(static_cast<std::uint32_t>(key >> 32)); }

// A heap of keys, the nearest vertex first. A vertex is pushed again each time that its distance falls, and its other keys
// are stale.
class MarchHeap {
 public:
  bool empty() const { return keys_.empty(); }
  std::size_t size() const { return keys_.size(); }
  std::uint64_t nearest() const { return keys_.front(); }
  void clear() { keys_.clear(); }

  void push(std::uint64_t key) {
    std::size_t hole = keys_.size();
    keys_.push_back(key);
    while (hole > 0) {
      const std::size_t parent = (hole - 1) / arity;
      if (keys_[parent] <= key) break;
      keys_[hole] = keys_[parent];
      hole = parent;
    }
    keys_[hole] = key;
  }

  std::uint64_t pop() {
    const std::uint64_t top = keys_.front(), moved = keys_.back();
    keys_.pop_back();
    const std::size_t size = keys_.size();
    if (size == 0) return top;
    std::size_t hole = 0;
    for (std::size_t first = 1; first < size; first = arity * hole + 1) {
      std::size_t least = first;
      for (std::size_t child = first + 1; child < std::min(first + arity, size); ++child)
        if (keys_[child] < keys_[least]) least = child;
      if (keys_[least] >= moved) break;
      keys_[hole] = keys_[least];
      hole = least;
    }
    keys_[hole] = moved;
    return top;
  }

  // Removes stale keys, and all but the `count` nearest of the others. Returns the furthest of these if any was removed.
  template <class IsStale>
  std::optional<std::uint64_t> keep_nearest(std::size_t count, IsStale is_stale) {
    std::erase_if(keys_, is_stale);
    std::optional<std::uint64_t> furthest;
    if (keys_.size() > count) {
      std::nth_element(keys_.begin(), keys_.begin() + static_cast<std::ptrdiff_t>(count) - 1, keys_.end());
      keys_.resize(count);
      furthest = keys_.back();
    }
    std::sort(keys_.begin(), keys_.end());  // a heap of any arity
    return furthest;
  }

 private:
  // Four children per node: half the levels of a binary heap, and they share a cache line.
  static constexpr std::size_t arity = 4;

  std::vector<std::uint64_t> keys_;
};

}  // namespace beltrami::triangulated
