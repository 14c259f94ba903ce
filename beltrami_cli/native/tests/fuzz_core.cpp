// What the core is handed, made of any bytes: for libFuzzer, under the sanitizers. The preconditions of the core are kept (the
// Python side checks them), everything else is as odd as bytes can make it.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <vector>

#include "atlas/atlas.hpp"
#include "grid/window_march.hpp"
#include "grid/window_sweep.hpp"
#include "triangulated/metric.hpp"
#include "triangulated/short_time_kernel.hpp"
#include "triangulated/stencils.hpp"
#include "triangulated/topology.hpp"

namespace {

void require(bool holds) {
  if (!holds) std::abort();
}

// Takes values off a string of bytes; zeros when it is used up.
class Bytes {
 public:
  Bytes(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}

  template <class T>
  T take() {
    T value{};
    const std::size_t count = std::min(sizeof(T), size_);
    std::memcpy(&value, data_, count);
    data_ += count;
    size_ -= count;
    return value;
  }
  std::size_t below(std::size_t most) { return take<std::uint16_t>() % most; }
  bool empty() const { return size_ == 0; }

  // Any finite number, most often a small and round one, so that points coincide and areas vanish.
  double number() {
    const auto kind = take<std::uint8_t>();
    if (kind < 160) return static_cast<double>(take<std::int8_t>()) / 8;
    const double any = take<double>();
    return std::isfinite(any) ? std::clamp(any, -1e150, 1e150) : 0;
  }
  float colour() {
    const auto kind = take<std::uint8_t>();
    if (kind < 200) return static_cast<float>(take<std::uint8_t>()) / 255.0F;
    const float any = take<float>();
    return std::isfinite(any) ? std::clamp(any, -1e6F, 1e6F) : 0;
  }
  float parameter(float least, float most) {
    return least + (most - least) * static_cast<float>(take<std::uint16_t>()) / 65535.0F;
  }

