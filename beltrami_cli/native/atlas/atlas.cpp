#include "atlas/atlas.hpp"

#include <algorithm>
#include <iterator>
#include <limits>
#include <span>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "atlas/cells.hpp"
#include "atlas/charts.hpp"
#include "atlas/layout.hpp"
#include "atlas/lengths.hpp"
#include "atlas/looked_up.hpp"
#include "atlas/ownership.hpp"
#include "atlas/windows.hpp"
#include "parallel.hpp"

namespace beltrami::atlas {
namespace {

// Small bands are grouped, since one alone is too little work for a thread.
constexpr std::size_t bands_per_chunk = 8;
constexpr std::size_t cells_per_chunk = 1 << 20;
// In `Atlas::kind`.
constexpr auto owned_kind = static_cast<std::uint8_t>(Kind::owned), halo_kind = static_cast<std::uint8_t>(Kind::halo);

// Owned cells in a row of a rectangle: columns [begin, end).
struct Run {
  std::int64_t row;
  std::size_t begin, end;
};

class Builder {
 public:
  Builder(const Blueprint& plan, std::vector<LookedUp> looked_up, unsigned threads, const Allocate& allocate,
          const Poll& poll)
      : plan_(plan), looked_up_(std::move(looked_up)), threads_(threads), allocate_(allocate), poll_(poll),
        bands_(make_bands(plan, halo_reach(plan.margin))) {}

  Atlas build() {
    prepare_canvas();
    runs_.resize(bands_.bands.size());
    halo_.resize(bands_.bands.size());
    gutter_.resize(bands_.bands.size());
    cuts_.resize(bands_.bands.size());
    parallel_chunks(bands_.bands.size(), bands_per_chunk, threads_, [&](std::size_t begin, std::size_t end, unsigned) {
      Cells cells(plan_);
      Lengths lengths({atlas_.squared_lengths.data(), atlas_.kind.size, static_cast<std::size_t>(atlas_.columns)});
      for (std::size_t band = begin; band < end; ++band) build_band(cells, lengths, band);
    }, poll_);
    list_cells();
    parallel_chunks(bands_.bands.size(), bands_per_chunk, threads_, [&](std::size_t begin, std::size_t end, unsigned) {
      for (std::size_t band = begin; band < end; ++band) fill_lists(band);
    }, poll_);
    list_gutter();
    list_looked_up();
    list_cuts();
    count();
    return std::move(atlas_);
  }

 private:
  void prepare_canvas() {
    atlas_.rows = plan_.layout.rows;
    atlas_.columns = plan_.layout.columns;
    const auto cells = static_cast<std::size_t>(atlas_.rows * atlas_.columns);
    atlas_.kind = Array<std::uint8_t>(cells, allocate_);
    atlas_.squared_lengths = Array<float>(4 * cells, allocate_);
    parallel_chunks(cells, cells_per_chunk, threads_, [&](std::size_t begin, std::size_t end, unsigned) {
      std::fill(&atlas_.kind[0] + begin, &atlas_.kind[0] + end, std::uint8_t{0});
      std::fill(&atlas_.squared_lengths[0] + 4 * begin, &atlas_.squared_lengths[0] + 4 * end,
                std::numeric_limits<float>::infinity());
    }, poll_);
  }

  const Rectangle& rectangle_of(const Band& band) const {
    return plan_.layout.rectangles[static_cast<std::size_t>(band.rectangle)];
  }

  // The canvas cell at which a row of a band starts.
  std::size_t row_start(const Band& band, std::int64_t row) const {
    const Rectangle& rectangle = rectangle_of(band);
    return static_cast<std::size_t>((rectangle.row + row) * atlas_.columns + rectangle.column);
  }

  void build_band(Cells& cells, Lengths& lengths, std::size_t index) {
    const Band& band = bands_.bands[index];
    cells.make(band, bands_.borders_of(index), bands_.faces_of(index));
    for (std::int64_t row = band.top; row < band.bottom; ++row) {
      const auto local = static_cast<std::size_t>((row - band.top) * cells.width());
      const auto width = static_cast<std::size_t>(cells.width());
      const std::size_t start = row_start(band, row);
      const Kind* kinds = cells.kinds() + local;
      std::uint8_t* kind = atlas_.kind.data() + start;
      for (std::size_t x = 0; x < width; ++x)  // an empty cell may belong to another rectangle
        if (kinds[x] != Kind::empty) kind[x] = static_cast<std::uint8_t>(kinds[x]);
      list_runs({kinds, width}, row, runs_[index]);
      lengths.measure(cells, local, row - band.top + 1 < cells.height(), start, cuts_[index]);
    }
    halo_[index].assign(cells.halo.begin(), cells.halo.end());
    gutter_[index].assign(cells.gutter.begin(), cells.gutter.end());
  }

