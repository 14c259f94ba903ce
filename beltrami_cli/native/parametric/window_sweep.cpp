#include "parametric/window_sweep.hpp"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "parametric/sweep_tile.hpp"

namespace beltrami::parametric {
namespace {

// The planes of a tile, about 32 floats a cell, stay in the second-level cache (some 0.5 MB).
constexpr std::size_t tile_rows = 32, tile_columns = 96;

struct Variant {
  const char* name;
  SweepTile sweep;
};

// The variants that this processor can run, the best first.
std::vector<Variant> usable_variants() {
  std::vector<Variant> variants;
#ifdef BELTRAMI_X86_VARIANTS
  __builtin_cpu_init();
  if (__builtin_cpu_supports("x86-64-v4")) variants.push_back({"x86-64-v4", x86_64_v4::sweep_tile});
  if (__builtin_cpu_supports("x86-64-v3")) variants.push_back({"x86-64-v3", x86_64_v3::sweep_tile});
#endif
  variants.push_back({"baseline", baseline::sweep_tile});
  return variants;
}

Variant choose_variant() {
  const auto variants = usable_variants();
  const char* asked = std::getenv("BELTRAMI_SIMD");
  if (asked == nullptr) return variants.front();
  for (const Variant& variant : variants)
    if (std::strcmp(variant.name, asked) == 0) return variant;
  throw std::invalid_argument("BELTRAMI_SIMD names an instruction set that this machine does not have");
}

std::vector<Tile> cut_into_tiles(const Grid& grid) {
  std::vector<Tile> tiles;
  // A band of a canvas has rows without owned cells above it, and its own rows are as many as those of whole tiles.
  const std::uint8_t* first = std::find(grid.kind, grid.kind + grid.cells(), owned);
  const std::size_t top = static_cast<std::size_t>(first - grid.kind) / std::max<std::size_t>(1, grid.columns);
  for (std::size_t row = top; row < grid.rows; row += tile_rows)
    for (std::size_t column = 0; column < grid.columns; column += tile_columns) {
      const Tile tile{row, column, std::min(tile_rows, grid.rows - row), std::min(tile_columns, grid.columns - column)};
      bool used = false;
      for (std::size_t y = row; y < row + tile.rows && !used; ++y) {
        const std::uint8_t* kind = grid.kind + y * grid.columns + column;
        used = std::find(kind, kind + tile.columns, owned) != kind + tile.columns;
      }
      if (used) tiles.push_back(tile);
    }
  return tiles;
}

}  // namespace

std::int64_t smooth_by_sweeps(const Grid& grid, Planes metric, Planes colours, const SweepParameters& parameters,
                              const WindowProgram& program, float* smoothed, unsigned threads, const Poll& poll) {
  std::copy(colours.data, colours.data + colours.channels * grid.cells(), smoothed);
  const auto tiles = cut_into_tiles(grid);
  const SweepTile sweep = choose_variant().sweep;
  const TileJob job{&grid, metric, colours, &parameters, &program, smoothed};
  std::vector<TileScratch> scratch(std::max(1U, threads));
  std::vector<std::int64_t> samples(tiles.size());
  parallel_chunks(
      tiles.size(), 1, threads,
      [&](std::size_t begin, std::size_t end, unsigned worker) {
        for (std::size_t i = begin; i < end; ++i) samples[i] = sweep(job, tiles[i], scratch[worker]);
      },
      poll ? Poll([&](std::size_t done) { return poll(done * grid.cells() / tiles.size()); }) : Poll());
  return std::accumulate(samples.begin(), samples.end(), std::int64_t{0});
}

void distances_by_sweeps(const Grid& grid, Planes metric, const SweepParameters& parameters, const WindowProgram& program,
                         std::size_t cell, float* distances) {
  const std::size_t side = 2 * static_cast<std::size_t>(program.radius) + 1;
  TileScratch scratch;
  const TileJob job{&grid, metric, {nullptr, 0}, &parameters, &program, nullptr, distances};
  choose_variant().sweep(job, {cell / grid.columns, cell % grid.columns, 1, 1}, scratch);
  const float reach = std::min(parameters.radius, longest_radius);
  std::replace_if(distances, distances + side * side, [&](float distance) { return !(distance <= reach); },
                  std::numeric_limits<float>::infinity());
}

const char* sweep_instruction_set() { return choose_variant().name; }

}  // namespace beltrami::parametric