 private:
  const std::uint8_t* data_;
  std::size_t size_;
};

template <class T>
void require_range(const std::vector<T>& before, const T* after) {
  if (before.empty()) return;
  const auto [low, high] = std::minmax_element(before.begin(), before.end());
  const T slack = T(1e-5) * std::max({T(1), std::abs(*low), std::abs(*high)});
  for (std::size_t i = 0; i < before.size(); ++i) require(after[i] >= *low - slack && after[i] <= *high + slack);
}

void fuzz_triangulated(Bytes& bytes) {
  using namespace beltrami::triangulated;
  const std::size_t vertices = 1 + bytes.below(60), corners = 3 * bytes.below(100), width = 1 + bytes.below(4);
  std::vector<Index> faces(corners);
  for (Index& corner : faces) corner = static_cast<Index>(bytes.below(vertices));
  std::vector<double> positions(3 * vertices);
  for (double& coordinate : positions) coordinate = bytes.number();
  std::vector<float> colours(width * vertices), weights(vertices), scales(vertices), result(colours.size());
  for (float& colour : colours) colour = bytes.colour();
  for (float& weight : weights) weight = std::abs(bytes.colour());
  for (float& scale : scales) scale = bytes.parameter(1e-3F, 1e3F);
  const double beta = static_cast<double>(bytes.parameter(0, 200));
  const bool scaled = bytes.below(2), weighted = bytes.below(2);
  const KernelParameters parameters{bytes.parameter(0.01F, 9), bytes.parameter(0, 20), 1 + bytes.below(200)};
  Topology topology = make_topology(faces, static_cast<Index>(vertices));
  Stencils stencils = make_stencils(topology);
  const auto squared = squared_edge_lengths(topology, {positions.data(), 3}, {colours.data(), width}, beta,
                                            scaled ? scales.data() : nullptr, 1);
  update_stencils(stencils, topology, squared, 1);
  smooth(stencils, {colours.data(), width}, weighted ? weights.data() : nullptr, parameters, result.data(), 1);
  require_range(colours, result.data());
}

void fuzz_grid(Bytes& bytes) {
  using namespace beltrami::grid;
  const std::size_t rows = 1 + bytes.below(24), columns = 1 + bytes.below(40), cells = rows * columns;
  const std::size_t channels = 1 + bytes.below(3);
  const SweepParameters parameters{bytes.parameter(0.01F, 9), bytes.parameter(0, 20), bytes.parameter(0, 200)};
  const int radius = 1 + static_cast<int>(bytes.below(7));
  const bool by_metric = bytes.below(2), scaled = bytes.below(2);
  std::vector<std::uint8_t> kind(cells);
  for (auto& cell : kind) {
    cell = owned;
    if (!bytes.empty() && bytes.below(16) >= 13) cell = bytes.below(2) ? halo : empty;
  }
  std::vector<float> lengths(direction_count * cells), scale(cells), colours(channels * cells);
  for (float& length : lengths) {
    const double any = std::abs(bytes.number());
    length = bytes.below(20) == 19 ? std::numeric_limits<float>::infinity() : static_cast<float>(std::min(any, 1e6));
  }
  for (float& each : scale) each = bytes.parameter(1e-3F, 1e3F);
  for (float& colour : colours) colour = bytes.colour();
  for (std::size_t i = 0; i < direction_count * cells; ++i)
    if (kind[i % cells] == empty) lengths[i] = std::numeric_limits<float>::infinity();
  std::array<const float*, direction_count> of_lengths;
  for (std::size_t k = 0; k < direction_count; ++k) of_lengths[k] = lengths.data() + k * kind.size();
  const Grid grid{rows, columns, kind.data(), of_lengths, scaled ? scale.data() : nullptr};
  std::vector<const float*> pointers;
  for (std::size_t k = 0; k < channels; ++k) pointers.push_back(colours.data() + k * kind.size());
  const Planes planes{pointers.data(), channels};
  std::vector<float> result(colours.size());
  smooth_by_sweeps(grid, planes, planes, parameters, make_window_program(radius), result.data(), 1);
  require_range(colours, result.data());
  const Scheme scheme = by_metric ? Scheme::metric : Scheme::triangles;
  smooth_by_marching(grid, planes, planes, parameters, radius, scheme, result.data(), 1);
  require_range(colours, result.data());
}

void fuzz_atlas(Bytes& bytes) {
  using namespace beltrami::atlas;
  const std::size_t places = 1 + bytes.below(40), faces = bytes.below(40), textures = 1 + bytes.below(3);
  std::vector<double> positions(3 * places), uv(6 * faces);
  std::vector<Index> corners(3 * faces), texture_of(faces);
  Surface surface{positions.data(), static_cast<Index>(places), corners, uv.data(), texture_of, {}};
  std::int64_t offset = 0;
  for (std::size_t i = 0; i < textures; ++i) {
    const auto width = static_cast<std::int32_t>(1 + bytes.below(40)), height = static_cast<std::int32_t>(1 + bytes.below(40));
    surface.textures.push_back({width, height, static_cast<Wrap>(bytes.below(3)), static_cast<Wrap>(bytes.below(3)), offset});
    offset += static_cast<std::int64_t>(width) * height;
  }
  const auto margin = static_cast<std::int64_t>(1 + bytes.below(8));
  for (Index& texture : texture_of) texture = static_cast<Index>(bytes.below(textures + 1)) - 1;
  for (Index& corner : corners) corner = static_cast<Index>(bytes.below(places));
  for (double& coordinate : positions) coordinate = bytes.number();
  // Where images are repeated thousands of times the work is as much: that is refused elsewhere.
  for (double& coordinate : uv) coordinate = std::clamp(bytes.number(), -20.0, 20.0);
  const Atlas atlas = make_atlas(surface, margin, 1);
  require(static_cast<std::int64_t>(atlas.owned_cells.size) == atlas.covered && atlas.covered <= offset);
  const auto cells = static_cast<std::size_t>(atlas.rows * atlas.columns);
  require(atlas.kind.size == cells);
  for (std::size_t i = 0; i < atlas.halo_taps.size; ++i)
    require(atlas.halo_taps[i] >= 0 && static_cast<std::size_t>(atlas.halo_taps[i]) < cells);
  for (std::size_t i = 0; i < atlas.owned_texels.size; ++i)
    require(atlas.owned_texels[i] >= 0 && atlas.owned_texels[i] < offset);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  Bytes bytes(data, size);
  switch (bytes.take<std::uint8_t>() % 3) {
    case 0: fuzz_triangulated(bytes); break;
    case 1: fuzz_grid(bytes); break;
    default: fuzz_atlas(bytes);
  }
  return 0;
}
