#include "grid/local_means.hpp"

#include <algorithm>
#include <cfloat>
#include <vector>

#include "exp_log.hpp"
#include "parallel.hpp"

namespace beltrami::grid {
namespace {

// Sum of the logarithms of edge lengths, and number of edges: of both axes at a cell, or of many cells.
struct Sums {
  std::vector<float> logarithms, counts;
  explicit Sums(std::size_t size) : logarithms(size), counts(size) {}
};

bool is_length(float squared) { return (squared >= FLT_MIN) & (squared <= FLT_MAX); }

void take_logarithms(const float* right, const float* below, std::size_t count, float* logarithms, float* counts) {
  for (std::size_t i = 0; i < count; ++i) {
    const bool goes_right = is_length(right[i]), goes_below = is_length(below[i]);
    logarithms[i] = logarithm(goes_right ? right[i] : 1.0F) + logarithm(goes_below ? below[i] : 1.0F);
    counts[i] = (goes_right ? 1.0F : 0.0F) + (goes_below ? 1.0F : 0.0F);
  }
}

}  // namespace

void convolve(const Planes& planes, std::size_t rows, std::size_t columns, std::span<const float> taps, float* result,
              unsigned threads) {
  const std::size_t reach = taps.size() / 2;
  const auto sum = BELTRAMI_VARIANT_OF(sum_over_taps, choose_instruction_set());
  // A chunk is a block of rows of a plane; a line of means down columns has zeros on both sides.
  const std::size_t height = std::max<std::size_t>(1, (std::size_t{1} << 16) / std::max<std::size_t>(1, columns));
  parallel_chunks(planes.channels * rows, height, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    std::vector<float> line(columns + 2 * reach, 0.0F);
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t row = i % rows;
      const float* const plane = planes[i / rows];
      // Beyond the plane there are no cells.
      const std::size_t begin_tap = reach - std::min(reach, row), end_tap = std::min(taps.size(), rows + reach - row);
      sum(plane + (row + begin_tap - reach) * columns, columns, taps.subspan(begin_tap, end_tap - begin_tap), columns,
          line.data() + reach);
      sum(line.data(), 1, taps, columns, result + i * columns);
    }
  });
}

void local_scale(std::size_t rows, std::size_t columns, const float* right, const float* below, int window_radius,
                 float* scale) {
  const auto reach = static_cast<std::size_t>(window_radius);
  // Sums over the window's rows, one per column, move down with the window, and those over its columns along the row.
  // The rows in the window are stored. In double precision, subtracting a value that was added leaves no error.
  const std::size_t side = 2 * reach + 1;
  Sums stored(side * columns), window(columns);
  // Beyond both ends there are no cells.
  std::vector<double> padded(columns + side), padded_counts(columns + side);
  double *down = padded.data() + reach + 1, *counts_down = padded_counts.data() + reach + 1;
  const auto move = [&](std::size_t row, bool in) {
    float* logarithms = stored.logarithms.data() + row % side * columns;
    float* counts = stored.counts.data() + row % side * columns;
    if (in) take_logarithms(right + row * columns, below + row * columns, columns, logarithms, counts);
    const double sign = in ? 1 : -1;
    for (std::size_t column = 0; column < columns; ++column) {
      down[column] += sign * static_cast<double>(logarithms[column]);
      counts_down[column] += sign * static_cast<double>(counts[column]);
    }
  };
  for (std::size_t row = 0; row < std::min(reach, rows); ++row) move(row, true);
  for (std::size_t row = 0; row < rows; ++row) {
    if (row > reach) move(row - reach - 1, false);
    if (row + reach < rows) move(row + reach, true);
    double logarithm_sum = 0, count = 0;
    for (std::size_t column = 0; column < std::min(reach, columns); ++column) {
      logarithm_sum += down[column];
      count += counts_down[column];
    }
    for (std::size_t column = 0; column < columns; ++column) {
      logarithm_sum += padded[column + side] - padded[column];
      count += padded_counts[column + side] - padded_counts[column];
      window.logarithms[column] = static_cast<float>(logarithm_sum);
      window.counts[column] = static_cast<float>(count);  // whole, so it comes out exactly
    }
    for (std::size_t column = 0; column < columns; ++column) {
      const float edges = window.counts[column] < 1.0F ? 1.0F : window.counts[column];  // without any the sum is 0
      scale[row * columns + column] = exponential(-window.logarithms[column] / edges);
    }
  }
}

}  // namespace beltrami::grid
