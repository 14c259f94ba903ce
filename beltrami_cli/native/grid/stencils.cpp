#include "grid/stencils.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "parallel.hpp"

namespace beltrami::grid {
namespace {

using triangulated::FoundSplit;
using triangulated::none;
using triangulated::Partner;
using triangulated::Stencils;

double squared(double x) { return x * x; }

class ImageGrid {
 public:
  ImageGrid(const Grid& grid, Planes metric, float beta) : grid_(grid), metric_(metric), beta_(beta) {}

  // The cell at an offset; empty outside the grid and for empty cells.
  std::optional<std::size_t> at(std::size_t cell, Offset offset) const {
    const auto row = static_cast<std::ptrdiff_t>(cell / grid_.columns) + offset.y;
    const auto column = static_cast<std::ptrdiff_t>(cell % grid_.columns) + offset.x;
    if (row < 0 || column < 0 || row >= static_cast<std::ptrdiff_t>(grid_.rows) ||
        column >= static_cast<std::ptrdiff_t>(grid_.columns))
      return std::nullopt;
    const std::size_t found = static_cast<std::size_t>(row) * grid_.columns + static_cast<std::size_t>(column);
    if (grid_.kind[found] == empty) return std::nullopt;
    return found;
  }

  // Squared length in space of the edge from a cell to its neighbour, no_edge where there is none.
  float squared_in_space(std::size_t cell, Offset step) const {
    const auto other = at(cell, step);
    if (!other) return no_edge;
    const auto [plane, owner] = edge_place({0, 0}, step);
    const std::size_t keeper = owner == Offset{0, 0} ? cell : *other;
    const float length = grid_.squared_lengths[plane][keeper];
    const float local = grid_.scale != nullptr ? length * grid_.scale[keeper] : length;
    return local < no_edge ? local : no_edge;
  }

  // Squared length of the edge on the image manifold.
  float squared_edge(std::size_t cell, Offset step) const {
    const float space = squared_in_space(cell, step);
    if (space >= no_edge) return no_edge;
    const std::size_t other = *at(cell, step);
    float sum = 0;
    for (std::size_t channel = 0; channel < metric_.channels; ++channel) {
      const float* values = metric_[channel];
      sum += (values[other] - values[cell]) * (values[other] - values[cell]);
    }
    return std::min(no_edge, space + beta_ * beta_ * sum);
  }

  // Derivative of beta I in the direction of a step: a central difference, one-sided at a border.
  double slope(std::size_t cell, Offset step, std::size_t channel) const {
    const Offset back{-step.x, -step.y};
    const bool has_next = squared_in_space(cell, step) < no_edge, has_last = squared_in_space(cell, back) < no_edge;
    const std::size_t next = has_next ? *at(cell, step) : cell, last = has_last ? *at(cell, back) : cell;
    const float* values = metric_[channel];
    const double difference = static_cast<double>(values[next]) - static_cast<double>(values[last]);
    return static_cast<double>(beta_) * difference / (has_next && has_last ? 2 : 1);
  }

  std::size_t channels() const { return metric_.channels; }

