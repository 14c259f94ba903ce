#include "patches/grid_patches.hpp"

#include <algorithm>
#include <array>
#include <utility>

namespace beltrami::patches {
namespace {

// Rows of cells finished at a time.
constexpr std::size_t finished_rows = 64;

bool any_owned(const Canvas& canvas, std::size_t row, std::size_t column) {
  const std::size_t last = std::min(canvas.columns, column + tile_side);
  for (std::size_t y = row; y < std::min(canvas.rows, row + tile_side); ++y) {
    const std::uint8_t* kind = canvas.kind + y * canvas.columns;
    if (std::find(kind + column, kind + last, grid::owned) != kind + last) return true;
  }
  return false;
}

// The tiles with owned cells in each row of tiles: those in even columns, and those in odd ones.
std::vector<std::array<std::vector<Tile>, 2>> rows_of_tiles(const Canvas& canvas) {
  std::vector<std::array<std::vector<Tile>, 2>> rows((canvas.rows + tile_side - 1) / tile_side);
  for (std::size_t row = 0; row < canvas.rows; row += tile_side)
    for (std::size_t column = 0; column < canvas.columns; column += tile_side)
      if (any_owned(canvas, row, column))
        rows[row / tile_side][column / tile_side % 2].push_back(
            {static_cast<std::ptrdiff_t>(row), static_cast<std::ptrdiff_t>(column)});
  return rows;
}

// Tiles of one colour in a band, per thread: at the end at most one tile's time in this many is spent waiting.
constexpr std::size_t tiles_per_thread = 8;

// Number of rows of tiles processed together, an even number.
std::size_t rows_at_once(const Canvas& canvas, unsigned threads) {
  const std::size_t of_colour = std::max<std::size_t>(1, canvas.columns / tile_side / 2);
  return 2 * ((tiles_per_thread * (threads - 1)) / of_colour + 1);
}

// Moves a band down to the rows [first, end): the last rows that it had become the first, and new ones are zero.
void move_band(Band& band, const Canvas& canvas, std::size_t first, std::size_t end) {
  const std::size_t columns = canvas.columns, kept = std::max(first, band.first + band.rows) - first;
  for (std::vector<float>* sums : {&band.estimates, &band.weights}) {
    std::vector<float> moved(canvas.channels * (end - first) * columns, 0);
    for (std::size_t channel = 0; channel < canvas.channels; ++channel) {
      const float* from = sums->data() + ((channel + 1) * band.rows - kept) * columns;
      std::copy_n(from, kept * columns, moved.data() + channel * (end - first) * columns);
    }
    *sums = std::move(moved);
  }
  band.first = first;
  band.rows = end - first;
}

// Number of cells whose values fit the cache.
constexpr std::size_t finished_cells = 256;
using Cells = std::array<float, finished_cells>;

// Divides the sums of up to `finished_cells` cells by their weights, and inverts the mixing of channels; cells without
// an estimate get the pilot.
void finish(const Canvas& canvas, const Band& band, std::size_t cell, std::size_t count, std::vector<Cells>& mixed,
            float* estimates) {
  const std::size_t in_band = cell - band.first * canvas.columns, stride = band.rows * canvas.columns, n = canvas.channels;
  for (std::size_t c = 0; c < n; ++c) {
    const float *sums = band.estimates.data() + c * stride + in_band, *weights = band.weights.data() + c * stride + in_band;
    for (std::size_t i = 0; i < count; ++i) mixed[c][i] = sums[i] / weights[i];  // no number without an estimate
  }
  for (std::size_t c = 0; c < n; ++c) {
    Cells values{};
    for (std::size_t from = 0; from < n; ++from)
      for (std::size_t i = 0; i < count; ++i) values[i] += canvas.mixing.back[c * n + from] * mixed[from][i];
    const std::size_t at = c * canvas.rows * canvas.columns + cell;
    for (std::size_t i = 0; i < count; ++i)
      estimates[at + i] =
          canvas.kind[cell + i] == grid::owned && band.weights[in_band + i] > 0 ? values[i] : canvas.pilot[at + i];
  }
}

}  // namespace

void collaborate(const Canvas& canvas, bool has_pilot, float* estimates, unsigned threads, const Poll& poll) {
  const auto add_tile_of = BELTRAMI_VARIANT_OF(add_tile, choose_instruction_set());
  const auto rows = rows_of_tiles(canvas);
  std::size_t total = 0, before = 0;
  for (const auto& row : rows) total += row[0].size() + row[1].size();
  const auto counted = [&](std::size_t done) {
    return poll((before + done) * canvas.rows * canvas.columns / std::max<std::size_t>(1, total));
  };
  std::vector<TileScratch> scratch(std::max(1U, threads));
  Band band{};
  // The canvas is processed from above. An odd row of tiles waits for the even ones above and below, and tiles of one
  // colour are so far apart that no two add to the same cell. So the order of additions in a cell depends neither on
  // the band nor on the threads.
  std::size_t finished = 0;
  for (std::size_t row = 0, step = rows_at_once(canvas, threads); row < rows.size(); row += step) {
    const bool is_last = row + step >= rows.size();
    const std::size_t end = is_last ? rows.size() : row + step - 1;
    std::array<std::vector<Tile>, 4> colours;
    for (std::size_t ready = row == 0 ? 0 : row - 1; ready < end; ++ready)
      for (std::size_t side = 0; side < 2; ++side) {
        auto& tiles = colours[ready % 2 * 2 + side];
        tiles.insert(tiles.end(), rows[ready][side].begin(), rows[ready][side].end());
      }
    move_band(band, canvas, finished, is_last ? canvas.rows : std::min(canvas.rows, end * tile_side + margin));
    for (const auto& tiles : colours) {
      parallel_chunks(
          tiles.size(), 1, threads,
          [&](std::size_t begin, std::size_t last, unsigned worker) {
            for (std::size_t i = begin; i < last; ++i) add_tile_of(canvas, tiles[i], has_pilot, band, scratch[worker]);
          },
          poll ? Poll(counted) : Poll());
      before += tiles.size();
    }
    finished = is_last ? canvas.rows : end * tile_side - margin;  // as far up as the next rows of tiles reach
    const std::size_t first = band.first * canvas.columns;
    parallel_chunks(finished * canvas.columns - first, finished_rows * canvas.columns, threads,
                    [&](std::size_t begin, std::size_t last, unsigned) {
                      std::vector<Cells> mixed(canvas.channels);
                      for (std::size_t at = begin; at < last; at += finished_cells)
                        finish(canvas, band, first + at, std::min(finished_cells, last - at), mixed, estimates);
                    });
    if (poll && !counted(0)) throw Cancelled();
  }
}

}  // namespace beltrami::patches
