#include "atlas/ownership.hpp"

#include <algorithm>
#include <cmath>

#include "atlas/scanlines.hpp"

namespace beltrami::atlas {
namespace {

// Precision of a single-precision coordinate near 1 of a texture of 1,024 texels.
constexpr double on_edge = 1e-4;

constexpr std::int64_t texels_per_poll = 1 << 22;

class Rasteriser {
 public:
  Rasteriser(const Mesh& mesh, const Charts& charts, const Windows& windows, const Allocate& allocate, const Poll& poll)
      : mesh_(mesh), charts_(charts), windows_(windows), poll_(poll) {
    const auto texels = static_cast<std::size_t>(mesh.surface->texel_count());
    for (Array<Index>* array : {&result_.window, &result_.face}) {
      *array = Array<Index>(texels, allocate);
      constexpr std::size_t step = texels_per_poll;
      for (std::size_t begin = 0; begin < texels; begin += step) {
        std::fill(array->data() + begin, array->data() + std::min(texels, begin + step), none);
        poll_after(texels_per_poll);
      }
    }
    result_.extents.resize(windows.windows.size());
    result_.overlapping.assign(charts.size(), 0);
    overlapped_.assign(texels, false);
    covered_in_.assign(mesh.surface->textures.size(), 0);
    overlapped_in_.assign(mesh.surface->textures.size(), 0);
  }

  Ownership rasterise() {
    for (std::size_t i = 0; i < windows_.windows.size(); ++i) rasterise_faces(i);
    for (std::size_t i = 0; i < windows_.windows.size(); ++i) rasterise_borders(i);
    for (const auto count : covered_in_) result_.covered += count;
    for (const auto count : overlapped_in_) result_.overlapped += count;
    return std::move(result_);
  }

 private:
  bool is_full(const Window& window, const std::vector<std::int64_t>& counts) const {
    const Texture& grid = grid_of(window);
    return counts[static_cast<std::size_t>(window.texture)] == static_cast<std::int64_t>(grid.width) * grid.height;
  }

  const Texture& grid_of(const Window& window) const {
    return mesh_.surface->textures[static_cast<std::size_t>(window.texture)];
  }

  void rasterise_faces(std::size_t index) {
    const Window& window = windows_.windows[index];
    const Texture& grid = grid_of(window);
    if (is_full(window, overlapped_in_)) {  // nothing is left to find out here
      result_.overlapping[static_cast<std::size_t>(window.chart)] = 1;
      return;
    }
    for (std::size_t i = window.begin; i < window.end; ++i) {
      const Index face = windows_.faces[i];
      scan(mesh_.texels[static_cast<std::size_t>(face)], window.x, window.x + grid.width, window.y,
           window.y + grid.height,
           [&](std::int64_t y, std::int64_t begin, std::int64_t end) { claim_run(index, face, y, begin, end); });
    }
  }

  void claim_run(std::size_t index, Index face, std::int64_t y, std::int64_t begin, std::int64_t end) {
    const Window& window = windows_.windows[index];
    const Texture& grid = grid_of(window);
    const auto row = static_cast<std::size_t>(grid.texel(0, wrapped(y, grid.height, grid.wrap_y)));
    poll_after(end - begin);
    std::int32_t column = wrapped(begin, grid.width, grid.wrap_x);
    const bool backwards = grid.wrap_x == Wrap::mirror && unwrapped(0, window.x, grid.width, grid.wrap_x) != window.x;
    const auto count = static_cast<std::size_t>(end - begin);
    const std::size_t first = row + static_cast<std::size_t>(column) - (backwards ? count - 1 : 0);
    const bool goes_round = !backwards && static_cast<std::int64_t>(column) + (end - begin) > grid.width;
    if (!goes_round && claim_whole(index, face, first, count)) {
      result_.extents[index].add(begin, y);
      result_.extents[index].add(end - 1, y);
      return;
    }
    const std::int32_t step = backwards ? -1 : 1;
    for (std::int64_t x = begin; x < end; ++x, column += step) {
      if (column == grid.width) column = 0;
      claim(index, face, row + static_cast<std::size_t>(column), x, y);
    }
  }

  // Claims a run of texels if none of them is owned.
  bool claim_whole(std::size_t index, Index face, std::size_t first, std::size_t count) {
    Index* const owners = result_.window.data() + first;
    if (std::any_of(owners, owners + count, [](Index owner) { return owner != none; })) return false;
    std::fill(owners, owners + count, static_cast<Index>(index));
    Index* const faces = result_.face.data() + first;
    std::fill(faces, faces + count, face);
    covered_in_[static_cast<std::size_t>(windows_.windows[index].texture)] += static_cast<std::int64_t>(count);
    return true;
  }

