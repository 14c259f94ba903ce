// Patches of vertices as rows of values: all nodes of the first channel, then of the next.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "instruction_set.hpp"
#include "patches/groups.hpp"

namespace beltrami::patches {

// 1 at the nodes that are compared, else 0.
using NodeMask = std::array<float, short_row>;

using CompareRows = void (*)(const float* rows, std::size_t length, const float* mask, std::span<const std::int32_t> places,
                             float* distances);
using TakeRows = void (*)(const float* channel, std::span<const std::size_t> rows, const NodeMask& mask, float mean, float* group);
using AddRows = void (*)(const Group& group, std::span<const std::size_t> rows, const NodeMask& mask, float mean, float* channel);

BELTRAMI_DECLARE_VARIANTS(
    // Writes to `distances` the sums of squared differences between the first of some rows and each of them. Rows have
    // `length` floats, a multiple of 16; differences are multiplied by `mask`, 0 or 1.
    void compare_rows(const float* rows, std::size_t length, const float* mask, std::span<const std::int32_t> places,
                      float* distances);

    // Writes the differences from `mean` to the rows of a group, for a channel of the patches whose rows begin at `rows`.
    // `short_row` values of each are read.
    void take_rows(const float* channel, std::span<const std::size_t> rows, const NodeMask& mask, float mean, float* group);

    // Adds the estimates of a group, plus `mean` and multiplied by their weights, to a channel of the same rows. Values
    // at masked nodes are written unchanged.
    void add_rows(const Group& group, std::span<const std::size_t> rows, const NodeMask& mask, float mean, float* channel))

}  // namespace beltrami::patches
