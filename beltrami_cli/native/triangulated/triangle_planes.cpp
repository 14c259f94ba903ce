#include "triangulated/triangle_planes.hpp"

namespace beltrami::triangulated {

TrianglePlanes make_planes(const Topology& topology) {
  TrianglePlanes planes;
  planes.count = topology.faces.size();
  planes.stride = (planes.count + 15) / 16 * 16;
  for (auto* plane : {&planes.edges, &planes.beyond_low, &planes.beyond_high}) plane->assign(3 * planes.stride, 0);
  for (Corner corner = 0; corner < static_cast<Corner>(topology.twins.size()); ++corner) {
    const std::size_t at = planes.at(corner);
    planes.edges[at] = topology.face_edges[static_cast<std::size_t>(corner / 3)][static_cast<std::size_t>(corner % 3)];
    const Corner twin = topology.twins[static_cast<std::size_t>(corner)];
    if (twin == none) continue;
    // Corners of faces ascend, so the last but the apex is the higher end; the edge to the lower end faces it.
    const auto& edges = topology.face_edges[static_cast<std::size_t>(twin / 3)];
    const auto apex = static_cast<std::size_t>(twin % 3);
    planes.beyond_low[at] = edges[apex == 2 ? 1 : 2];
    planes.beyond_high[at] = edges[apex == 0 ? 1 : 0];
  }
  return planes;
}

}  // namespace beltrami::triangulated