  static void list_runs(std::span<const Kind> kinds, std::int64_t row, std::vector<Run>& runs) {
    for (auto begin = kinds.begin(); begin != kinds.end();) {
      begin = std::find(begin, kinds.end(), Kind::owned);
      const auto end = std::find_if(begin, kinds.end(), [](Kind kind) { return kind != Kind::owned; });
      if (begin != end)
        runs.push_back({row, static_cast<std::size_t>(begin - kinds.begin()), static_cast<std::size_t>(end - kinds.begin())});
      begin = end;
    }
  }

  void list_cells() {
    std::size_t owned = 0, halo = 0;
    for_each_chunk([&](const std::uint8_t* begin, const std::uint8_t* end) {
      owned += static_cast<std::size_t>(std::count(begin, end, owned_kind));
      halo += static_cast<std::size_t>(std::count(begin, end, halo_kind));
    });
    atlas_.owned_cells = Array<Index>(owned, allocate_);
    atlas_.owned_texels = Array<Index>(owned, allocate_);
    atlas_.chart_of = Array<Index>(owned, allocate_);
    atlas_.halo_cells = Array<Index>(halo, allocate_);
    atlas_.halo_taps = Array<Index>(4 * halo, allocate_);
    atlas_.halo_weights = Array<float>(4 * halo, allocate_);
    atlas_.halo_seams = Array<Index>(halo, allocate_);
    Index *next_owned = atlas_.owned_cells.data(), *next_halo = atlas_.halo_cells.data();
    for_each_chunk([&](const std::uint8_t* begin, const std::uint8_t* end) {
      for (const std::uint8_t* kind = begin; kind < end; ++kind) {
        if (*kind == owned_kind) *next_owned++ = static_cast<Index>(kind - atlas_.kind.data());
        if (*kind == halo_kind) *next_halo++ = static_cast<Index>(kind - atlas_.kind.data());
      }
    });
  }

  // Calls visit(begin, end) for blocks of cells, and polls in between.
  template <class Visit>
  void for_each_chunk(const Visit& visit) const {
    for (std::size_t cell = 0; cell < atlas_.kind.size; cell += 4 * cells_per_chunk) {
      if (poll_ && !poll_(0)) throw Cancelled();
      visit(atlas_.kind.data() + cell, atlas_.kind.data() + std::min(cell + 4 * cells_per_chunk, atlas_.kind.size));
    }
  }

  static std::size_t rank(const Array<Index>& cells, std::size_t cell) {
    const auto* begin = cells.data();
    return static_cast<std::size_t>(std::lower_bound(begin, begin + cells.size, static_cast<Index>(cell)) - begin);
  }

  void fill_lists(std::size_t index) {
    const Band& band = bands_.bands[index];
    const Rectangle& rectangle = rectangle_of(band);
    const Window& window = plan_.windows.windows[static_cast<std::size_t>(rectangle.window)];
    const Texture& grid = plan_.mesh.surface->textures[static_cast<std::size_t>(window.texture)];
    std::vector<std::int32_t> columns(static_cast<std::size_t>(rectangle.width));
    list_columns(window, grid, rectangle.x, columns);
    for (const Run& run : runs_[index]) {
      const std::int64_t row = grid.texel(0, wrapped(rectangle.y + run.row, grid.height, grid.wrap_y));
      const std::size_t first = rank(atlas_.owned_cells, row_start(band, run.row) + run.begin);
      for (std::size_t i = 0; i < run.end - run.begin; ++i) {
        atlas_.owned_texels[first + i] = static_cast<Index>(row + columns[run.begin + i]);
        atlas_.chart_of[first + i] = window.chart;
      }
    }
    std::size_t next = 0;
    for (const HaloCell& cell : halo_[index]) {
      if (next >= atlas_.halo_cells.size || atlas_.halo_cells[next] != cell.cell)
        next = rank(atlas_.halo_cells, static_cast<std::size_t>(cell.cell));
      std::copy(cell.taps.begin(), cell.taps.end(), &atlas_.halo_taps[0] + 4 * next);
      std::copy(cell.weights.begin(), cell.weights.end(), &atlas_.halo_weights[0] + 4 * next);
      atlas_.halo_seams[next++] = cell.seam;
    }
    runs_[index] = {};
    halo_[index] = {};
  }

