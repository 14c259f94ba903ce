#include "triangulated/neighbour_means.hpp"

#include <cstddef>
#include <vector>

namespace beltrami::triangulated {

void neighbour_means(Rows<float> values, std::span<const std::array<Index, 2>> edges, const float* weights,
                     std::span<const double> totals, float* means) {
  const std::size_t width = values.width;
  std::vector<double> sums(values.data, values.data + totals.size() * width);
  for (std::size_t edge = 0; edge < edges.size(); ++edge) {
    const auto [a, b] = edges[edge];
    const double weight = static_cast<double>(weights[edge]);
    double *at_a = sums.data() + static_cast<std::size_t>(a) * width, *at_b = sums.data() + static_cast<std::size_t>(b) * width;
    for (std::size_t channel = 0; channel < width; ++channel) {
      at_a[channel] += weight * static_cast<double>(values[b][channel]);
      at_b[channel] += weight * static_cast<double>(values[a][channel]);
    }
  }
  for (std::size_t vertex = 0; vertex < totals.size(); ++vertex)
    for (std::size_t i = vertex * width; i < (vertex + 1) * width; ++i) means[i] = static_cast<float>(sums[i] / totals[vertex]);
}

}  // namespace beltrami::triangulated
