#include "patches/grid_patches.hpp"

#include <algorithm>
#include <array>

namespace beltrami::patches {
namespace {

// Rows of cells that are finished together.
constexpr std::size_t finished_rows = 64;

bool any_owned(const Canvas& canvas, std::size_t row, std::size_t column) {
  const std::size_t last = std::min(canvas.columns, column + tile_side);
  for (std::size_t y = row; y < std::min(canvas.rows, row + tile_side); ++y) {
    const std::uint8_t* kind = canvas.kind + y * canvas.columns;
    if (std::find(kind + column, kind + last, grid::owned) != kind + last) return true;
  }
  return false;
}

// Divides sums by weights, and mixes the channels back; cells without an estimate get the pilot.
void finish(const Canvas& canvas, const Sums& sums, std::size_t first, std::size_t last) {
  const std::size_t cells = canvas.rows * canvas.columns, n = canvas.channels;
  std::vector<float> mixed(n);
  for (std::size_t cell = first; cell < last; ++cell) {
    const bool known = canvas.kind[cell] == grid::owned && sums.weights[cell] > 0;
    for (std::size_t c = 0; known && c < n; ++c)
      mixed[c] = sums.estimates[c * cells + cell] / sums.weights[c * cells + cell];
    for (std::size_t c = 0; c < n; ++c) {
      float value = known ? 0 : canvas.pilot[c * cells + cell];
      for (std::size_t from = 0; known && from < n; ++from) value += canvas.unmixing[c * n + from] * mixed[from];
      sums.estimates[c * cells + cell] = value;
    }
  }
}

}  // namespace

void collaborate(const Canvas& canvas, bool has_pilot, const Sums& sums, unsigned threads, const Poll& poll) {
  const auto add_tile_of = BELTRAMI_VARIANT_OF(add_tile, choose_instruction_set());
  const std::size_t cells = canvas.rows * canvas.columns;
  // Tiles of one colour lie so far apart that no two add to the same cell, and colours follow one another: the order in
  // which a cell's estimates are added does not depend on the threads.
  std::array<std::vector<Tile>, 4> colours;
  std::size_t total = 0;
  for (std::size_t row = 0; row < canvas.rows; row += tile_side)
    for (std::size_t column = 0; column < canvas.columns; column += tile_side)
      if (any_owned(canvas, row, column)) {
        colours[row / tile_side % 2 * 2 + column / tile_side % 2].push_back(
            {static_cast<std::ptrdiff_t>(row), static_cast<std::ptrdiff_t>(column)});
        ++total;
      }
  std::vector<TileScratch> scratch(threads);
  std::size_t before = 0;
  for (const auto& tiles : colours) {
    const Poll counted = poll ? Poll([&](std::size_t done) { return poll((before + done) * cells / total); }) : Poll();
    parallel_chunks(
        tiles.size(), 1, threads,
        [&](std::size_t begin, std::size_t end, unsigned worker) {
          for (std::size_t i = begin; i < end; ++i)
            add_tile_of(canvas, tiles[i], has_pilot, sums, scratch[worker]);
        },
        counted);
    before += tiles.size();
  }
  parallel_chunks(
      cells, finished_rows * canvas.columns, threads,
      [&](std::size_t begin, std::size_t end, unsigned) { finish(canvas, sums, begin, end); },
      poll ? Poll([&](std::size_t) { return poll(cells); }) : Poll());
}

}  // namespace beltrami::patches