  bool is_free_for(std::int64_t texel, Index chart) const {
    const auto found = std::lower_bound(looked_up_.begin(), looked_up_.end(), texel,
                                        [](const LookedUp& each, std::int64_t wanted) { return each.texel < wanted; });
    return found == looked_up_.end() || found->texel != texel || found->chart == several || found->chart == chart;
  }

  // Each uncovered texel gets the cell of the nearest chart; if one chart looks it up, the cell of that chart.
  void list_gutter() {
    std::vector<GutterCell> all;
    for (const auto& part : gutter_)
      std::copy_if(part.begin(), part.end(), std::back_inserter(all),
                   [&](const GutterCell& cell) { return is_free_for(cell.texel, cell.chart); });
    gutter_ = {};
    std::sort(all.begin(), all.end(), [](const GutterCell& a, const GutterCell& b) {
      return std::tie(a.texel, a.squared_distance, a.cell) < std::tie(b.texel, b.squared_distance, b.cell);
    });
    all.erase(std::unique(all.begin(), all.end(),
                          [](const GutterCell& a, const GutterCell& b) { return a.texel == b.texel; }),
              all.end());
    atlas_.gutter_cells = Array<Index>(all.size(), allocate_);
    atlas_.gutter_texels = Array<Index>(all.size(), allocate_);
    for (std::size_t i = 0; i < all.size(); ++i) {
      atlas_.gutter_cells[i] = static_cast<Index>(all[i].cell);
      atlas_.gutter_texels[i] = static_cast<Index>(all[i].texel);
    }
  }

  void list_looked_up() {
    const auto alone = std::count_if(looked_up_.begin(), looked_up_.end(),
                                     [](const LookedUp& each) { return each.chart == lone; });
    atlas_.lone_texels = Array<Index>(static_cast<std::size_t>(alone), allocate_);
    atlas_.border_texels = Array<Index>(looked_up_.size() - atlas_.lone_texels.size, allocate_);
    Index *next_lone = atlas_.lone_texels.data(), *next_border = atlas_.border_texels.data();
    for (const LookedUp& each : looked_up_)
      *(each.chart == lone ? next_lone : next_border)++ = static_cast<Index>(each.texel);
  }

  void list_cuts() {
    std::vector<Index> all;
    for (const auto& part : cuts_) all.insert(all.end(), part.begin(), part.end());
    std::sort(all.begin(), all.end());
    all.erase(std::unique(all.begin(), all.end()), all.end());
    atlas_.cut_cells = Array<Index>(all.size(), allocate_);
    std::copy(all.begin(), all.end(), atlas_.cut_cells.data());
  }

  void count() {
    atlas_.charts = static_cast<std::int64_t>(plan_.charts.size());
    atlas_.seams = plan_.charts.seams;
    atlas_.covered = plan_.ownership.covered;
    atlas_.overlapped = plan_.ownership.overlapped;
  }

  const Blueprint& plan_;
  std::vector<LookedUp> looked_up_;
  unsigned threads_;
  const Allocate& allocate_;
  const Poll& poll_;
  Bands bands_;
  std::vector<std::vector<Run>> runs_;           // [band]
  std::vector<std::vector<HaloCell>> halo_;      // [band]
  std::vector<std::vector<GutterCell>> gutter_;  // [band]
  std::vector<std::vector<Index>> cuts_;         // [band]
  Atlas atlas_;
};

}  // namespace

Atlas make_atlas(const Surface& surface, std::int64_t margin, unsigned threads, const Allocate& allocate,
                 const Poll& poll) {
  if (margin < 1) throw std::invalid_argument("the margin must be at least one cell");
  if (surface.texel_count() > std::numeric_limits<Index>::max())
    throw std::length_error("the textures have more than 2^31 texels together");
  const Mesh mesh = make_mesh(surface);
  const Charts charts = make_charts(mesh);
  const Windows windows = make_windows(mesh, charts);
  const Ownership ownership = make_ownership(mesh, charts, windows, allocate, poll);
  const Layout layout = make_layout(mesh, windows, ownership, margin, poll);
  const NearBorders near_borders(mesh, charts);
  auto looked_up = find_looked_up(mesh, charts, windows, ownership, poll);
  const Blueprint plan{mesh, charts, windows, ownership, layout, near_borders, margin};
  return Builder(plan, std::move(looked_up), threads, allocate, poll).build();
}

}  // namespace beltrami::atlas
