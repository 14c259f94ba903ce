// Meshes for the tests of both solvers on triangulated manifolds.
#pragma once

#include <random>
#include <vector>

#include "triangulated/metric.hpp"
#include "triangulated/topology.hpp"

namespace beltrami::triangulated {

struct Mesh {
  std::vector<double> positions;  // three a vertex
  std::vector<float> colours;     // `channels` a vertex
  std::vector<Index> faces;       // three a face
  std::size_t channels = 3;

  Index vertex_count() const { return static_cast<Index>(positions.size() / 3); }
  Rows<double> position_rows() const { return {positions.data(), 3}; }
  Rows<float> colour_rows() const { return {colours.data(), channels}; }
};

inline float random_colour(std::mt19937& random) { return static_cast<float>(random() % 256) / 255.0F; }

// A square grid of side x side vertices in the plane, of one grey.
inline Mesh make_grid(int side, std::size_t channels = 3) {
  Mesh mesh;
  mesh.channels = channels;
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) {
      mesh.positions.insert(mesh.positions.end(), {static_cast<double>(x), static_cast<double>(y), 0.0});
      if (x + 1 < side && y + 1 < side) {
        const Index a = y * side + x;
        mesh.faces.insert(mesh.faces.end(), {a, a + 1, a + side, a + 1, a + side + 1, a + side});
      }
    }
  mesh.colours.assign(channels * static_cast<std::size_t>(side * side), 0.25F);
  return mesh;
}

// Any triangles over few vertices: repeated vertices, duplicate and non-manifold faces, coincident points.
inline Mesh make_soup(std::mt19937& random, std::size_t channels = 3) {
  Mesh mesh;
  mesh.channels = channels;
  const auto vertices = static_cast<Index>(1 + random() % 40);
  for (Index v = 0; v < vertices; ++v) {
    for (int axis = 0; axis < 3; ++axis)
      mesh.positions.push_back(static_cast<double>(random() % 5) * (random() % 3 == 0 ? 1e-9 : 1.0));
    for (std::size_t c = 0; c < channels; ++c) mesh.colours.push_back(random_colour(random));
  }
  for (unsigned long corner = 3 * (random() % 120); corner > 0; --corner)
    mesh.faces.push_back(static_cast<Index>(random() % static_cast<unsigned long>(vertices)));
  return mesh;
}

}  // namespace beltrami::triangulated
