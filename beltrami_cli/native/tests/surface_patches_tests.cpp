// Tests of patches on surfaces without Python, meant to be run under the sanitizers.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <random>
#include <vector>

#include "patches/surface_patches.hpp"
#include "tests/check.hpp"

using namespace beltrami::patches;

namespace {

using Random = std::mt19937;

// Sheets of jittered vertices above one another, with nothing between them, and a vertex that no edge ends at.
struct Sheets {
  std::size_t side, count, channels = 3;
  std::vector<Position> positions;
  std::vector<std::array<std::int32_t, 2>> edges;
  std::vector<std::uint64_t> priorities;
  std::vector<float> noisy, pilot, mixing{1, 0, 0, 0, 1, 0, 0, 0, 1}, variances{0.01F, 0.01F, 0.01F}, shrinkage{2, 2, 2};

  Sheets(std::size_t vertices, std::size_t sheets, Random& random) : side(vertices), count(sheets) {
    for (std::size_t sheet = 0; sheet < count; ++sheet)
      for (std::size_t i = 0; i < side * side; ++i) {
        const auto at = static_cast<std::int32_t>(sheet * side * side + i);
        const auto jitter = [&] { return static_cast<double>(random() % 100) / 400; };
        positions.push_back({static_cast<double>(i % side) + jitter(), static_cast<double>(i / side) + jitter(),
                             0.05 * static_cast<double>(sheet)});
        const bool is_last = i % side + 1 == side, is_top = i / side + 1 == side;
        const auto step = static_cast<std::int32_t>(side);
        if (!is_last) edges.push_back({at, at + 1});
        if (!is_top) edges.push_back({at, at + step});
        if (!is_last && !is_top) edges.push_back({at, at + step + 1});
      }
    positions.push_back({0.5, 0.5, 0});
    for (std::size_t i = 0; i < positions.size(); ++i) {
      priorities.push_back(random());
      const float colour = i < side * side ? 0.5F : 1000.0F;
      for (std::size_t c = 0; c < channels; ++c) {
        pilot.push_back(colour + 0.2F * static_cast<float>(std::sin(positions[i][0] / 3)));
        noisy.push_back(pilot.back() + 0.1F * std::normal_distribution<float>()(random));
      }
    }
  }

  SurfacePatches patches(unsigned threads) const {
    return {positions, edges, {Position{1, 0.2, 0}, Position{0, 1, 0}}, priorities, threads};
  }

  std::vector<float> result(const SurfacePatches& own, bool has_pilot, unsigned threads) const {
    std::vector<float> estimates(noisy.size()), weights(noisy.size());
    const SurfacePatches::Colours colours{noisy.data(),     pilot.data(),     channels, mixing.data(),
                                          variances.data(), shrinkage.data(), 0,        1};
    own.collaborate(colours, has_pilot, {estimates.data(), weights.data()}, threads);
    for (std::size_t i = 0; i < estimates.size(); ++i) estimates[i] = weights[i] > 0 ? estimates[i] / weights[i] : pilot[i];
    return estimates;
  }
};

void patches_of_vertices_stay_on_their_sheet() {
  Random random(27);
  const Sheets own(24, 2, random);
  const SurfacePatches patches = own.patches(2);
  const auto sheet_of = [&](std::size_t vertex) { return vertex / (own.side * own.side); };
  for (std::size_t vertex = 0; vertex < patches.size(); ++vertex) {
    const Nodes& found = patches.patch(vertex);
    CHECK(found[nodes / 2] == static_cast<std::int32_t>(vertex));
    for (const std::int32_t other : found) CHECK(other < 0 || sheet_of(static_cast<std::size_t>(other)) == sheet_of(vertex));
  }
  for (const bool has_pilot : {false, true}) {
    const std::vector<float> found = own.result(patches, has_pilot, 2);
    // Below the sheet of 1000, all stay near 0.5; the last vertex is alone.
    for (std::size_t i = 0; i < own.side * own.side * own.channels; ++i) CHECK(found[i] > -0.3F && found[i] < 1.3F);
    for (std::size_t i = found.size() - own.channels; i < found.size(); ++i)
      CHECK(found[i] == own.pilot[i]);
  }
}

void surfaces_do_not_depend_on_threads() {
  Random random(28);
  const Sheets own(70, 1, random);
  const SurfacePatches one = own.patches(1), three = own.patches(3);
  for (const bool has_pilot : {false, true}) {
    const std::vector<float> found = own.result(one, has_pilot, 1);
    CHECK(found == own.result(three, has_pilot, 2));
    CHECK(found == own.result(three, has_pilot, 3));
  }
}

void a_stop_ends_the_search_for_patches() {
  Random random(31);
  const Sheets own(70, 1, random);
  const std::array axes{Position{1, 0, 0}, Position{0, 1, 0}};
  bool stopped = false;
  try {
    const SurfacePatches patches(own.positions, own.edges, axes, own.priorities, 2, nullptr, [](std::size_t) { return false; });
  } catch (const beltrami::Cancelled&) {
    stopped = true;
  }
  CHECK(stopped);
}

void lattices_do_not_depend_on_the_order_of_edges() {
  Random random(30);
  Sheets own(20, 1, random);
  for (Position& position : own.positions) position[2] += static_cast<double>(random() % 100) / 1000;
  std::vector<std::array<std::int32_t, 2>> shuffled = own.edges;
  std::shuffle(shuffled.begin(), shuffled.end(), random);
  // Axes in the surface, and a first one that is normal to it.
  const std::array along{Position{1, 0.2, 0}, Position{0, 1, 0}}, upright{Position{0.1, 0, 1}, Position{1, 0.3, 0}};
  for (const auto& axes : {along, upright}) {
    const SurfacePatches one(own.positions, own.edges, axes, own.priorities, 1);
    const SurfacePatches other(own.positions, shuffled, axes, own.priorities, 2);
    for (std::size_t vertex = 0; vertex < one.size(); ++vertex) CHECK(one.patch(vertex) == other.patch(vertex));
  }
}

void small_surfaces_and_vertices_at_one_place_are_handled() {
  Random random(29);
  for (std::size_t side = 1; side < 6; ++side) {
    Sheets own(side, 2, random);
    for (int trial = 0; trial < 2; ++trial) {
      const std::vector<float> found = own.result(own.patches(1), trial == 0, 1);
      for (const float value : found) CHECK(std::isfinite(value));
      for (Position& position : own.positions) position = {1, 2, 3};
    }
  }
}

}  // namespace

int main() {
  patches_of_vertices_stay_on_their_sheet();
  surfaces_do_not_depend_on_threads();
  a_stop_ends_the_search_for_patches();
  lattices_do_not_depend_on_the_order_of_edges();
  small_surfaces_and_vertices_at_one_place_are_handled();
  std::puts("surface patches tests passed");
  return 0;
}
