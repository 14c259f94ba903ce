#include "atlas/cells.hpp"

#include <algorithm>
#include <cmath>

#include "atlas/scanlines.hpp"

namespace beltrami::atlas {
namespace {

// Minimum height of a face in texels to measure its spacing from them.
constexpr double thin = 2;

// Extends the marks by `margin` columns.
void widen(const std::uint8_t* marks, std::int64_t width, std::int64_t margin, std::uint8_t* widened) {
  std::int64_t marked = 0;
  for (std::int64_t x = 0; x < std::min(margin, width); ++x) marked += marks[x];
  for (std::int64_t x = 0; x < width; ++x) {
    if (x + margin < width) marked += marks[x + margin];
    widened[x] = marked > 0 ? 1 : 0;
    if (x - margin >= 0) marked -= marks[x - margin];
  }
}

}  // namespace

double halo_reach(std::int64_t margin) {
  // The distance of a corner of the square of cells around an owned cell, plus a tolerance for rounding.
  return std::sqrt(2.0) * static_cast<double>(margin) + 0.01;
}

Cells::Cells(const Blueprint& plan)
    : plan_(plan), reach_(halo_reach(plan.margin)), connections_(plan.mesh, plan.charts) {
  for (std::int64_t y = -plan.margin; y <= plan.margin; ++y)
    for (std::int64_t x = -plan.margin; x <= plan.margin; ++x)
      nearest_first_.push_back({static_cast<double>(x), static_cast<double>(y)});
  std::stable_sort(nearest_first_.begin(), nearest_first_.end(), [](Point2 a, Point2 b) { return dot(a, a) < dot(b, b); });
}

void Cells::make(const Band& band, std::span<const Index> borders, std::span<const Index> faces) {
  enter(band);
  find_owned();
  find_wanted();
  find_covered(faces);
  nearest_.find(plan_.mesh, plan_.charts, borders, block_, reach_, wanted_);
  const auto own_cells = static_cast<std::size_t>((band.bottom - band.top) * block_.width);
  const auto* owned = owned_.data() + plan_.margin * block_.width;
  std::size_t cell = 0;
  for (std::int64_t y = block_.y; y < block_.y + block_.height; ++y)
    for (std::int64_t i = 0; i < block_.width;) {
      if (owned[cell] != 0) {
        const std::int64_t begin = i;
        for (; i < block_.width && owned[cell] != 0; ++i) ++cell;
        make_owned(y, begin, i);
        continue;
      }
      if (covering_[cell] != none || nearest_[cell].border != none)
        make_halo(cell, {static_cast<double>(block_.x + i), static_cast<double>(y)}, cell < own_cells);
      ++cell;
      ++i;
    }
}

void Cells::enter(const Band& band) {
  rectangle_ = &plan_.layout.rectangles[static_cast<std::size_t>(band.rectangle)];
  window_ = &plan_.windows.windows[static_cast<std::size_t>(rectangle_->window)];
  grid_ = &plan_.mesh.surface->textures[static_cast<std::size_t>(window_->texture)];
  const std::int64_t rows = std::min(band.bottom + 1, rectangle_->height) - band.top;
  block_ = {rectangle_->x, rectangle_->y + band.top, rectangle_->width, rows};
  const auto cells = static_cast<std::size_t>(block_.width * block_.height);
  kinds_.assign(cells, Kind::empty);
  for (auto& coordinates : positions_) coordinates.resize(cells);
  faces_.resize(cells);
  nearness_.resize(cells);
  paths_.clear();
  halo.clear();
  gutter.clear();
}

void Cells::find_owned() {
  columns_.resize(static_cast<std::size_t>(block_.width));
  list_columns(*window_, *grid_, block_.x, columns_);
  owned_.assign(static_cast<std::size_t>((block_.height + 2 * plan_.margin) * block_.width), 0);
  auto* mark = owned_.data();
  for (std::int64_t y = block_.y - plan_.margin; y < block_.y + block_.height + plan_.margin; ++y) {
    if (y < window_->y || y >= window_->y + grid_->height) {
      mark += block_.width;
      continue;
    }
    const Index* row = plan_.ownership.window.data() + grid_->texel(0, wrapped(y, grid_->height, grid_->wrap_y));
    const Index window = rectangle_->window;
    for (const std::int32_t column : columns_) *mark++ = column != none && row[column] == window ? 1 : 0;
  }
}

void Cells::find_wanted() {
  const auto width = static_cast<std::size_t>(block_.width), margin = static_cast<std::size_t>(plan_.margin);
  const auto height = static_cast<std::size_t>(block_.height);
  std::vector<std::uint8_t> wide(owned_.size());
  std::vector<std::int32_t> marked(width, 0);
  wanted_.resize(width * height);
  for (std::size_t row = 0; row < height + 2 * margin; ++row) {
    std::uint8_t* last = wide.data() + row * width;
    widen(owned_.data() + row * width, block_.width, plan_.margin, last);
    for (std::size_t x = 0; x < width; ++x) marked[x] += last[x];
    if (row < 2 * margin) continue;
    const std::size_t middle = row - 2 * margin;  // of the rows summed; rows of the block start `margin` later
    const std::uint8_t *first = wide.data() + middle * width, *owned = owned_.data() + (middle + margin) * width;
    std::uint8_t* wanted = wanted_.data() + middle * width;
    for (std::size_t x = 0; x < width; ++x) wanted[x] = marked[x] > 0 && owned[x] == 0 ? 1 : 0;
    for (std::size_t x = 0; x < width; ++x) marked[x] -= first[x];
  }
}

void Cells::find_covered(std::span<const Index> faces) {
  covering_.assign(wanted_.size(), none);
  for (const Index face : faces)
    scan(plan_.mesh.texels[static_cast<std::size_t>(face)], block_.x, block_.x + block_.width, block_.y,
         block_.y + block_.height, [&](std::int64_t y, std::int64_t begin, std::int64_t end) {
           auto cell = static_cast<std::size_t>((y - block_.y) * block_.width + begin - block_.x);
           for (std::int64_t x = begin; x < end; ++x, ++cell) {
             if (wanted_[cell] == 0) continue;
             covering_[cell] = face;
             wanted_[cell] = 0;
           }
         });
}

// A run of owned cells, in columns [begin, end) of the block.
void Cells::make_owned(std::int64_t y, std::int64_t begin, std::int64_t end) {
  const std::int64_t row = grid_->texel(0, wrapped(y, grid_->height, grid_->wrap_y));
  const auto first = static_cast<std::size_t>((y - block_.y) * block_.width);
  const std::int32_t* columns = columns_.data();
  const Index* owners = plan_.ownership.face.data() + row;
  for (std::int64_t i = begin; i < end; ++i) faces_[first + static_cast<std::size_t>(i)] = owners[columns[i]];
  std::fill_n(kinds_.begin() + static_cast<std::ptrdiff_t>(first) + begin, end - begin, Kind::owned);
  std::uint8_t* nearness = nearness_.data() + first;
  for (std::int64_t i = begin; i < end; ++i) nearness[i] = plan_.near_borders.nearness(row + columns[i]);
  for (auto cell = first + static_cast<std::size_t>(begin); cell < first + static_cast<std::size_t>(end);) {
    const Index face = faces_[cell];
    const std::size_t start = cell;
    while (cell < first + static_cast<std::size_t>(end) && faces_[cell] == face) ++cell;
    place_on(face, start, cell);
  }
}

// Cells [begin, end) of a row, which lie in a face.
void Cells::place_on(Index face, std::size_t begin, std::size_t end) {
  const FaceMap map(plan_.mesh, face);
  const Point2 place = place_of(begin);
  double *x = positions_[0].data() + begin, *y = positions_[1].data() + begin, *z = positions_[2].data() + begin;
  const auto count = static_cast<std::int32_t>(end - begin);
  const auto at = [&](std::int32_t i) { return Point2{place.x + i, place.y}; };
  const auto place_all = [&](const auto& position_at) {
    for (std::int32_t i = 0; i < count; ++i) {
      const Point3 position = position_at(at(i));
      x[i] = position.x;
      y[i] = position.y;
      z[i] = position.z;
    }
  };
  // Points between two points of a face are in the face.
  if (map.holds(at(0)) && map.holds(at(count - 1)))
    place_all([&](Point2 p) { return map.extended(p); });
  else
    place_all([&](Point2 p) { return map.inside(p); });
}

void Cells::put(std::size_t cell, Point3 position) {
  positions_[0][cell] = position.x;
  positions_[1][cell] = position.y;
  positions_[2][cell] = position.z;
}

void Cells::make_halo(std::size_t cell, Point2 place, bool record) {
  std::optional<Sample> sample;
  Index seam = none;
  if (const Index face = covering_[cell]; face != none) {
    const FaceMap map(plan_.mesh, face);
    faces_[cell] = face;
    sample = stand_in(plan_, face, static_cast<std::int64_t>(place.x), static_cast<std::int64_t>(place.y),
                      map.inside(place));
  } else {
    seam = plan_.charts.borders[static_cast<std::size_t>(nearest_[cell].border)].seam;
    sample = continue_chart(cell, place);
  }
  if (!sample) return;
  kinds_[cell] = Kind::halo;
  put(cell, sample->position);
  nearness_[cell] = sample->near_open ? near_open | near_any : near_any;
  if (!record) return;
  const std::int64_t at = canvas_cell(place);
  halo.push_back({static_cast<Index>(at), sample->cells, sample->weights, seam});
  if (seam != none) record_gutter(cell, place, at);
}

// Follows the surface over the nearest border. If no texel shows it there, the colour comes from further on.
std::optional<Sample> Cells::continue_chart(std::size_t cell, Point2 place) {
  const Edge edge = plan_.charts.borders[static_cast<std::size_t>(nearest_[cell].border)].edge;
  const Plane plane = plane_at(edge, place);
  const Path path(plan_.mesh, edge, plane, place);
  faces_[cell] = none;
  if (path.end() != End::landed) return std::nullopt;
  const Landing landing = path.landing();
  auto sample = look_up(plan_, landing);
  const Point2 ahead = plane.across();
  for (std::int64_t i = 1; !sample && i <= plan_.margin; ++i) {
    const Path further(plan_.mesh, edge, plane, place + static_cast<double>(i) * ahead);
    if (further.end() != End::landed) break;
    sample = look_up(plan_, further.landing());
    if (sample) sample->position = position_of(plan_.mesh, landing);
  }
  if (sample && sample->near_open) {
    faces_[cell] = -1 - static_cast<Index>(paths_.size());
    paths_.push_back(path);
  }
  return sample;
}

Plane Cells::plane_at(Edge edge, Point2 place) const {
  Plane plane(plan_.mesh, edge);
  if (!plane.is_flat() || plane.thickness() >= thin) return plane;
  const Point2 inside = plane.foot(place) - plane.across();
  for (const Point2 step : nearest_first_) {
    const std::int64_t x = std::llround(inside.x + step.x) - block_.x, y = std::llround(inside.y + step.y) - block_.y;
    if (!is_owned(x, y)) continue;
    plane.correct(step_at(x, y, {1, 0}), step_at(x, y, {0, 1}));
    break;
  }
  return plane;
}

// The step in space from an owned cell to the next: from its neighbours, or from its face if it has none.
Point3 Cells::step_at(std::int64_t x, std::int64_t y, Point2 step) const {
  const auto right = static_cast<std::int64_t>(step.x), down = static_cast<std::int64_t>(step.y);
  const bool ahead = is_owned(x + right, y + down), behind = is_owned(x - right, y - down);
  const std::int64_t last_x = ahead ? x + right : x, last_y = ahead ? y + down : y;
  const std::int64_t first_x = behind ? x - right : x, first_y = behind ? y - down : y;
  if (ahead || behind)
    return (ahead && behind ? 0.5 : 1.0) * (owned_position(last_x, last_y) - owned_position(first_x, first_y));
  const Point2 place{static_cast<double>(block_.x + x), static_cast<double>(block_.y + y)};
  const FaceMap map(plan_.mesh, owned_face(x, y));
  return map.extended(place + step) - map.extended(place);
}

bool Cells::is_owned(std::int64_t x, std::int64_t y) const {
  return x >= 0 && x < block_.width && y >= -plan_.margin && y < block_.height + plan_.margin &&
         owned_[static_cast<std::size_t>((y + plan_.margin) * block_.width + x)] != 0;
}

Index Cells::owned_face(std::int64_t x, std::int64_t y) const {
  const auto texel = grid_->texel(columns_[static_cast<std::size_t>(x)], wrapped(block_.y + y, grid_->height, grid_->wrap_y));
  return plan_.ownership.face[static_cast<std::size_t>(texel)];
}

Point3 Cells::owned_position(std::int64_t x, std::int64_t y) const {
  const FaceMap map(plan_.mesh, owned_face(x, y));
  return map.inside({static_cast<double>(block_.x + x), static_cast<double>(block_.y + y)});
}

bool Cells::is_on(std::size_t cell, std::size_t other) const {
  const Index face = faces_[cell], other_face = faces_[other];
  if (face >= 0 && other_face >= 0)
    return face == other_face || connections_.inside(face, place_of(cell), other_face, place_of(other));
  if (((nearness_[cell] | nearness_[other]) & near_open) == 0) return true;
  if (face >= 0) return connections_.outwards(face, place_of(cell), place_of(other));
  if (other_face >= 0) return connections_.outwards(other_face, place_of(other), place_of(cell));
  const bool has_path = (nearness_[cell] & near_open) != 0;
  const Path& path = paths_[static_cast<std::size_t>(-1 - (has_path ? face : other_face))];
  return path.continued(plan_.mesh, place_of(has_path ? other : cell)) != End::open;
}

Point2 Cells::place_of(std::size_t cell) const {
  const auto index = static_cast<std::int64_t>(cell);
  return {static_cast<double>(block_.x + index % block_.width), static_cast<double>(block_.y + index / block_.width)};
}

std::int64_t Cells::canvas_cell(Point2 place) const {
  const std::int64_t row = rectangle_->row + static_cast<std::int64_t>(place.y) - rectangle_->y;
  return row * plan_.layout.columns + rectangle_->column + static_cast<std::int64_t>(place.x) - rectangle_->x;
}

void Cells::record_gutter(std::size_t cell, Point2 place, std::int64_t at) {
  const auto x = static_cast<std::int64_t>(place.x), y = static_cast<std::int64_t>(place.y);
  const auto is_off = [](std::int64_t i, std::int32_t size, Wrap wrap) {
    return wrap == Wrap::clamp && (i < 0 || i >= size);
  };
  if (is_off(x, grid_->width, grid_->wrap_x) || is_off(y, grid_->height, grid_->wrap_y)) return;
  const auto texel = grid_->texel(wrapped(x, grid_->width, grid_->wrap_x), wrapped(y, grid_->height, grid_->wrap_y));
  if (plan_.ownership.window[static_cast<std::size_t>(texel)] != none) return;
  gutter.push_back({texel, nearest_[cell].squared_distance, at, window_->chart});
}

}  // namespace beltrami::atlas
