#include "grid/squares.hpp"

#include <algorithm>
#include <vector>

#include "grid/grid.hpp"
#include "parallel.hpp"

namespace beltrami::grid {
namespace {

// The squares before and after the middle of a cell, and the fraction between them.
struct Between {
  std::size_t low, high;
  float share;

  Between(std::size_t cell, std::size_t side, std::size_t squares) {
    const float place = (static_cast<float>(cell) + 0.5F) / static_cast<float>(side) - 0.5F;
    const float within = std::clamp(place, 0.0F, static_cast<float>(squares - 1));
    low = static_cast<std::size_t>(within);
    high = std::min(low + 1, squares - 1);
    share = within - static_cast<float>(low);
  }
};

// Rows of squares processed together.
constexpr std::size_t chunk = 8;

}  // namespace

void means_of_squares(const Squares& squares, const std::uint8_t* kinds, const float* planes, std::size_t count, float* means,
                      unsigned threads) {
  const std::size_t side = squares.side, across = squares.across(), down = squares.down();
  parallel_chunks(count * down, chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    std::vector<float> sums(across), counts(across);
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t first = i % down * side, last = std::min(first + side, squares.rows);
      const std::uint8_t* wanted = kinds + i % down * across;
      std::fill(sums.begin(), sums.end(), 0.0F);
      std::fill(counts.begin(), counts.end(), 0.0F);
      for (std::size_t row = first; row < last; ++row) {
        const float* values = planes + (i / down * squares.rows + row) * squares.columns;
        const std::uint8_t* kind = squares.kind + row * squares.columns;
        for (std::size_t square = 0, column = 0; square < across; ++square)
          for (const std::size_t beyond = std::min(column + side, squares.columns); column < beyond; ++column) {
            const float counted = kind[column] == wanted[square] ? 1.0F : 0.0F;
            sums[square] += counted * values[column];
            counts[square] += counted;
          }
      }
      for (std::size_t square = 0; square < across; ++square)
        means[i * across + square] = wanted[square] == empty ? 0.0F : sums[square] / counts[square];
    }
  });
}

void add_enlarged(const Squares& squares, const std::uint8_t* kinds, const float* changes, std::size_t count, float* planes,
                  unsigned threads) {
  const std::size_t side = squares.side, across = squares.across(), down = squares.down();
  std::vector<Between> columns;
  for (std::size_t column = 0; column < squares.columns; ++column) columns.emplace_back(column, side, across);
  parallel_chunks(squares.rows, chunk * side, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    // For the squares above and below: the share of owned ones, and the changes of each plane times that share.
    std::vector<float> shares(across), sums(across);
    for (std::size_t row = begin; row < end; ++row) {
      const Between between(row, side, down);
      const std::uint8_t *above = kinds + between.low * across, *below = kinds + between.high * across;
      const std::uint8_t* kind = squares.kind + row * squares.columns;
      for (std::size_t plane = 0; plane < count; ++plane) {
        const float* changes_above = changes + (plane * down + between.low) * across;
        const float* changes_below = changes + (plane * down + between.high) * across;
        for (std::size_t square = 0; square < across; ++square) {
          const float upper = above[square] == owned ? 1 - between.share : 0;
          const float lower = below[square] == owned ? between.share : 0;
          shares[square] = upper + lower;
          sums[square] = upper * changes_above[square] + lower * changes_below[square];
        }
        float* values = planes + (plane * squares.rows + row) * squares.columns;
        for (std::size_t column = 0; column < squares.columns; ++column) {
          if (kind[column] != owned) continue;
          const auto& [left, right, share] = columns[column];
          const float total = (1 - share) * shares[left] + share * shares[right];
          const float change = (1 - share) * sums[left] + share * sums[right];
          if (total > 0) values[column] += change / total;
        }
      }
    }
  });
}

}  // namespace beltrami::grid
