#include "atlas/footprint.hpp"

#include <algorithm>

namespace beltrami::atlas {
namespace {

// Calls visit(begin, end) for the runs of a row that are owned; is_owned(i) for columns i in [0, width).
template <class IsOwned, class Visit>
void visit_runs(std::int64_t width, const IsOwned& is_owned, const Visit& visit) {
  for (std::int64_t begin = 0; begin < width;) {
    while (begin < width && !is_owned(begin)) ++begin;
    std::int64_t end = begin;
    while (end < width && is_owned(end)) ++end;
    if (begin < end) visit(begin, end);
    begin = end;
  }
}

void set(std::uint64_t* row, std::int64_t first, std::int64_t last) {
  for (std::int64_t i = first; i <= last; ++i) row[i / 64] |= std::uint64_t{1} << (i % 64);
}

}  // namespace

Bits make_footprint(const Mesh& mesh, const Windows& windows, const Ownership& ownership, const Rectangle& rectangle,
                    std::int64_t margin, std::int64_t block) {
  Bits footprint((rectangle.height + block - 1) / block, (rectangle.width + block - 1) / block);
  const Window& window = windows.windows[static_cast<std::size_t>(rectangle.window)];
  const Texture& grid = mesh.surface->textures[static_cast<std::size_t>(window.texture)];
  const std::int64_t left = rectangle.x + margin, width = rectangle.width - 2 * margin;
  const bool wraps = left < 0 || left + width > grid.width;
  for (std::int64_t y = margin; y < rectangle.height - margin; ++y) {
    const Index* texels = ownership.window.data() + grid.texel(0, wrapped(rectangle.y + y, grid.height, grid.wrap_y));
    const auto mark = [&](std::int64_t begin, std::int64_t end) {  // owned columns, from the margin on
      for (std::int64_t row = (y - margin) / block; row <= (y + margin) / block; ++row)
        set(footprint.row(row), begin / block, (end - 1 + 2 * margin) / block);
    };
    if (wraps)
      visit_runs(width, [&](std::int64_t i) { return texels[wrapped(left + i, grid.width, grid.wrap_x)] == rectangle.window; }, mark);
    else
      visit_runs(width, [&](std::int64_t i) { return texels[left + i] == rectangle.window; }, mark);
  }
  return footprint;
}

}  // namespace beltrami::atlas
