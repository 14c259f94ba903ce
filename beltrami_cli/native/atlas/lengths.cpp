#include "atlas/lengths.hpp"

#include <cstring>

namespace beltrami::atlas {
namespace {

float squared_length(Point3 a, Point3 b) { return static_cast<float>(dot(a - b, a - b)); }

}  // namespace

void Lengths::measure(const Cells& cells, std::size_t local, bool has_below, std::size_t start, std::vector<Index>& cuts) {
  const auto width = static_cast<std::size_t>(cells.width());
  const std::size_t columns = planes_.columns, below = local + width;
  plain_.assign(width, 0);
  if (has_below) find_plain(cells, local, width);
  for (std::size_t x = 0; x < width; ++x) {
    if (plain_[x] != 0) {
      // The last one never is.
      const auto* end = static_cast<const std::uint8_t*>(std::memchr(&plain_[x], 0, width - x));
      const std::size_t first = x;
      x = static_cast<std::size_t>(end - plain_.data());
      measure_plain(cells, local, start, first, x--);
      continue;
    }
    if (cells.kind(local + x) == Kind::empty) continue;
    const auto measure_to = [&](std::size_t which, std::size_t neighbour, std::size_t step) {
      if (cells.kind(neighbour) == Kind::empty) return;
      if (!cells.are_joined(local + x, neighbour)) {
        for (const std::size_t cell : {start + x, start + x + step}) cuts.push_back(static_cast<Index>(cell));
        return;
      }
      planes_.lengths[which * planes_.plane + start + x] =
          squared_length(cells.position(local + x), cells.position(neighbour));
    };
    if (x + 1 < width) measure_to(0, local + x + 1, 1);
    if (!has_below) continue;
    measure_to(1, below + x, columns);
    if (x + 1 < width) measure_to(2, below + x + 1, columns + 1);
    if (x > 0) measure_to(3, below + x - 1, columns - 1);
  }
}

// Marks cells without empty cells around them, in their row and the next, from which the surface continues everywhere.
void Lengths::find_plain(const Cells& cells, std::size_t local, std::size_t width) {
  const Kind *row = cells.kinds() + local, *below = row + width;
  const std::uint8_t* nearness = cells.nearness() + local;
  std::uint8_t* plain = plain_.data();
  for (std::size_t x = 1; x + 1 < width; ++x)
    plain[x] = (nearness[x] == 0) & (row[x] != Kind::empty) & (row[x + 1] != Kind::empty) & (below[x - 1] != Kind::empty) &
               (below[x] != Kind::empty) & (below[x + 1] != Kind::empty);
}

// One direction at a time, so that neighbouring cells are vectorised.
void Lengths::measure_plain(const Cells& cells, std::size_t local, std::size_t start, std::size_t begin, std::size_t end) {
  const auto width = static_cast<std::size_t>(cells.width());
  const std::size_t steps[] = {1, width, width + 1, width - 1};
  const double *x = cells.coordinates(0) + local, *y = cells.coordinates(1) + local, *z = cells.coordinates(2) + local;
  for (std::size_t which = 0; which < 4; ++which) {
    const std::size_t step = steps[which];
    float* lengths = planes_.lengths + which * planes_.plane + start;
    for (std::size_t i = begin; i < end; ++i) {
      const Point3 difference{x[i] - x[i + step], y[i] - y[i + step], z[i] - z[i + step]};
      lengths[i] = static_cast<float>(dot(difference, difference));
    }
  }
}

}  // namespace beltrami::atlas
