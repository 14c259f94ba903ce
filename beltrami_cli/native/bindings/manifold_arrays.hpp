// What both solvers on triangulated manifolds give to Python.
#pragma once

#include <nanobind/stl/tuple.h>

#include <memory>
#include <span>
#include <tuple>

#include "bindings/arrays.hpp"
#include "triangulated/fast_marching.hpp"
#include "triangulated/short_time_kernel.hpp"
#include "triangulated/topology.hpp"

namespace beltrami::bindings {

inline auto give_edges(const std::vector<std::array<triangulated::Index, 2>>& edges) {
  const auto count = edges.size();
  std::unique_ptr<triangulated::Index[]> copy(new triangulated::Index[2 * count]);
  for (std::size_t i = 0; i < count; ++i) {
    copy[2 * i] = edges[i][0];
    copy[2 * i + 1] = edges[i][1];
  }
  return give<triangulated::Index, nb::shape<-1, 2>>(std::move(copy), {count, 2});
}

// Vertices, and their distances.
inline auto give_reached(std::span<const triangulated::Reached> reached) {
  std::unique_ptr<triangulated::Index[]> vertices(new triangulated::Index[reached.size()]);
  std::unique_ptr<float[]> distances(new float[reached.size()]);
  for (std::size_t i = 0; i < reached.size(); ++i) {
    vertices[i] = reached[i].vertex;
    distances[i] = reached[i].distance;
  }
  return std::make_tuple(give<triangulated::Index, nb::ndim<1>>(std::move(vertices), {reached.size()}),
                         give<float, nb::ndim<1>>(std::move(distances), {reached.size()}));
}

// Runs `smooth`, given where to write and a poll, without the interpreter lock; returns the rows that it wrote, the samples
// held, and the kernels cut short.
template <class Smooth>
auto run_kernel(const Matrix<float>& colours, const nb::object& progress, Smooth smooth) {
  std::unique_ptr<float[]> smoothed(new float[colours.size()]);
  PythonPoll poll(progress);
  triangulated::KernelStatistics statistics;
  try {
    const nb::gil_scoped_release unlock;
    statistics = smooth(smoothed.get(), poll.poll());
  } catch (const Cancelled&) {
    poll.rethrow();
    throw;
  }
  return std::make_tuple(give<float, nb::ndim<2>>(std::move(smoothed), {colours.shape(0), colours.shape(1)}),
                         statistics.samples, statistics.truncated);
}

inline void require_rows(std::size_t rows, triangulated::Index vertex_count) {
  if (rows != static_cast<std::size_t>(vertex_count)) throw nb::value_error("one row a vertex is needed");
}

}  // namespace beltrami::bindings
