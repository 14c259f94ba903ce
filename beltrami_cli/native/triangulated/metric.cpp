#include "triangulated/metric.hpp"

#include "parallel.hpp"

namespace beltrami::triangulated {
namespace {

constexpr std::size_t edges_per_chunk = 16384;

template <class T>
double squared_distance(const T* a, const T* b, std::size_t width) {
  double sum = 0;
  for (std::size_t i = 0; i < width; ++i) {
    const double difference = static_cast<double>(a[i]) - static_cast<double>(b[i]);
    sum += difference * difference;
  }
  return sum;
}

}  // namespace

std::vector<double> squared_edge_lengths(const Topology& topology, Rows<double> positions, Rows<float> colours,
                                         double beta, const float* scales, unsigned threads) {
  std::vector<double> squared(topology.edges.size());
  const double squared_beta = beta * beta;
  parallel_chunks(squared.size(), edges_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    for (std::size_t edge = begin; edge < end; ++edge) {
      const auto [low, high] = topology.edges[edge];
      double space = squared_distance(positions[low], positions[high], positions.width);
      if (scales != nullptr) space *= static_cast<double>(scales[low]) * static_cast<double>(scales[high]);
      squared[edge] = space + squared_beta * squared_distance(colours[low], colours[high], colours.width);
    }
  });
  return squared;
}

void neighbour_means(Rows<float> values, std::span<const std::array<Index, 2>> edges, const float* weights,
                     std::span<const double> totals, float* means) {
  const std::size_t width = values.width;
  std::vector<double> sums(values.data, values.data + totals.size() * width);
  for (std::size_t edge = 0; edge < edges.size(); ++edge) {
    const auto [a, b] = edges[edge];
    const double weight = static_cast<double>(weights[edge]);
    double* at_a = sums.data() + static_cast<std::size_t>(a) * width;
    double* at_b = sums.data() + static_cast<std::size_t>(b) * width;
    for (std::size_t channel = 0; channel < width; ++channel) {
      at_a[channel] += weight * static_cast<double>(values[b][channel]);
      at_b[channel] += weight * static_cast<double>(values[a][channel]);
    }
  }
  for (std::size_t vertex = 0; vertex < totals.size(); ++vertex)
    for (std::size_t i = vertex * width; i < (vertex + 1) * width; ++i)
      means[i] = static_cast<float>(sums[i] / totals[vertex]);
}

}  // namespace beltrami::triangulated