 private:
  const Grid& grid_;
  Planes metric_;
  float beta_;
};

// The metric of eq. (1) at a cell.
struct Metric {
  double g11, g12, g22;
  double squared_length(Offset v) const { return g11 * v.x * v.x + 2 * g12 * v.x * v.y + g22 * v.y * v.y; }
  double product(Offset a, Offset b) const { return g11 * a.x * b.x + g12 * (a.x * b.y + a.y * b.x) + g22 * a.y * b.y; }
};

// Squared length in space of a unit step at the cell: the mean of the edges forward and backward.
std::optional<double> squared_step(const ImageGrid& image, std::size_t cell, Offset step) {
  const float forward = image.squared_in_space(cell, step), backward = image.squared_in_space(cell, {-step.x, -step.y});
  if (forward >= no_edge && backward >= no_edge) return std::nullopt;
  if (forward >= no_edge) return static_cast<double>(backward);
  if (backward >= no_edge) return static_cast<double>(forward);
  return squared((std::sqrt(static_cast<double>(forward)) + std::sqrt(static_cast<double>(backward))) / 2);
}

// g_ij = X_i . X_j + beta^2 I_i . I_j; the products in space follow from the lengths of edges and diagonals.
std::optional<Metric> metric_at(const ImageGrid& image, std::size_t cell) {
  const auto g11 = squared_step(image, cell, {1, 0}), g22 = squared_step(image, cell, {0, 1});
  if (!g11 || !g22) return std::nullopt;
  const auto falling = squared_step(image, cell, {1, 1}), rising = squared_step(image, cell, {1, -1});
  double g12 = 0;
  if (falling && rising) g12 = (*falling - *rising) / 4;
  else if (falling) g12 = (*falling - *g11 - *g22) / 2;
  else if (rising) g12 = (*g11 + *g22 - *rising) / 2;
  // Rounded lengths, or lengths from different sides, may contradict each other.
  const double bound = 0.999 * std::sqrt(*g11 * *g22);
  Metric metric{*g11, std::clamp(g12, -bound, bound), *g22};
  for (std::size_t channel = 0; channel < image.channels(); ++channel) {
    const double along = image.slope(cell, {1, 0}, channel), down = image.slope(cell, {0, 1}, channel);
    metric.g11 += along * along;
    metric.g12 += along * down;
    metric.g22 += down * down;
  }
  return metric;
}

// The nearest grid point of an obtuse quadrant that makes an acute angle with both of its axes.
std::optional<Offset> find_support(const Metric& g, Offset first, Offset second) {
  std::optional<Offset> best;
  for (int i = 1; i <= furthest_support; ++i)
    for (int j = 1; j <= furthest_support; ++j) {
      const Offset candidate{i * first.x + j * second.x, i * first.y + j * second.y};
      if (g.product(candidate, first) <= 0 || g.product(candidate, second) <= 0) continue;
      if (!best || g.squared_length(candidate) < g.squared_length(*best)) best = candidate;
    }
  return best;
}

class LinkMaker {
 public:
  LinkMaker(const ImageGrid& image, const CellNumbers& numbers) : image_(image), numbers_(numbers) {}

  void by_triangles(std::size_t cell, std::vector<FoundSplit>& found) const {
    for (const auto& [axis, diagonal] : stencil_classes) {
      const float b = image_.squared_edge(cell, axis), a = image_.squared_edge(cell, diagonal);
      const auto axis_cell = image_.at(cell, axis);
      const float c = axis_cell ? image_.squared_edge(*axis_cell, diagonal - axis) : no_edge;
      add_pair(cell, axis, diagonal, b, a, c, found);
    }
  }

  void by_metric(std::size_t cell, std::vector<FoundSplit>& found) const {
    const auto g = metric_at(image_, cell);
    for (const int x : {-1, 1})
      for (const int y : {-1, 1}) {
        const Offset first{x, 0}, second{0, y};
        const float along = image_.squared_edge(cell, first), down = image_.squared_edge(cell, second);
        if (!g || along >= no_edge || down >= no_edge) {  // no quadrant here: edges only
          add_pair(cell, first, second, along, down, no_edge, found);
        } else if (g->product(first, second) >= 0) {
          add_metric_pair(cell, *g, first, second, found);
        } else if (const auto support = find_support(*g, first, second); support && filled_up_to(cell, *support)) {
          add_metric_pair(cell, *g, first, *support, found);
          add_metric_pair(cell, *g, *support, second, found);
        } else {
          add_pair(cell, first, second, static_cast<float>(g->g11), static_cast<float>(g->g22), no_edge, found);
        }
      }
  }

