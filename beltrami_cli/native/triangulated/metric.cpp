#include "triangulated/metric.hpp"

#include <algorithm>

#include "parallel.hpp"

namespace beltrami::triangulated {
namespace {

constexpr std::size_t edges_per_chunk = 16384;
constexpr unsigned most_shares = 4;  // of vertices, since each reads all edges

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
                     std::span<const double> totals, float* means, unsigned threads) {
  const std::size_t width = values.width, share = totals.size() / std::clamp(threads, 1u, most_shares) + 1;
  // The sums of each vertex are in the order of the edges, for any number of threads.
  parallel_chunks(totals.size(), share, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    std::vector<double> sums(values.data + begin * width, values.data + end * width);
    const auto add = [&](std::size_t vertex, double weight, const float* other) {
      if (vertex - begin >= end - begin) return;
      for (std::size_t i = 0; i < width; ++i) sums[(vertex - begin) * width + i] += weight * static_cast<double>(other[i]);
    };
    for (std::size_t edge = 0; edge < edges.size(); ++edge) {
      const auto [a, b] = edges[edge];
      add(static_cast<std::size_t>(a), static_cast<double>(weights[edge]), values[b]);
      add(static_cast<std::size_t>(b), static_cast<double>(weights[edge]), values[a]);
    }
    for (std::size_t vertex = begin; vertex < end; ++vertex)
      for (std::size_t i = vertex * width; i < (vertex + 1) * width; ++i)
        means[i] = static_cast<float>(sums[i - begin * width] / totals[vertex]);
  });
}

}  // namespace beltrami::triangulated
