#include "colours/storing.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "parallel.hpp"

namespace beltrami::colours {
namespace {

constexpr std::size_t pixels_per_chunk = 1 << 14;

// In double precision: in single a product may round to the middle between two integers.
template <class Sample>
long rounded(float value) {
  const float inside = value > 0 ? (value < 1 ? value : 1) : 0;
  return std::lrint(static_cast<double>(inside) * std::numeric_limits<Sample>::max());
}

}  // namespace

template <class Sample, class Index>
Moved store(const Rows& rows, std::span<const Index> pixels, std::size_t width, Sample* samples, unsigned threads) {
  const std::size_t count = rows.channels.size();
  std::vector<Moved> chunks((pixels.size() + pixels_per_chunk - 1) / pixels_per_chunk);
  parallel_chunks(pixels.size(), pixels_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    Moved moved;
    for (std::size_t row = begin; row < end; ++row) {
      Sample* const pixel = samples + static_cast<std::size_t>(pixels[row]) * width;
      for (std::size_t i = 0; i < count; ++i) {
        Sample& sample = pixel[rows.channels[i]];
        const long now = rounded<Sample>(rows.values[row * count + i]);
        const auto step = static_cast<std::uint64_t>(std::abs(now - static_cast<long>(sample)));
        sample = static_cast<Sample>(now);
        moved.total += step;
        moved.squares += step * step;
        moved.largest = std::max(moved.largest, step);
      }
    }
    chunks[begin / pixels_per_chunk] = moved;
  });
  Moved all;
  for (const Moved& chunk : chunks)
    all = {all.total + chunk.total, all.squares + chunk.squares, std::max(all.largest, chunk.largest)};
  return all;
}

template Moved store(const Rows&, std::span<const std::int32_t>, std::size_t, std::uint8_t*, unsigned);
template Moved store(const Rows&, std::span<const std::int64_t>, std::size_t, std::uint8_t*, unsigned);
template Moved store(const Rows&, std::span<const std::int32_t>, std::size_t, std::uint16_t*, unsigned);
template Moved store(const Rows&, std::span<const std::int64_t>, std::size_t, std::uint16_t*, unsigned);

}  // namespace beltrami::colours