 private:
  // Whether the manifold continues from a cell to a support: every cell of the rectangle between them is joined to
  // its neighbours in it.
  bool filled_up_to(std::size_t cell, Offset support) const {
    const int step_x = support.x > 0 ? 1 : -1, step_y = support.y > 0 ? 1 : -1;
    for (int y = 0; y != support.y + step_y; y += step_y)
      for (int x = 0; x != support.x + step_x; x += step_x) {
        const auto here = image_.at(cell, {x, y});
        if (!here) return false;
        if (x != support.x && image_.squared_edge(*here, {step_x, 0}) >= no_edge) return false;
        if (y != support.y && image_.squared_edge(*here, {0, step_y}) >= no_edge) return false;
      }
    return true;
  }

  void add_metric_pair(std::size_t cell, const Metric& g, Offset p, Offset q, std::vector<FoundSplit>& found) const {
    add_pair(cell, p, q, static_cast<float>(g.squared_length(p)), static_cast<float>(g.squared_length(q)),
             static_cast<float>(g.squared_length(q - p)), found);
  }

  // The updates of a cell by the supports p and q, from squared lengths: p and q to the cell, and between them.
  void add_pair(std::size_t cell, Offset p, Offset q, float to_p, float to_q, float between,
                std::vector<FoundSplit>& found) const {
    const auto p_cell = image_.at(cell, p), q_cell = image_.at(cell, q);
    const bool both = p_cell && q_cell;
    const auto coefficients = [&](float partner, float support) {
      return both ? make_coefficients(partner, support, between) : Coefficients{0, 0, 0};
    };
    if (p_cell && to_p < no_edge)
      found.push_back(link(cell, *p_cell, to_p, both ? *q_cell : *p_cell, coefficients(to_q, to_p)));
    if (q_cell && to_q < no_edge)
      found.push_back(link(cell, *q_cell, to_q, both ? *p_cell : *q_cell, coefficients(to_p, to_q)));
  }

  FoundSplit link(std::size_t target, std::size_t support, float squared_length, std::size_t partner, Coefficients c) const {
    const Partner with{numbers_.number_of[partner], c.k, c.squared_height, c.n};
    return {numbers_.number_of[support],
            {numbers_.number_of[target], std::sqrt(squared_length), {with, Partner{with.vertex, 0, 0, 0}}}};
  }

  const ImageGrid& image_;
  const CellNumbers& numbers_;
};

}  // namespace

CellNumbers number_cells(const Grid& grid) {
  CellNumbers numbers;
  numbers.number_of.assign(grid.cells(), none);
  for (std::size_t cell = 0; cell < grid.cells(); ++cell)
    if (grid.kind[cell] != empty) {
      numbers.number_of[cell] = static_cast<Index>(numbers.cell_of.size());
      numbers.cell_of.push_back(cell);
    }
  return numbers;
}

triangulated::Stencils make_grid_stencils(const Grid& grid, const CellNumbers& numbers, Planes metric, float beta,
                                          Scheme scheme, unsigned threads) {
  constexpr std::size_t cells_per_chunk = 4096;
  const std::size_t count = numbers.cell_of.size();
  const ImageGrid image(grid, metric, beta);
  const LinkMaker maker(image, numbers);
  std::vector<std::vector<FoundSplit>> chunks((count + cells_per_chunk - 1) / cells_per_chunk);
  parallel_chunks(count, cells_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    auto& found = chunks[begin / cells_per_chunk];
    for (std::size_t i = begin; i < end; ++i)
      scheme == Scheme::triangles ? maker.by_triangles(numbers.cell_of[i], found) : maker.by_metric(numbers.cell_of[i], found);
  });
  Stencils stencils;
  stencils.link_offsets.assign(count + 1, 0);
  stencils.links.push_back({none, 0, 0});
  stencils.split_offsets.assign(count + 1, 0);
  triangulated::group_splits(stencils, chunks);
  return stencils;
}

}  // namespace beltrami::grid
