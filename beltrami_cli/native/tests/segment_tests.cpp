// Tests of the kernel along segments without Python, meant to be run under the sanitizers.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <random>
#include <vector>

#include "tests/check.hpp"
#include "tests/meshes.hpp"
#include "triangulated/segment_kernel.hpp"

using namespace beltrami::triangulated;

namespace {

struct Result {
  std::vector<float> colours;
  KernelStatistics statistics;
};

Result smoothed(const Mesh& mesh, SegmentKernel& kernel, double beta, const KernelParameters& parameters, unsigned threads) {
  Result result{std::vector<float>(mesh.colours.size()), {}};
  const Rows<float> colours = mesh.colour_rows();
  kernel.update_metric(mesh.position_rows(), colours, beta, nullptr, threads);
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
  const Mesh mesh = make_grid(9, 1);
  SegmentKernel kernel(mesh.faces, mesh.vertex_count());
  kernel.update_metric(mesh.position_rows(), mesh.colour_rows(), 0, nullptr, 1);
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
    const Mesh mesh = make_soup(random, 1 + random() % 7);
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
  Mesh mesh = make_grid(60, 4);
  for (float& value : mesh.colours) value = random_colour(random);
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
