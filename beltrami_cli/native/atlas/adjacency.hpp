// Neighbours over edges, inside charts and across seams.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "atlas/mesh.hpp"

namespace beltrami::atlas {

// A single-precision coordinate near 1 of a texture of 16,384 texels is no better than this.
constexpr double same_texel_tolerance = 1.0 / 1024;

inline bool same(Point2 a, Point2 b) {
  return std::abs(a.x - b.x) <= same_texel_tolerance && std::abs(a.y - b.y) <= same_texel_tolerance;
}

inline std::array<Index, 3> sorted(std::array<Index, 3> triple) {
  std::sort(triple.begin(), triple.end());
  return triple;
}

// Lists the items of each key in [0, keys), in order: items of key k are [offsets[k], offsets[k + 1]).
template <class KeyOf>
void bucket(std::size_t count, std::size_t keys, const KeyOf& key_of, std::vector<Index>& offsets,
            std::vector<Index>& items) {
  offsets.assign(keys + 1, 0);
  for (std::size_t i = 0; i < count; ++i)
    if (const Index key = key_of(i); key != none) ++offsets[static_cast<std::size_t>(key) + 1];
  for (std::size_t k = 0; k < keys; ++k) offsets[k + 1] += offsets[k];
  items.resize(static_cast<std::size_t>(offsets.back()));
  auto cursor = offsets;
  for (std::size_t i = 0; i < count; ++i)
    if (const Index key = key_of(i); key != none)
      items[static_cast<std::size_t>(cursor[static_cast<std::size_t>(key)]++)] = static_cast<Index>(i);
}

// Fills in Mesh::twins and Mesh::seams from the places and texels of the faces, and makes corners of neighbours inside
// a chart, which may differ by a rounding, equal.
void join_faces(Mesh& mesh);

}  // namespace beltrami::atlas
