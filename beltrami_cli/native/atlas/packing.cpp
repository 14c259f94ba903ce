#include "atlas/packing.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <numeric>
#include <span>

namespace beltrami::atlas {
namespace {

// Candidate widths, relative to the side of a square of the shapes' area; with many shapes, only the first ones.
constexpr std::array relative_widths{1.0, 1.15, 1.3, 1.6, 2.0, 2.5};
constexpr std::size_t many_shapes = 256, widths_for_many = 2;

// A run of bits in a shape's row.
struct RunOfBits {
  std::int64_t row, first, length;
};

std::vector<RunOfBits> runs_of(const Bits& shape) {
  std::vector<RunOfBits> runs;
  const auto is_set = [&](std::int64_t row, std::int64_t i) { return (shape.row(row)[i / 64] >> (i % 64) & 1) != 0; };
  for (std::int64_t row = 0; row < shape.rows; ++row)
    for (std::int64_t first = 0; first < shape.columns;) {
      std::int64_t end = first;
      while (end < shape.columns && is_set(row, end)) ++end;
      if (end > first) runs.push_back({row, first, end - first});
      first = std::max(end, first + 1);
    }
  // Long runs rule out most places.
  std::stable_sort(runs.begin(), runs.end(), [](const RunOfBits& a, const RunOfBits& b) { return a.length > b.length; });
  return runs;
}

class Canvas {
 public:
  explicit Canvas(std::int64_t columns)
      : columns_(columns), words_(static_cast<std::size_t>((columns + 63) / 64)), blocked_(words_), shifted_(words_) {}

  std::int64_t rows() const { return static_cast<std::int64_t>(longest_.size()); }

  Spot place(const Bits& shape) {
    const auto runs = runs_of(shape);
    for (std::int64_t row = 0;; ++row) {
      while (rows() < row + shape.rows) add_row();
      const std::int64_t column = find_column(shape, runs, row);
      if (column < 0) continue;
      for (const RunOfBits& run : runs) fill(row + run.row, column + run.first, run.length);
      return {row, column};
    }
  }

 private:
  void add_row() {
    taken_.resize(taken_.size() + words_, 0);
    longest_.push_back(columns_);
  }

  std::uint64_t* taken(std::int64_t row) { return taken_.data() + static_cast<std::size_t>(row) * words_; }

  // Returns the first column at which no run overlaps an occupied cell; -1 if there is none.
  std::int64_t find_column(const Bits& shape, const std::vector<RunOfBits>& runs, std::int64_t row) {
    for (const RunOfBits& run : runs)
      if (run.length > longest_[static_cast<std::size_t>(row + run.row)]) return -1;
    // Columns beyond the last one possible are blocked from the start.
    for (std::size_t word = 0; word < words_; ++word) {
      const std::int64_t first = 64 * static_cast<std::int64_t>(word);
      const std::int64_t open = std::clamp<std::int64_t>(columns_ - shape.columns + 1 - first, 0, 64);
      blocked_[word] = open == 64 ? 0 : ~std::uint64_t{0} << open;
    }
    for (const RunOfBits& run : runs)
      if (!block(run, row)) return -1;
    for (std::size_t word = 0; word < words_; ++word)
      if (blocked_[word] != ~std::uint64_t{0})
        return 64 * static_cast<std::int64_t>(word) + std::countr_one(blocked_[word]);
    return -1;
  }

  // Marks the columns at which a run would overlap an occupied cell; returns whether any column is left.
  bool block(const RunOfBits& run, std::int64_t row) {
    const std::uint64_t* from = taken(row + run.row);
    shift_down(from, run.first, shifted_.data());
    for (std::int64_t covered = 1; covered < run.length;) {
      const std::int64_t step = std::min(covered, run.length - covered);
      add_shifted(shifted_.data(), step);
      covered += step;
    }
    std::uint64_t all = ~std::uint64_t{0};
    for (std::size_t word = 0; word < words_; ++word) all &= blocked_[word] |= shifted_[word];
    return all != ~std::uint64_t{0};
  }

  void shift_down(const std::uint64_t* from, std::int64_t by, std::uint64_t* to) const {
    const auto words = static_cast<std::size_t>(by / 64);
    const int bits = static_cast<int>(by % 64);
    for (std::size_t i = 0; i < words_; ++i) to[i] = shifted_word(from, i + words, bits);
  }

  // Words are read before they are written: later ones are still unchanged.
  void add_shifted(std::uint64_t* words, std::int64_t by) const {
    const auto skipped = static_cast<std::size_t>(by / 64);
    const int bits = static_cast<int>(by % 64);
    for (std::size_t i = 0; i < words_; ++i) words[i] |= shifted_word(words, i + skipped, bits);
  }

  std::uint64_t shifted_word(const std::uint64_t* from, std::size_t word, int bits) const {
    const std::uint64_t low = word < words_ ? from[word] : 0, high = word + 1 < words_ ? from[word + 1] : 0;
    return bits == 0 ? low : low >> bits | high << (64 - bits);
  }

  void fill(std::int64_t row, std::int64_t first, std::int64_t length) {
    std::uint64_t* words = taken(row);
    for (std::int64_t i = first; i < first + length; ++i) words[i / 64] |= std::uint64_t{1} << (i % 64);
    std::int64_t longest = 0, free = 0;
    for (std::int64_t i = 0; i < columns_; ++i) {
      free = (words[i / 64] >> (i % 64) & 1) != 0 ? 0 : free + 1;
      longest = std::max(longest, free);
    }
    longest_[static_cast<std::size_t>(row)] = longest;
  }

  std::int64_t columns_;
  std::size_t words_;
  std::vector<std::uint64_t> taken_, blocked_, shifted_;
  std::vector<std::int64_t> longest_;  // [row]: free columns side by side
};

Packing pack_into(std::span<const Bits> shapes, const std::vector<std::size_t>& order, std::int64_t columns) {
  Packing packing;
  packing.spots.resize(shapes.size());
  Canvas canvas(columns);
  for (const std::size_t i : order) {
    packing.spots[i] = canvas.place(shapes[i]);
    packing.columns = std::max(packing.columns, packing.spots[i].column + shapes[i].columns);
  }
  packing.rows = canvas.rows();
  return packing;
}

}  // namespace

Packing pack(std::span<const Bits> shapes) {
  std::vector<std::size_t> order(shapes.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return shapes[a].rows > shapes[b].rows; });
  double area = 0;
  std::int64_t widest = 1;
  for (const Bits& shape : shapes) {
    for (const std::uint64_t word : shape.words) area += std::popcount(word);
    widest = std::max(widest, shape.columns);
  }
  Packing best;
  const std::size_t widths = shapes.size() > many_shapes ? widths_for_many : relative_widths.size();
  for (const double relative : std::span(relative_widths).first(widths)) {
    const auto columns = std::max(widest, static_cast<std::int64_t>(std::ceil(relative * std::sqrt(area))));
    auto packing = pack_into(shapes, order, columns);
    if (best.spots.empty() || packing.rows * packing.columns < best.rows * best.columns) best = std::move(packing);
  }
  return best;
}

}  // namespace beltrami::atlas
