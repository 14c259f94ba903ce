// Rows of colours moved to the planes of a canvas and back.
#pragma once

#include <cstddef>
#include <span>

namespace beltrami::colours {

// Planes of `size` cells each, one a channel.
template <class Value>
struct Planes {
  Value* values;
  std::size_t size, channels;
};

// Rows are numbered as the cells, which lie on the canvas, and none of which is named twice.
template <class Index>
void put(const Planes<float>& planes, std::span<const Index> cells, const float* rows, unsigned threads);
template <class Index>
void take(const Planes<const float>& planes, std::span<const Index> cells, float* rows, unsigned threads);

}  // namespace beltrami::colours
