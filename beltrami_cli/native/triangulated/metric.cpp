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

}  // namespace beltrami::triangulated
