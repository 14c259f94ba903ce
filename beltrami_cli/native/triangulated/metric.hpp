// Lengths on the image manifold: a sample (X, beta I) in R^(M+N) carries the metric diag(1 .. 1, beta^2 ..
// beta^2) of A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images on
// manifolds" (2007), eq. (1). On a triangulation the induced metric is known by its edge lengths.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "triangulated/topology.hpp"

namespace beltrami::triangulated {

// Rows of `width` numbers, one row per vertex.
template <class T>
struct Rows {
  const T* data = nullptr;
  std::size_t width = 0;
  const T* operator[](Index row) const { return data + static_cast<std::size_t>(row) * width; }
};

// Squared length of every edge, |dX|^2 + beta^2 |dI|^2, in double precision. Any M and N, zero included. With scales,
// positive numbers for all vertices, |dX|^2 is multiplied by the scales of both ends: lengths in local units.
std::vector<double> squared_edge_lengths(const Topology& topology, Rows<double> positions, Rows<float> colours,
                                         double beta, const float* scales, unsigned threads);

// Means over the neighbours of each vertex, for the regularised metric:
// (v_p + sum over the edges pq of w_pq v_q) / total_p for each vertex p and each channel, in rows as wide as the values.
void neighbour_means(Rows<float> values, std::span<const std::array<Index, 2>> edges, const float* weights,
                     std::span<const double> totals, float* means, unsigned threads);

}  // namespace beltrami::triangulated
