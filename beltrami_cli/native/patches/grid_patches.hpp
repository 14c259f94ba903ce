// Collaborative patches on a grid, see groups.hpp: squares of cells, and the most similar ones in a window around.
//
// Only how patches look decides, not where they lie: the window goes over the borders of charts. Patches reach over seams
// by the halo. Cells that are empty are in no patch.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "grid/grid.hpp"
#include "instruction_set.hpp"
#include "parallel.hpp"
#include "patches/groups.hpp"

namespace beltrami::patches {

// How far a patch reaches from its centre, and the distance between the centres that start groups.
constexpr int patch_reach = 3, spacing = 7;

// The window of candidates: rows above and below, columns to the left, and columns in all. Without a pilot few are needed,
// and those nearby serve better.
constexpr int rows_beside = 12, rows_beside_few = 7, columns_before = 16, candidate_columns = 32;

// Cells a side of the tiles of work.
constexpr int tile_side = 63;

// The surroundings of a tile: candidates, and their patches.
constexpr int margin = columns_before + patch_reach;
static_assert(tile_side >= 2 * margin && tile_side % spacing == 0);

// No group starts where all cells of a patch have this many estimates from groups before it.
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

// Writes estimates of the owned cells to `channels` planes; other cells get the pilot, whose planes the estimates may
// replace. Throws Cancelled if poll returned false.
void collaborate(const Canvas& canvas, bool has_pilot, float* estimates, unsigned threads, const Poll& poll = {});

}  // namespace beltrami::patches
