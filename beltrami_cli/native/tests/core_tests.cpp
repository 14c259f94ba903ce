// Tests of the core without Python, meant to be run under the sanitizers: every array access on meshes of every kind.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <random>
#include <vector>

#include "parallel.hpp"
#include "tests/check.hpp"
#include "tests/meshes.hpp"
#include "triangulated/fast_marching.hpp"
#include "triangulated/metric.hpp"
#include "triangulated/vertex_order.hpp"
#include "triangulated/short_time_kernel.hpp"
#include "triangulated/stencils.hpp"
#include "triangulated/topology.hpp"

using namespace beltrami;
using namespace beltrami::triangulated;

namespace {

struct Image {
  Image(const Mesh& mesh, double beta, unsigned threads)
      : topology(make_topology(mesh.faces, mesh.vertex_count())), stencils(make_stencils(topology)) {
    const auto squared =
        squared_edge_lengths(topology, mesh.position_rows(), mesh.colour_rows(), beta, nullptr, threads);
    update_stencils(stencils, topology, squared, threads);
  }
  Topology topology;
  Stencils stencils;
};

std::vector<float> smoothed(const Mesh& mesh, const Image& image, unsigned threads, std::size_t max_samples) {
  std::vector<float> result(mesh.colours.size());
  smooth(image.stencils, mesh.colour_rows(), nullptr, {1.0F, 4.3F, max_samples}, result.data(), threads);
  return result;
}

void topology_of_a_grid_is_counted_right() {
  const Mesh mesh = make_grid(4);
  const Topology topology = make_topology(mesh.faces, mesh.vertex_count());
  CHECK(topology.faces.size() == 18 && topology.edges.size() == 33);
  CHECK(std::count(topology.twins.begin(), topology.twins.end(), none) == 12);
  CHECK(topology.slot_offsets.back() == 6 * 18);
}

void distances_along_grid_lines_are_exact() {
  const Mesh mesh = make_grid(9);
  const Image image(mesh, 1, 1);
  FastMarching marching(image.stencils);
  float last = 0;
  for (const auto& [vertex, distance] : marching.march(40, 100, 1000)) {
    const int x = vertex % 9 - 4, y = vertex / 9 - 4;
    const auto truth = static_cast<float>(std::hypot(x, y));
    CHECK(distance >= last && distance >= truth - 1e-5F);
    if (x == 0 || y == 0) CHECK(std::abs(distance - truth) < 1e-5F);
    last = distance;
  }
}

void random_soups_keep_the_range_for_any_number_of_threads() {
  std::mt19937 random(7);
  for (int trial = 0; trial < 2000; ++trial) {
    const Mesh mesh = make_soup(random);
    const double beta = trial % 3 == 0 ? 0 : 5;
    const Image image(mesh, beta, 1);
    const auto result = smoothed(mesh, image, 1, trial % 5 == 0 ? 3 : 1000);
    const auto [low, high] = std::minmax_element(mesh.colours.begin(), mesh.colours.end());
    for (const float value : result) CHECK(value >= *low - 1e-6F && value <= *high + 1e-6F);
    CHECK(result == smoothed(mesh, Image(mesh, beta, 3), 3, trial % 5 == 0 ? 3 : 1000));
    const auto order = morton_order(mesh.position_rows(), mesh.vertex_count());
    auto sorted = order;
    std::sort(sorted.begin(), sorted.end());
    for (std::size_t i = 0; i < sorted.size(); ++i) CHECK(sorted[i] == static_cast<Index>(i));
  }
}

void constants_are_fixed_points_and_threads_do_not_matter() {
  Mesh mesh = make_grid(80);
  const Image flat(mesh, 10, 2);
  CHECK(smoothed(mesh, flat, 2, 1000) == mesh.colours);
  std::mt19937 random(3);
  for (float& value : mesh.colours) value = random_colour(random);
  const Image noisy(mesh, 10, 2);
  const auto one = smoothed(mesh, noisy, 1, 1000);
  CHECK(one != mesh.colours);
  CHECK(one == smoothed(mesh, noisy, 2, 1000) && one == smoothed(mesh, noisy, 5, 1000));
}

void bad_indices_are_refused() {
  for (const Index bad : {-1, 3}) {
    bool refused = false;
    try {
      make_topology(std::vector<Index>{0, 1, bad}, 3);
    } catch (const std::invalid_argument&) {
      refused = true;
    }
    CHECK(refused);
  }
}

void a_poll_can_cancel_and_failures_come_through() {
  std::atomic<int> handled{0};
  bool cancelled = false;
  try {
    parallel_chunks(
        1000000, 1, 2, [&](std::size_t, std::size_t, unsigned) { ++handled; }, [](std::size_t) { return false; });
  } catch (const Cancelled&) {
    cancelled = true;
  }
  CHECK(cancelled);
  bool failed = false;
  try {
    parallel_chunks(100, 1, 3, [](std::size_t begin, std::size_t, unsigned) {
      if (begin == 50) throw std::bad_alloc();
    });
  } catch (const std::bad_alloc&) {
    failed = true;
  }
  CHECK(failed);
}

}  // namespace

int main() {
  topology_of_a_grid_is_counted_right();
  distances_along_grid_lines_are_exact();
  random_soups_keep_the_range_for_any_number_of_threads();
  constants_are_fixed_points_and_threads_do_not_matter();
  bad_indices_are_refused();
  a_poll_can_cancel_and_failures_come_through();
  std::puts("core tests passed");
  return 0;
}
