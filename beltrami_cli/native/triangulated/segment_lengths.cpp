#include "triangulated/segment_lengths.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "parallel.hpp"

namespace beltrami::triangulated {
namespace {

constexpr std::size_t items_per_chunk = 16384;

template <class T>
float squared_distance(const T* a, const T* b, std::size_t width) {
  float sum = 0;
  for (std::size_t i = 0; i < width; ++i) {
    const auto difference = static_cast<float>(a[i] - b[i]);
    sum += difference * difference;
  }
  return sum;
}

// The commonest width gets a loop of its own, which the compiler unrolls.
template <class T>
float squared_distance(Rows<T> rows, const std::array<Index, 2>& edge) {
  const T *a = rows[edge[0]], *b = rows[edge[1]];
  return rows.width == 3 ? squared_distance(a, b, 3) : squared_distance(a, b, rows.width);
}

void unfold_corners(EdgeMetric& metric, const Topology& topology, const float* squared,
                    std::size_t begin, std::size_t end) {
  for (std::size_t face = begin; face < end; ++face) {
    const auto& edges = topology.face_edges[face];
    std::array<float, 3> square, inverse;
    for (std::size_t k = 0; k < 3; ++k) {
      const auto edge = static_cast<std::size_t>(edges[k]);
      square[k] = squared[edge];
      inverse[k] = metric.lengths[edge] > 0 ? 1 / metric.lengths[edge] : 0;
    }
    // Corners of faces ascend, so the lower end of the edge facing corner 0 is corner 1, of the others corner 0.
    constexpr std::array<std::size_t, 3> faces_low{1, 0, 0}, faces_high{2, 2, 1};
    std::array<float, 3> along;
    for (std::size_t k = 0; k < 3; ++k) {
      // The edge from the apex k to the lower end faces the higher end.
      const float to_low = square[faces_high[k]], to_high = square[faces_low[k]];
      along[k] = 0.5F * (to_low + square[k] - to_high) * inverse[k];
    }
    // Twice the area; over the longest edge it suffers least from rounding.
    const std::size_t base = square[0] >= square[1] ? (square[0] >= square[2] ? 0 : 2) : (square[1] >= square[2] ? 1 : 2);
    const float squared_height = square[faces_high[base]] - along[base] * along[base];
    const float area = std::sqrt(std::max(0.0F, squared_height * square[base]));
    for (std::size_t k = 0; k < 3; ++k) metric.corners[3 * face + k] = {along[k], area * inverse[k]};
  }
}

// Segments across edges: both apexes on either side of the edge, and the straight line between them.
void cross_edges(Segments& segments, const EdgeMetric& metric, const Topology& topology, std::size_t begin,
                 std::size_t end) {
  for (std::size_t corner = begin; corner < end; ++corner) {
    const Corner twin = topology.twins[corner];
    if (twin <= static_cast<Corner>(corner)) continue;
    const auto edge = static_cast<std::size_t>(topology.face_edges[corner / 3][corner % 3]);
    const auto c = metric.corners[corner], d = metric.corners[static_cast<std::size_t>(twin)];
    const float apart = c.along - d.along, heights = c.height + d.height;
    const float crossing = c.along * d.height + d.along * c.height;
    const bool straight = crossing > 0 && crossing < metric.lengths[edge] * heights;
    segments.set_length(metric.lengths.size() + edge,
                        straight ? std::sqrt(apart * apart + heights * heights) : no_segment);
  }
}

// Segments around corners A = 3 f + k of triangles ABC: from D beyond AB to E beyond AC, passing A on its left.
void round_corners(Segments& segments, const EdgeMetric& metric, const Topology& topology, std::size_t begin,
                   std::size_t end) {
  for (std::size_t corner = begin; corner < end; ++corner) {
    const std::size_t face = corner / 3, k = corner % 3, kb = (k + 1) % 3, kc = (k + 2) % 3;
    const Corner beyond_b = topology.twins[3 * face + kc], beyond_c = topology.twins[3 * face + kb];
    if (beyond_b == none || beyond_c == none) continue;
    const float ab = metric.lengths[static_cast<std::size_t>(topology.face_edges[face][kc])];
    const float ac = metric.lengths[static_cast<std::size_t>(topology.face_edges[face][kb])];
    // Measured from A, which is the lower end of AB and AC or the higher one.
    const auto from_a = [](EdgeMetric::Place place, float length, bool low) {
      return EdgeMetric::Place{low ? place.along : length - place.along, place.height};
    };
    const auto c = from_a(metric.corners[3 * face + kc], ab, k < kb);
    const auto d = from_a(metric.corners[static_cast<std::size_t>(beyond_b)], ab, k < kb);
    const auto e = from_a(metric.corners[static_cast<std::size_t>(beyond_c)], ac, k < kc);
    const float inverse = ac > 0 ? 1 / ac : 0;
    const float ex = (e.along * c.along - e.height * c.height) * inverse;
    const float ey = (e.along * c.height + e.height * c.along) * inverse;
    const float dx = ex - d.along, dy = ey + d.height;
    // > 0: the point lies on the left of the line from D to E.
    const auto side = [&](float x, float y) { return dx * (y + d.height) - dy * (x - d.along); };
    const bool straight = ey > 0 && side(0, 0) > 0 && side(ab, 0) < 0 && side(c.along, c.height) < 0;
    segments.set_length(2 * metric.lengths.size() + corner, straight ? std::sqrt(dx * dx + dy * dy) : no_segment);
  }
}

}  // namespace

bool measure_edges(EdgeMetric& metric, const Topology& topology, Rows<double> positions, Rows<float> colours, double beta,
                   const float* scales, unsigned threads) {
  const std::size_t count = topology.edges.size();
  std::atomic<bool> moved = metric.in_space.size() != count;
  metric.in_space.resize(count);
  metric.squared.resize(count);
  const auto squared_beta = static_cast<float>(beta * beta);
  parallel_chunks(count, items_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    bool moved_here = false;
    for (std::size_t i = begin; i < end; ++i) {
      const auto& edge = topology.edges[i];
      float space = squared_distance(positions, edge);
      if (scales != nullptr) space *= scales[edge[0]] * scales[edge[1]];
      moved_here |= !(metric.in_space[i] == space);
      metric.in_space[i] = space;
      metric.squared[i] = space + squared_beta * squared_distance(colours, edge);
    }
    if (moved_here) moved = true;
  });
  return moved;
}

void update_lengths(Segments& segments, EdgeMetric& metric, const Topology& topology, const std::vector<float>& squared,
                    unsigned threads) {
  metric.corners.resize(topology.twins.size());
  metric.lengths.resize(squared.size());
  parallel_chunks(squared.size(), items_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    for (std::size_t edge = begin; edge < end; ++edge) metric.lengths[edge] = std::sqrt(squared[edge]);
    for (std::size_t edge = begin; edge < end; ++edge) segments.set_length(edge, metric.lengths[edge]);
  });
  parallel_chunks(topology.faces.size(), items_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    unfold_corners(metric, topology, squared.data(), begin, end);
  });
  parallel_chunks(topology.twins.size(), items_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    cross_edges(segments, metric, topology, begin, end);
    round_corners(segments, metric, topology, begin, end);
  });
}

}  // namespace beltrami::triangulated
