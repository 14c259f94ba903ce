// Atlases and nearest texels for Python.
#include <nanobind/stl/tuple.h>

#include <tuple>
#include <vector>

#include "atlas/atlas.hpp"
#include "atlas/nearest_texel.hpp"
#include "bindings/bindings.hpp"

namespace beltrami::bindings {
namespace {

using atlas::Array;
using atlas::Index;

// NumPy arrays over memory that stays as long as they do.
template <class T, class Shape>
Result<T, Shape> view(const Array<T>& array, std::initializer_list<std::size_t> shape) {
  auto* kept = new atlas::Memory(array.memory());
  nb::capsule owner(kept, [](void* memory) noexcept { delete static_cast<atlas::Memory*>(memory); });
  return Result<T, Shape>(kept->get(), shape, owner);
}

template <class T>
auto vector_of(const Array<T>& array) {
  return view<T, nb::ndim<1>>(array, {array.size});
}

template <class T>
auto rows_of_four(const Array<T>& array) {
  return view<T, nb::shape<-1, 4>>(array, {array.size / 4, 4});
}

// Memory of arrays that Python makes: `allocate` is called with a number of bytes.
atlas::Allocate allocate_by(const nb::object& allocate) {
  return [&allocate](std::size_t bytes) -> atlas::Memory {
    const nb::gil_scoped_acquire lock;
    auto array = nb::cast<nb::ndarray<std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>>(allocate(bytes));
    void* data = array.data();
    return {data, [array = std::move(array)](void*) mutable {
              const nb::gil_scoped_acquire released;
              array = {};
            }};
  };
}

std::vector<atlas::Texture> textures_of(const Matrix<Index>& grids) {
  if (grids.shape(1) != 4) throw nb::value_error("a texture is its width, its height and two wrap modes");
  std::vector<atlas::Texture> textures;
  std::int64_t offset = 0;
  for (std::size_t i = 0; i < grids.shape(0); ++i) {
    const Index* row = grids.data() + 4 * i;
    if (row[0] < 1 || row[1] < 1) throw nb::value_error("a texture has no texels");
    if (row[2] < 0 || row[2] > 2 || row[3] < 0 || row[3] > 2) throw nb::value_error("unknown wrap mode");
    textures.push_back({row[0], row[1], static_cast<atlas::Wrap>(row[2]), static_cast<atlas::Wrap>(row[3]), offset});
    offset += static_cast<std::int64_t>(row[0]) * row[1];
  }
  return textures;
}

nb::dict to_dict(const atlas::Atlas& made) {
  const auto rows = static_cast<std::size_t>(made.rows), columns = static_cast<std::size_t>(made.columns);
  nb::dict result;
  result["kind"] = view<std::uint8_t, nb::ndim<2>>(made.kind, {rows, columns});
  result["squared_lengths"] = view<float, nb::shape<4, -1, -1>>(made.squared_lengths, {4, rows, columns});
  result["owned_texels"] = vector_of(made.owned_texels);
  result["halo_cells"] = vector_of(made.halo_cells);
  result["halo_taps"] = rows_of_four(made.halo_taps);
  result["halo_weights"] = rows_of_four(made.halo_weights);
  result["halo_seams"] = vector_of(made.halo_seams);
  result["chart_of"] = vector_of(made.chart_of);
  result["cut_cells"] = vector_of(made.cut_cells);
  result["gutter_cells"] = vector_of(made.gutter_cells);
  result["gutter_texels"] = vector_of(made.gutter_texels);
  result["border_texels"] = vector_of(made.border_texels);
  result["lone_texels"] = vector_of(made.lone_texels);
  result["charts"] = made.charts;
  result["seams"] = made.seams;
  result["covered"] = made.covered;
  result["overlapped"] = made.overlapped;
  return result;
}

nb::dict build_atlas(const Matrix<double>& positions, const Matrix<Index>& faces,
                     const nb::ndarray<const double, nb::shape<-1, 3, 2>, nb::c_contig, nb::device::cpu>& uv,
                     const Vector<Index>& texture_of, const Matrix<Index>& grids, std::int64_t margin,
                     unsigned threads, const nb::object& allocate, const nb::object& progress) {
  if (positions.shape(1) != 3 || faces.shape(1) != 3) throw nb::value_error("three coordinates, three corners");
  if (uv.shape(0) != faces.shape(0) || texture_of.shape(0) != faces.shape(0))
    throw nb::value_error("one row a face is needed");
  require(margin < 1 << 20, "the margin is too large");  // so that areas of charts are 64-bit numbers
  require_finite(positions);
  atlas::Surface surface{positions.data(), static_cast<Index>(positions.shape(0)), {faces.data(), faces.size()},
                         uv.data(), {texture_of.data(), texture_of.size()}, textures_of(grids)};
  atlas::Atlas made;
  run_polled(progress, [&](const Poll& poll) {
    made = atlas::make_atlas(surface, margin, threads, allocate_by(allocate), poll);
  });
  return to_dict(made);
}

auto nearest_marked(const Matrix<bool>& marked, const Matrix<bool>& wanted, std::int64_t reach, unsigned threads) {
  const std::size_t height = marked.shape(0), width = marked.shape(1);
  if (wanted.shape(0) != height || wanted.shape(1) != width) throw nb::value_error("both must have one shape");
  require(reach >= 0, "the reach must be 0 or more");
  atlas::NearestMarks found;
  {
    const nb::gil_scoped_release unlock;
    found = atlas::nearest_marked(marked.data(), wanted.data(), static_cast<std::int64_t>(height),
                                  static_cast<std::int64_t>(width), reach, threads);
  }
  return std::make_tuple(give_copy(found.texels), give_copy(found.marks));
}

}  // namespace

void bind_atlas(nb::module_& module) {
  using namespace nb::literals;
  module.def("build_atlas", &build_atlas, "positions"_a, "faces"_a, "uv"_a, "texture_of"_a, "grids"_a, "margin"_a,
             "threads"_a, "allocate"_a, "progress"_a.none());
  module.def("nearest_marked", &nearest_marked, "marked"_a, "wanted"_a, "reach"_a, "threads"_a);
}

}  // namespace beltrami::bindings
