#include "colours/colours.hpp"

#include <cstdint>

#include "parallel.hpp"

namespace beltrami::colours {
namespace {

constexpr std::size_t rows_per_chunk = 1 << 13;

// Cells one behind the other that are moved together, side by side; most are on a canvas.
constexpr std::size_t run = 16;

template <class Index>
bool are_in_a_row(const Index* cells) {
  bool consecutive = true;
  for (std::size_t i = 0; i < run; ++i) consecutive &= cells[i] == cells[0] + static_cast<Index>(i);
  return consecutive;
}

// Calls move(value of a plane's cell, value of a row) for every channel of some rows. Channels, if not 0, is how many
// there are, so that the compiler can lay loops over them side by side.
template <std::size_t Channels, class Value, class Row, class Index, class Move>
void move_rows(const Planes<Value>& planes, std::span<const Index> cells, Row* rows, const Move& move) {
  const std::size_t channels = Channels == 0 ? planes.channels : Channels;
  for (std::size_t row = 0; row < cells.size();) {
    Value* const first = planes.values + cells[row];
    Row* const own = rows + row * channels;
    if (Channels != 0 && row + run <= cells.size() && are_in_a_row(cells.data() + row)) {
      for (std::size_t i = 0; i < run; ++i)
        for (std::size_t channel = 0; channel < channels; ++channel)
          move(first[channel * planes.size + i], own[i * channels + channel]);
      row += run;
    } else {
      for (std::size_t channel = 0; channel < channels; ++channel) move(first[channel * planes.size], own[channel]);
      ++row;
    }
  }
}

template <class Value, class Row, class Index, class Move>
void move_all(const Planes<Value>& planes, std::span<const Index> cells, Row* rows, unsigned threads, const Move& move) {
  parallel_chunks(cells.size(), rows_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    const auto own = cells.subspan(begin, end - begin);
    if (planes.channels == 3)
      move_rows<3>(planes, own, rows + begin * planes.channels, move);
    else
      move_rows<0>(planes, own, rows + begin * planes.channels, move);
  });
}

}  // namespace

template <class Index>
void scatter(const Planes<float>& planes, std::span<const Index> cells, const float* rows, unsigned threads) {
  move_all(planes, cells, rows, threads, [](float& on_plane, float in_row) { on_plane = in_row; });
}

template <class Index>
void gather(const Planes<const float>& planes, std::span<const Index> cells, float* rows, unsigned threads) {
  move_all(planes, cells, rows, threads, [](float on_plane, float& in_row) { in_row = on_plane; });
}

template <class Value, class Index>
void copy_cells(const Planes<Value>& planes, std::span<const Index> cells, std::span<const Index> sources, unsigned threads) {
  parallel_chunks(cells.size(), rows_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    for (std::size_t channel = 0; channel < planes.channels; ++channel) {
      Value* const plane = planes.values + channel * planes.size;
      for (std::size_t i = begin; i < end; ++i) plane[cells[i]] = plane[sources[i]];
    }
  });
}

template void scatter(const Planes<float>&, std::span<const std::int32_t>, const float*, unsigned);
template void scatter(const Planes<float>&, std::span<const std::int64_t>, const float*, unsigned);
template void gather(const Planes<const float>&, std::span<const std::int32_t>, float*, unsigned);
template void gather(const Planes<const float>&, std::span<const std::int64_t>, float*, unsigned);
template void copy_cells(const Planes<float>&, std::span<const std::int32_t>, std::span<const std::int32_t>, unsigned);
template void copy_cells(const Planes<float>&, std::span<const std::int64_t>, std::span<const std::int64_t>, unsigned);
template void copy_cells(const Planes<std::int8_t>&, std::span<const std::int32_t>, std::span<const std::int32_t>, unsigned);
template void copy_cells(const Planes<std::int8_t>&, std::span<const std::int64_t>, std::span<const std::int64_t>, unsigned);

}  // namespace beltrami::colours
