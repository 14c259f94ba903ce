#include "grid/repeats.hpp"

#include <algorithm>
#include <vector>

#include "parallel.hpp"

namespace beltrami::grid {

void count_repeats(std::size_t rows, std::size_t columns, const HaloCells& halo, std::ptrdiff_t reach,
                   std::uint8_t* repeats, unsigned threads) {
  constexpr std::ptrdiff_t most = 255;
  const std::int64_t* const last = halo.cells + halo.count;
  std::fill(repeats, repeats + rows * columns, std::uint8_t{1});
  const auto height = static_cast<std::ptrdiff_t>(rows), width = static_cast<std::ptrdiff_t>(columns);
  constexpr std::size_t chunk = 4096;
  parallel_chunks(halo.count, chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    // The beginnings of the nearby rows in the list advance with the cell.
    std::vector<const std::int64_t*> starts;
    for (std::ptrdiff_t down = -reach; down <= reach; ++down)
      starts.push_back(std::lower_bound(halo.cells, last, halo.cells[begin] + down * width - reach));
    for (std::size_t i = begin; i < end; ++i) {
      const std::ptrdiff_t row = halo.cells[i] / width, column = halo.cells[i] % width;
      std::ptrdiff_t found = 0;
      for (std::ptrdiff_t y = std::max<std::ptrdiff_t>(0, row - reach); y <= std::min(height - 1, row + reach); ++y) {
        const std::int64_t leftmost = y * width + std::max<std::ptrdiff_t>(0, column - reach);
        const std::int64_t rightmost = y * width + std::min(width - 1, column + reach);
        auto& start = starts[static_cast<std::size_t>(y - row + reach)];
        while (start != last && *start < leftmost) ++start;
        const std::int64_t* cell = start;
        for (; cell != last && *cell <= rightmost; ++cell) {
          const auto j = cell - halo.cells;
          found += halo.sources[j] == halo.sources[i] && halo.seams[j] == halo.seams[i];
        }
      }
      repeats[halo.cells[i]] = static_cast<std::uint8_t>(std::min(most, found));
    }
  });
}

}  // namespace beltrami::grid
