// Vertices that a march reaches, and their order in its heap.
#pragma once

#include <bit>
#include <cstdint>

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

}  // namespace beltrami::triangulated