  // Polls every few million texels.
  void poll_after(std::int64_t texels) {
    since_poll_ += texels;
    if (since_poll_ < texels_per_poll) return;
    since_poll_ = 0;
    if (poll_ && !poll_(0)) throw Cancelled();
  }

  void claim(std::size_t index, Index face, std::size_t texel, std::int64_t x, std::int64_t y) {
    const Window& window = windows_.windows[index];
    Index& owner = result_.window[texel];
    if (owner == none) {
      owner = static_cast<Index>(index);
      result_.face[texel] = face;
      result_.extents[index].add(x, y);
      ++covered_in_[static_cast<std::size_t>(window.texture)];
      return;
    }
    if (owner != static_cast<Index>(index)) result_.overlapping[static_cast<std::size_t>(window.chart)] = 1;
    if (overlapped_[texel]) return;
    overlapped_[texel] = true;
    ++overlapped_in_[static_cast<std::size_t>(window.texture)];
  }

  void rasterise_borders(std::size_t index) {
    const Window& window = windows_.windows[index];
    if (is_full(window, covered_in_)) return;
    const auto chart = static_cast<std::size_t>(window.chart);
    for (Index i = charts_.border_offsets[chart]; i < charts_.border_offsets[chart + 1]; ++i)
      rasterise_border(index, charts_.borders[static_cast<std::size_t>(i)].edge);
  }

  void rasterise_border(std::size_t index, Edge edge) {
    const Window& window = windows_.windows[index];
    const Texture& grid = grid_of(window);
    const auto [a, b] = mesh_.ends(edge);
    const bool upright = std::abs(b.y - a.y) >= std::abs(b.x - a.x);
    const double from = upright ? a.y : a.x, to = upright ? b.y : b.x;
    const double across_from = upright ? a.x : a.y, across_to = upright ? b.x : b.y;
    const auto start = static_cast<double>(upright ? window.y : window.x);
    const double size = upright ? grid.height : grid.width;
    const double first = std::max(std::ceil(std::min(from, to) - on_edge), start);
    const double last = std::min(std::floor(std::max(from, to) + on_edge), start + size - 1);
    for (double along = first; along <= last; ++along) {
      const double t = from == to ? 0 : std::clamp((along - from) / (to - from), 0.0, 1.0);
      const double across = across_from + t * (across_to - across_from), nearest = std::nearbyint(across);
      if (std::abs(across - nearest) > on_edge) continue;
      claim_point(index, edge / 3, static_cast<std::int64_t>(upright ? nearest : along),
                  static_cast<std::int64_t>(upright ? along : nearest));
    }
  }

  void claim_point(std::size_t index, Index face, std::int64_t x, std::int64_t y) {
    const Window& window = windows_.windows[index];
    const Texture& grid = grid_of(window);
    if (x < window.x || x >= window.x + grid.width || y < window.y || y >= window.y + grid.height) return;
    if (doubled_area(mesh_.texels[static_cast<std::size_t>(face)]) == 0) return;
    const auto texel = static_cast<std::size_t>(
        grid.texel(wrapped(x, grid.width, grid.wrap_x), wrapped(y, grid.height, grid.wrap_y)));
    if (result_.window[texel] == none) claim(index, face, texel, x, y);
  }

  const Mesh& mesh_;
  const Charts& charts_;
  const Windows& windows_;
  const Poll& poll_;
  std::int64_t since_poll_ = 0;
  Ownership result_;
  std::vector<bool> overlapped_;
  std::vector<std::int64_t> covered_in_, overlapped_in_;  // [texture]
};

}  // namespace

void Extent::add(std::int64_t x, std::int64_t y) {
  if (empty()) {
    *this = {x, y, x, y};
    return;
  }
  first_x = std::min(first_x, x);
  last_x = std::max(last_x, x);
  first_y = std::min(first_y, y);
  last_y = std::max(last_y, y);
}

Ownership make_ownership(const Mesh& mesh, const Charts& charts, const Windows& windows, const Allocate& allocate,
                         const Poll& poll) {
  return Rasteriser(mesh, charts, windows, allocate, poll).rasterise();
}

}  // namespace beltrami::atlas
