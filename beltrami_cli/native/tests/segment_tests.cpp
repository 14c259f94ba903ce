// Tests of the kernel along segments without Python, meant to be run under the sanitizers.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <vector>

#include "triangulated/segment_kernel.hpp"

using namespace beltrami::triangulated;

namespace {

void check(bool holds, const char* what, int line) {
  if (holds) return;
  std::fprintf(stderr, "segment_tests.cpp:%d: not true: %s\n", line, what);
  std::exit(1);
}
#define CHECK(condition) check((condition), #condition, __LINE__)

struct Mesh {
  std::vector<double> positions;  // three a vertex
  std::vector<float> colours;     // `channels` a vertex
  std::vector<Index> faces;       // three a face
  std::size_t channels = 3;
  Index vertex_count() const { return static_cast<Index>(positions.size() / 3); }
};

// A square grid in the plane with random colours.
Mesh make_grid(int side, std::size_t channels, std::mt19937& random) {
  Mesh mesh{{}, {}, {}, channels};
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) {
      mesh.positions.insert(mesh.positions.end(), {static_cast<double>(x), static_cast<double>(y), 0.0});
      for (std::size_t c = 0; c < channels; ++c) mesh.colours.push_back(static_cast<float>(random() % 256) / 255.0F);
      if (x + 1 < side && y + 1 < side) {
        const Index a = y * side + x;
        mesh.faces.insert(mesh.faces.end(), {a, a + 1, a + side, a + 1, a + side + 1, a + side});
      }
    }
  return mesh;
}

// Any triangles over few vertices: repeated vertices, duplicate and non-manifold faces, coincident points.
Mesh make_soup(std::mt19937& random) {
  Mesh mesh{{}, {}, {}, 1 + random() % 7};
  const auto vertices = static_cast<Index>(1 + random() % 40);
  for (Index v = 0; v < vertices; ++v) {
    for (int axis = 0; axis < 3; ++axis)
      mesh.positions.push_back(static_cast<double>(random() % 5) * (random() % 3 == 0 ? 1e-9 : 1.0));
    for (std::size_t c = 0; c < mesh.channels; ++c)
      mesh.colours.push_back(static_cast<float>(random() % 256) / 255.0F);
  }
  for (unsigned long corner = 3 * (random() % 120); corner > 0; --corner)
    mesh.faces.push_back(static_cast<Index>(random() % static_cast<unsigned long>(vertices)));
  return mesh;
}

struct Result {
  std::vector<float> colours;
  KernelStatistics statistics;
};

Result smoothed(const Mesh& mesh, SegmentKernel& kernel, double beta, const KernelParameters& parameters, unsigned threads) {
  Result result{std::vector<float>(mesh.colours.size()), {}};
  const Rows<float> colours{mesh.colours.data(), mesh.channels};
  kernel.update_metric({mesh.positions.data(), 3}, colours, beta, nullptr, threads);
  result.statistics = kernel.smooth(colours, nullptr, parameters, result.colours.data(), threads);
  return result;
}

// Eqs. (8, 9) with the distances of single marches.
Result by_marches(const Mesh& mesh, const SegmentKernel& kernel, const KernelParameters& parameters) {
  Result result;
  for (Index source = 0; source < mesh.vertex_count(); ++source) {
    const auto held = kernel.distances(source, parameters.radius, parameters.max_samples);
    result.statistics.samples += static_cast<std::int64_t>(held.size());
    for (std::size_t c = 0; c < mesh.channels; ++c) {
      double sum = 0, total = 0;
      for (const auto& [vertex, distance] : held) {
        const float exponent = -distance * distance / (4 * parameters.time_step);
        const double weight = std::exp(static_cast<double>(exponent));
        sum += weight * static_cast<double>(mesh.colours[static_cast<std::size_t>(vertex) * mesh.channels + c]);
        total += weight;
      }
      result.colours.push_back(static_cast<float>(sum / total));
    }
  }
  return result;
}

void distances_on_a_grid_are_exact_to_neighbours_and_nearly_so_beyond() {
  std::mt19937 random(1);
  const Mesh mesh = make_grid(9, 1, random);
  SegmentKernel kernel(mesh.faces, mesh.vertex_count());
  kernel.update_metric({mesh.positions.data(), 3}, {mesh.colours.data(), 1}, 0, nullptr, 1);
  for (const auto& [vertex, distance] : kernel.distances(40, 100, 1000)) {
    const int x = vertex % 9 - 4, y = vertex / 9 - 4;
    const auto truth = static_cast<float>(std::hypot(x, y));
    CHECK(distance >= truth - 1e-5F);
    // Over edges and diagonals alone a path would bend by 22.5 degrees at most.
    CHECK(distance <= 1.0825F * truth);
    if (std::abs(x) <= 1 && std::abs(y) <= 1) CHECK(std::abs(distance - truth) < 1e-5F);
  }
}

void soups_give_what_single_marches_give_on_any_number_of_threads() {
  std::mt19937 random(7);
  for (int trial = 0; trial < 1000; ++trial) {
    const Mesh mesh = make_soup(random);
    const double beta = trial % 3 == 0 ? 0 : 5;
    const KernelParameters parameters{1.0F, 4.3F, 1000};
    SegmentKernel kernel(mesh.faces, mesh.vertex_count()), other(mesh.faces, mesh.vertex_count());
    const auto ours = smoothed(mesh, kernel, beta, parameters, 1), truth = by_marches(mesh, kernel, parameters);
    CHECK(ours.statistics.samples == truth.statistics.samples && ours.statistics.truncated == 0);
    for (std::size_t i = 0; i < ours.colours.size(); ++i)
      CHECK(std::abs(ours.colours[i] - truth.colours[i]) < 1e-5F);
    CHECK(ours.colours == smoothed(mesh, other, beta, parameters, 3).colours);
    const auto cut = smoothed(mesh, kernel, beta, {1.0F, 4.3F, 3}, 2);
    CHECK(cut.statistics.samples <= 3 * static_cast<std::int64_t>(mesh.vertex_count()));
  }
}

void regions_follow_positions_and_grow_beyond_what_sources_share() {
  std::mt19937 random(3);
  Mesh mesh = make_grid(60, 4, random);
  SegmentKernel kernel(mesh.faces, mesh.vertex_count());
  for (const float radius : {3.0F, 40.0F, 2.0F}) {
    const KernelParameters parameters{radius * radius / 18, radius, 100};
    const auto ours = smoothed(mesh, kernel, 1, parameters, 2), truth = by_marches(mesh, kernel, parameters);
    CHECK(ours.statistics.samples == truth.statistics.samples);
    for (double& position : mesh.positions) position *= 0.75;
  }
}

}  // namespace

int main() {
  distances_on_a_grid_are_exact_to_neighbours_and_nearly_so_beyond();
  soups_give_what_single_marches_give_on_any_number_of_threads();
  regions_follow_positions_and_grow_beyond_what_sources_share();
  std::puts("segment tests passed");
  return 0;
}
