// Weighted means over the neighbours of each vertex, for the regularised metric.
#pragma once

#include <array>
#include <span>

#include "triangulated/metric.hpp"

namespace beltrami::triangulated {

// (v_p + sum over the edges pq of w_pq v_q) / total_p for each vertex p and each channel, in rows as wide as the values.
void neighbour_means(Rows<float> values, std::span<const std::array<Index, 2>> edges, const float* weights,
                     std::span<const double> totals, float* means);

}  // namespace beltrami::triangulated
