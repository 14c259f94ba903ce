#include "triangulated/segment_lengths.hpp"

#include <algorithm>
#include <span>
#include <utility>

#include "parallel.hpp"

namespace beltrami::triangulated {
namespace {

constexpr std::size_t items_per_chunk = 4096;

void measure_in_space(LengthTables& tables, Rows<double> positions, const float* scales, std::size_t begin, std::size_t end) {
  for (std::size_t i = begin; i < end; ++i) {
    const auto [low, high] = tables.edges[i];
    const double *a = positions[low], *b = positions[high];
    float space = 0;
    for (std::size_t axis = 0; axis < positions.width; ++axis) {
      const auto difference = static_cast<float>(a[axis] - b[axis]);
      space += difference * difference;
    }
    tables.in_space[i] = scales == nullptr ? space : space * (scales[low] * scales[high]);
  }
}

}  // namespace

SegmentLengths::SegmentLengths(Topology topology) {
  tables_.planes = make_planes(topology);
  topology.face_edges = {};
  tables_.segments = make_segments(topology, tables_.planes);
  tables_.edges = std::move(topology.edges);
  tables_.in_space.assign(tables_.edges.size() + spare_lengths, 0);
  tables_.squared.assign(tables_.edges.size() + spare_lengths, 0);
}

bool SegmentLengths::have_changed(Rows<double> positions, const float* scales) {
  const auto count = static_cast<std::size_t>(segments().vertex_count());
  const std::span now(positions.data, count * positions.width);
  const std::span scales_now(scales, scales == nullptr ? 0 : count);
  if (std::equal(now.begin(), now.end(), positions_.begin(), positions_.end()) &&
      std::equal(scales_now.begin(), scales_now.end(), scales_.begin(), scales_.end()))
    return false;
  positions_.assign(now.begin(), now.end());
  scales_.assign(scales_now.begin(), scales_now.end());
  return true;
}

bool SegmentLengths::update(Rows<double> positions, Rows<float> colours, double beta, const float* scales,
                            unsigned threads) {
  const bool changed = have_changed(positions, scales);
  const LengthSweep& sweep = BELTRAMI_VARIANT_OF(length_sweep, choose_instruction_set());
  const auto squared_beta = static_cast<float>(beta * beta);
  const std::size_t edge_count = tables_.edges.size(), face_count = tables_.planes.count;
  parallel_chunks(edge_count, items_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    if (changed) measure_in_space(tables_, positions, scales, begin, end);
    sweep.measure_edges(tables_, colours, squared_beta, begin, end);
  });
  // Edges and triangles are sorted by their vertices, so that corresponding parts of both write to the same lists.
  const std::size_t chunks = (std::max(edge_count, face_count) + items_per_chunk - 1) / items_per_chunk;
  parallel_chunks(chunks, 1, threads, [&](std::size_t chunk, std::size_t, unsigned) {
    const auto part = [&](std::size_t count, std::size_t i) { return i == chunks ? count : count / chunks * i / 16 * 16; };
    sweep.set_lengths(tables_, part(edge_count, chunk), part(edge_count, chunk + 1));
    sweep.cross_edges(tables_, part(face_count, chunk), part(face_count, chunk + 1));
  });
  return changed;
}

}  // namespace beltrami::triangulated
