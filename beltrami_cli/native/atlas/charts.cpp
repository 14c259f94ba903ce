#include "atlas/charts.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>

#include "disjoint_sets.hpp"

namespace beltrami::atlas {
namespace {

void number_charts(const Mesh& mesh, Charts& charts) {
  DisjointSets sets(mesh.size());
  for (std::size_t edge = 0; edge < mesh.twins.size(); ++edge)
    if (mesh.twins[edge] != none && mesh.seams[edge] == 0)
      sets.unite(static_cast<Index>(edge / 3), mesh.twins[edge] / 3);
  charts.chart_of.resize(mesh.size());
  for (std::size_t face = 0; face < mesh.size(); ++face) {
    // A root is the least face of its set, so it is numbered already.
    const Index root = sets.root(static_cast<Index>(face));
    if (root == static_cast<Index>(face)) {
      charts.chart_of[face] = static_cast<Index>(charts.areas.size());
      charts.areas.push_back(0);
    } else {
      charts.chart_of[face] = charts.chart_of[static_cast<std::size_t>(root)];
    }
    charts.areas[static_cast<std::size_t>(charts.chart_of[face])] += 0.5 * std::abs(doubled_area(mesh.texels[face]));
  }
}

void list_faces_and_borders(const Mesh& mesh, Charts& charts) {
  const auto is_border = [&](std::size_t edge) { return mesh.twins[edge] == none || mesh.seams[edge] != 0; };
  charts.face_offsets.assign(charts.size() + 1, 0);
  charts.border_offsets.assign(charts.size() + 1, 0);
  for (std::size_t face = 0; face < mesh.size(); ++face) {
    const auto after = static_cast<std::size_t>(charts.chart_of[face]) + 1;
    ++charts.face_offsets[after];
    for (std::size_t k = 0; k < 3; ++k) charts.border_offsets[after] += is_border(3 * face + k) ? 1 : 0;
  }
  std::partial_sum(charts.face_offsets.begin(), charts.face_offsets.end(), charts.face_offsets.begin());
  std::partial_sum(charts.border_offsets.begin(), charts.border_offsets.end(), charts.border_offsets.begin());
  charts.faces.resize(mesh.size());
  charts.borders.resize(static_cast<std::size_t>(charts.border_offsets.back()));
  auto face_cursor = charts.face_offsets, border_cursor = charts.border_offsets;
  for (std::size_t face = 0; face < mesh.size(); ++face) {
    const auto chart = static_cast<std::size_t>(charts.chart_of[face]);
    charts.faces[static_cast<std::size_t>(face_cursor[chart]++)] = static_cast<Index>(face);
    for (std::size_t k = 0; k < 3; ++k)
      if (is_border(3 * face + k))
        charts.borders[static_cast<std::size_t>(border_cursor[chart]++)].edge = static_cast<Edge>(3 * face + k);
  }
}

struct SeamEdge {
  Index low, high;  // charts
  Index run;        // among the edges of a chart with itself: the run's name
  Edge edge;        // the lower of the two
  auto key() const { return std::tuple(low, high, run); }
};

// Edges of a chart with itself that share a place form one run, named by its least place.
void name_runs(const Mesh& mesh, std::vector<SeamEdge>& edges) {
  std::vector<std::pair<Index, Index>> places;  // (chart, place), of the ends of such edges
  const auto ends = [&](const SeamEdge& e) {
    const auto face = static_cast<std::size_t>(e.edge / 3), k = static_cast<std::size_t>(e.edge % 3);
    return std::array{std::pair(e.low, mesh.places[face][k]), std::pair(e.low, mesh.places[face][next(k)])};
  };
  for (const auto& edge : edges)
    if (edge.low == edge.high) places.insert(places.end(), {ends(edge)[0], ends(edge)[1]});
  std::sort(places.begin(), places.end());
  places.erase(std::unique(places.begin(), places.end()), places.end());
  const auto find = [&](std::pair<Index, Index> end) {
    return static_cast<Index>(std::lower_bound(places.begin(), places.end(), end) - places.begin());
  };
  DisjointSets sets(places.size());
  for (const auto& edge : edges)
    if (edge.low == edge.high) sets.unite(find(ends(edge)[0]), find(ends(edge)[1]));
  for (auto& edge : edges)
    if (edge.low == edge.high) edge.run = sets.root(find(ends(edge)[0]));
}

void number_seams(const Mesh& mesh, Charts& charts) {
  std::vector<SeamEdge> edges;
  for (std::size_t edge = 0; edge < mesh.twins.size(); ++edge) {
    const Edge twin = mesh.twins[edge];
    if (twin == none || mesh.seams[edge] == 0 || static_cast<std::size_t>(twin) < edge) continue;
    const Index a = charts.chart_of[edge / 3], b = charts.chart_of[static_cast<std::size_t>(twin / 3)];
    edges.push_back({std::min(a, b), std::max(a, b), none, static_cast<Edge>(edge)});
  }
  name_runs(mesh, edges);
  std::sort(edges.begin(), edges.end(), [](const SeamEdge& a, const SeamEdge& b) {
    return a.key() != b.key() ? a.key() < b.key() : a.edge < b.edge;
  });
  std::vector<std::pair<Edge, Index>> seam_of;
  for (std::size_t i = 0; i < edges.size(); ++i) {
    if (i == 0 || edges[i].key() != edges[i - 1].key()) ++charts.seams;
    seam_of.emplace_back(edges[i].edge, charts.seams - 1);
    seam_of.emplace_back(mesh.twins[static_cast<std::size_t>(edges[i].edge)], charts.seams - 1);
  }
  std::sort(seam_of.begin(), seam_of.end());
  for (auto& border : charts.borders) {
    const auto found = std::lower_bound(seam_of.begin(), seam_of.end(), std::pair(border.edge, none));
    if (found != seam_of.end() && found->first == border.edge) border.seam = found->second;
  }
}

}  // namespace

Charts make_charts(const Mesh& mesh) {
  Charts charts;
  number_charts(mesh, charts);
  list_faces_and_borders(mesh, charts);
  number_seams(mesh, charts);
  return charts;
}

}  // namespace beltrami::atlas
