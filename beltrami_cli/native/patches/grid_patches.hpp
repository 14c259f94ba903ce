// Collaborative patches on a grid, see groups.hpp: squares of cells, and the most similar ones in a window around.
//
// Patches are compared by their colours, not by position: the window crosses borders of charts. Patches extend over
// seams by the halo. Empty cells are in no patch.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "grid/grid.hpp"
#include "instruction_set.hpp"
#include "parallel.hpp"
#include "patches/groups.hpp"

namespace beltrami::patches {

// Reach of a patch from its centre, and distance between the centres that start groups.
constexpr int patch_reach = 3, spacing = 7;

// The window of candidates: rows above and below, columns to the left, and total columns. Without a pilot few
// candidates are needed, and nearby ones are better.
constexpr int rows_beside = 12, rows_beside_few = 7, columns_before = 16, candidate_columns = 32;

// Side of the tiles of work in cells.
constexpr int tile_side = 63;

// The surroundings of a tile: candidates, and their patches.
constexpr int margin = columns_before + patch_reach;
static_assert(tile_side >= 2 * margin && tile_side % spacing == 0);

// No group starts where all cells of a patch have this many estimates already.
constexpr std::uint16_t enough_estimates = 4;

// Colours in planes.
struct Canvas : Colours {
  std::size_t rows, columns;
  const std::uint8_t* kind;
};

struct Tile {
  std::ptrdiff_t row, column;
};

struct TileScratch {
  std::vector<float> noisy, pilot, relative, estimates, weights, distances;
  std::vector<std::uint8_t> kind;
  std::vector<std::uint16_t> counts;  // of estimates; enough in empty cells
  std::vector<std::uint32_t> keys;
  Group group{};
};

// Sums of estimates and of their weights in some rows of a canvas, `channels` planes each.
struct Band {
  std::size_t first, rows;
  std::vector<float> estimates, weights;
};

// Adds the estimates of the groups that start in a tile to a band that holds its surroundings.
BELTRAMI_DECLARE_VARIANTS(void add_tile(const Canvas& canvas, const Tile& tile, bool has_pilot, Band& band,
                                        TileScratch& scratch))

// Writes estimates of the owned cells to `channels` planes; other cells get the pilot, whose planes may be those of the
// estimates. Throws Cancelled if poll returned false.
void collaborate(const Canvas& canvas, bool has_pilot, float* estimates, unsigned threads, const Poll& poll = {});

}  // namespace beltrami::patches
