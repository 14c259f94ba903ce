#include "colours/storing.hpp"

#include <algorithm>
#include <cstdlib>
#include <limits>
#include <type_traits>
#include <vector>

#include "parallel.hpp"

namespace beltrami::colours {
namespace {

constexpr std::size_t pixels_per_chunk = 1 << 12;

// Rounds to the nearest integers, ties to even, in doubles of a magnitude without fractional digits. In single
// precision a product may be rounded to the middle between two integers.
constexpr double no_fractions = 6755399441055744.0;  // 1.5 * 2^52

void round_all(const float* values, std::size_t count, double largest, std::int32_t* rounded) {
  for (std::size_t i = 0; i < count; ++i) {
    const float positive = values[i] > 0.0F ? values[i] : 0.0F;  // and NaN is 0
    const double scaled = static_cast<double>(positive < 1.0F ? positive : 1.0F) * largest;
    rounded[i] = static_cast<std::int32_t>((scaled + no_fractions) - no_fractions);
  }
}

// Accounts for a number that replaces another.
template <class Sum, class Sample>
struct Sums {
  Sum total = 0, squares = 0;
  std::int32_t largest = 0;

  void replace(Sample& sample, std::int32_t now) {
    const std::int32_t step = std::abs(now - static_cast<std::int32_t>(sample));
    sample = static_cast<Sample>(now);
    total += static_cast<Sum>(step);
    squares += static_cast<Sum>(step) * static_cast<Sum>(step);
    largest = std::max(largest, step);
  }

  void add_to(Moved& moved) const {
    moved.total += total;
    moved.squares += squares;
    moved.largest = std::max<std::uint64_t>(moved.largest, static_cast<std::uint64_t>(largest));
  }
};

// Sums over a line of bytes fit into 32 bits; vector instructions add twice as many of these at a time.
template <class Sample>
using LineSum = std::conditional_t<sizeof(Sample) == 1, std::uint32_t, std::uint64_t>;
constexpr std::size_t longest_line = 1 << 16;
static_assert(std::uint64_t{longest_line} * 255 * 255 <= std::numeric_limits<std::uint32_t>::max());

// Stores contiguous runs of whole pixels.
template <class Sample, class Index>
void store_whole(const std::int32_t* now, std::span<const Index> pixels, std::size_t width, Sample* samples, Moved& moved) {
  for (std::size_t row = 0; row < pixels.size();) {
    std::size_t run = 1;
    while (row + run < pixels.size() && pixels[row + run] == pixels[row] + static_cast<Index>(run) &&
           (run + 1) * width <= longest_line)
      ++run;
    Sample* const line = samples + static_cast<std::size_t>(pixels[row]) * width;
    Sums<LineSum<Sample>, Sample> sums;
    for (std::size_t i = 0; i < run * width; ++i) sums.replace(line[i], now[row * width + i]);
    sums.add_to(moved);
    row += run;
  }
}

// Stores some channels of pixels.
template <class Sample, class Index>
void store_some(const std::int32_t* now, std::span<const std::int32_t> channels, std::span<const Index> pixels,
                std::size_t width, Sample* samples, Moved& moved) {
  Sums<std::uint64_t, Sample> sums;
  for (const Index pixel : pixels)
    for (const std::int32_t channel : channels)
      sums.replace(samples[static_cast<std::size_t>(pixel) * width + static_cast<std::size_t>(channel)], *now++);
  sums.add_to(moved);
}

bool are_all_in_order(std::span<const std::int32_t> channels, std::size_t width) {
  if (channels.size() != width) return false;
  for (std::size_t i = 0; i < width; ++i)
    if (channels[i] != static_cast<std::int32_t>(i)) return false;
  return true;
}

}  // namespace

template <class Sample, class Index>
Moved store(const Rows& rows, std::span<const Index> pixels, std::size_t width, Sample* samples, unsigned threads) {
  const std::size_t count = rows.channels.size();
  const bool whole = are_all_in_order(rows.channels, width);
  std::vector<Moved> chunks((pixels.size() + pixels_per_chunk - 1) / pixels_per_chunk);
  parallel_chunks(pixels.size(), pixels_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    std::vector<std::int32_t> rounded((end - begin) * count);
    round_all(rows.values + begin * count, rounded.size(), std::numeric_limits<Sample>::max(), rounded.data());
    const auto own = pixels.subspan(begin, end - begin);
    Moved& moved = chunks[begin / pixels_per_chunk];
    if (whole)
      store_whole(rounded.data(), own, width, samples, moved);
    else
      store_some(rounded.data(), rows.channels, own, width, samples, moved);
  });
  Moved together;
  for (const Moved& chunk : chunks)
    together = {together.total + chunk.total, together.squares + chunk.squares, std::max(together.largest, chunk.largest)};
  return together;
}

template Moved store(const Rows&, std::span<const std::int32_t>, std::size_t, std::uint8_t*, unsigned);
template Moved store(const Rows&, std::span<const std::int64_t>, std::size_t, std::uint8_t*, unsigned);
template Moved store(const Rows&, std::span<const std::int32_t>, std::size_t, std::uint16_t*, unsigned);
template Moved store(const Rows&, std::span<const std::int64_t>, std::size_t, std::uint16_t*, unsigned);

}  // namespace beltrami::colours
