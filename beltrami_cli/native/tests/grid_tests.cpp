// Tests of the kernel on grids without Python, meant to be run under the sanitizers: of every shape, with holes.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <random>
#include <vector>

#include "grid/local_means.hpp"
#include "grid/window_sweep.hpp"
#include "tests/check.hpp"

using namespace beltrami::grid;

namespace {

struct Canvas {
  Canvas(std::size_t rows, std::size_t columns, std::mt19937& random)
      : kind(rows * columns), lengths(4 * rows * columns), colours(2 * rows * columns), scale(rows * columns) {
    const std::size_t cells = rows * columns;
    for (auto& cell : kind) cell = static_cast<std::uint8_t>(random() % 8 < 6 ? owned : random() % 2 ? halo : empty);
    for (float& length : lengths) {
      const bool is_missing = random() % 9 == 0;
      length = is_missing ? std::numeric_limits<float>::infinity() : 0.1F + static_cast<float>(random() % 30) / 10.0F;
    }
    for (float& colour : colours) colour = static_cast<float>(random() % 256) / 255.0F;
    local_scale(rows, columns, lengths.data(), lengths.data() + cells, 3, scale.data());
    for (std::size_t i = 0; i < cells; ++i) CHECK(scale[i] > 0 && std::isfinite(scale[i]));
    std::array<const float*, direction_count> of_lengths;
    for (std::size_t k = 0; k < direction_count; ++k) of_lengths[k] = lengths.data() + k * cells;
    grid = {rows, columns, kind.data(), of_lengths, random() % 2 ? scale.data() : nullptr};
    pointers = {colours.data(), colours.data() + cells};
  }
  Planes planes() const { return {pointers.data(), pointers.size()}; }

  std::vector<std::uint8_t> kind;
  std::vector<float> lengths, colours, scale;
  std::array<const float*, 2> pointers;
  Grid grid;
};

void sweeps_and_marches_keep_the_range_and_every_cell_that_is_not_owned() {
  std::mt19937 random(11);
  for (int trial = 0; trial < 150; ++trial) {
    const Canvas canvas(1 + random() % 45, 1 + random() % 130, random);
    const Planes planes = canvas.planes();
    const SweepParameters parameters{1.5F, 5.0F, trial % 3 == 0 ? 0.0F : 4.0F};
    const auto program = make_window_program(1 + trial % 7);
    std::vector<float> swept(canvas.colours.size()), again(swept.size()), marched(swept.size());
    smooth_by_sweeps(canvas.grid, planes, planes, parameters, program, swept.data(), 1);
    smooth_by_sweeps(canvas.grid, planes, planes, parameters, program, again.data(), 3);
    CHECK(swept == again);
    const Scheme scheme = trial % 2 == 0 ? Scheme::metric : Scheme::triangles;
    smooth_by_marching(canvas.grid, planes, planes, parameters, trial % 4, scheme, marched.data(), 2);
    for (std::size_t i = 0; i < swept.size(); ++i) {
      for (const float value : {swept[i], marched[i]}) CHECK(value >= -1e-6F && value <= 1 + 1e-6F);
      if (canvas.kind[i % canvas.grid.cells()] == owned) continue;
      CHECK(swept[i] == canvas.colours[i] && marched[i] == canvas.colours[i]);
    }
  }
}

// The mean over a kernel's window, eq. (9), by its distances.
float mean_by_distances(const Canvas& canvas, std::size_t cell, int radius, float t, const std::vector<float>& distances) {
  const auto columns = static_cast<std::ptrdiff_t>(canvas.grid.columns);
  double sum = 0, total = 0;
  for (int y = -radius; y <= radius; ++y)
    for (int x = -radius; x <= radius; ++x) {
      const auto slot = static_cast<std::size_t>((y + radius) * (2 * radius + 1) + x + radius);
      const auto distance = static_cast<double>(distances[slot]);
      if (!std::isfinite(distance)) continue;
      const double kernel = std::exp(-distance * distance / (4 * static_cast<double>(t)));
      total += kernel;
      sum += kernel * static_cast<double>(canvas.colours[cell + static_cast<std::size_t>(y * columns + x)]);
    }
  return static_cast<float>(sum / total);
}

void distances_of_one_kernel_are_those_that_the_kernel_averages_by() {
  std::mt19937 random(12);
  for (int trial = 0; trial < 40; ++trial) {
    const Canvas canvas(1 + random() % 45, 1 + random() % 130, random);
    const Planes planes = canvas.planes();
    const int radius = 1 + trial % 7;
    const SweepParameters parameters{1.5F, 5.0F, trial % 3 == 0 ? 0.0F : 4.0F};
    const auto program = make_window_program(radius);
    const Scheme scheme = trial % 2 == 0 ? Scheme::metric : Scheme::triangles;
    std::vector<float> swept(canvas.colours.size()), marched(swept.size());
    smooth_by_sweeps(canvas.grid, planes, planes, parameters, program, swept.data(), 1);
    smooth_by_marching(canvas.grid, planes, planes, parameters, radius, scheme, marched.data(), 1);
    std::vector<float> distances(static_cast<std::size_t>((2 * radius + 1) * (2 * radius + 1)));
    for (std::size_t cell = random() % 97; cell < canvas.grid.cells(); cell += 97) {
      if (canvas.kind[cell] != owned) continue;
      distances_by_sweeps(canvas.grid, planes, parameters, program, cell, distances.data());
      CHECK(std::abs(mean_by_distances(canvas, cell, radius, 1.5F, distances) - swept[cell]) < 1e-5F);
      distances_by_marching(canvas.grid, planes, parameters, radius, scheme, cell, distances.data());
      CHECK(std::abs(mean_by_distances(canvas, cell, radius, 1.5F, distances) - marched[cell]) < 1e-5F);
    }
  }
}

}  // namespace

int main() {
  sweeps_and_marches_keep_the_range_and_every_cell_that_is_not_owned();
  distances_of_one_kernel_are_those_that_the_kernel_averages_by();
  std::puts("grid tests passed");
  return 0;
}
