#include "parametric/repeats.hpp"

#include <algorithm>
#include <vector>

#include "parallel.hpp"

namespace beltrami::parametric {

void count_repeats(std::size_t rows, std::size_t columns, const HaloCells& halo, std::ptrdiff_t reach,
                   std::uint8_t* repeats, unsigned threads) {
  constexpr std::int64_t none = -1;
  constexpr std::ptrdiff_t most = 255;
  std::vector<std::int64_t> number(rows * columns, none);
  for (std::size_t i = 0; i < halo.count; ++i)
    number[static_cast<std::size_t>(halo.cells[i])] = static_cast<std::int64_t>(i);
  std::fill(repeats, repeats + rows * columns, std::uint8_t{1});
  const auto height = static_cast<std::ptrdiff_t>(rows), width = static_cast<std::ptrdiff_t>(columns);
  constexpr std::size_t chunk = 4096;
  parallel_chunks(halo.count, chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    for (std::size_t i = begin; i < end; ++i) {
      const std::ptrdiff_t row = halo.cells[i] / width, column = halo.cells[i] % width;
      std::ptrdiff_t found = 0;
      for (std::ptrdiff_t y = std::max<std::ptrdiff_t>(0, row - reach); y <= std::min(height - 1, row + reach); ++y)
        for (std::ptrdiff_t x = std::max<std::ptrdiff_t>(0, column - reach); x <= std::min(width - 1, column + reach);
             ++x) {
          const std::int64_t other = number[static_cast<std::size_t>(y * width + x)];
          if (other == none) continue;
          const auto j = static_cast<std::size_t>(other);
          found += halo.sources[j] == halo.sources[i] && halo.seams[j] == halo.seams[i];
        }
      repeats[halo.cells[i]] = static_cast<std::uint8_t>(std::min(most, found));
    }
  });
}

}  // namespace beltrami::parametric
