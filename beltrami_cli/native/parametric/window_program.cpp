#include "parametric/window_program.hpp"

#include <algorithm>

namespace beltrami::parametric {
namespace {

int squared_length(Offset offset) { return offset.x * offset.x + offset.y * offset.y; }

class Window {
 public:
  explicit Window(int radius) : radius_(radius) {}
  bool holds(Offset offset) const { return std::max(std::abs(offset.x), std::abs(offset.y)) <= radius_; }
  int slot(Offset offset) const { return (offset.y + radius_) * (2 * radius_ + 1) + offset.x + radius_; }

  std::vector<Offset> rings() const {
    std::vector<Offset> offsets;
    for (int y = -radius_; y <= radius_; ++y)
      for (int x = -radius_; x <= radius_; ++x)
        if (x != 0 || y != 0) offsets.push_back({x, y});
    std::stable_sort(offsets.begin(), offsets.end(),
                     [](Offset a, Offset b) { return squared_length(a) < squared_length(b); });
    return offsets;
  }

 private:
  int radius_;
};

template <class Usable>
Target make_target(const Window& window, Offset offset, Usable usable) {
  Target target{window.slot(offset), offset, {}, {}};
  for (const Offset step : neighbours)
    if (usable(offset + step)) {
      const auto [plane, cell] = edge_place(offset, step);
      target.edges.push_back({window.slot(offset + step), plane, cell});
    }
  for (std::size_t i = 0; i < stencil_classes.size(); ++i) {
    const Offset axis = offset + stencil_classes[i].axis, diagonal = offset + stencil_classes[i].diagonal;
    if (usable(axis) && usable(diagonal))
      target.triangles.push_back({window.slot(axis), window.slot(diagonal), i});
  }
  return target;
}

}  // namespace

WindowProgram make_window_program(int radius) {
  const Window window(radius);
  WindowProgram program{radius, {}, {}};
  for (const Offset offset : window.rings()) {
    const auto nearer = [&](Offset other) { return squared_length(other) < squared_length(offset); };
    const auto inside = [&](Offset other) { return window.holds(other) && !(other == Offset{0, 0}); };
    program.outward.push_back(make_target(window, offset, nearer));
    program.repair.push_back(make_target(window, offset, inside));
  }
  return program;
}

}  // namespace beltrami::parametric
