// Which charts look up the texels that no face covers: a lookup between texel centres reaches one texel beyond a face.
#pragma once

#include <cstdint>
#include <vector>

#include "atlas/charts.hpp"
#include "atlas/mesh.hpp"
#include "atlas/ownership.hpp"
#include "atlas/windows.hpp"
#include "parallel.hpp"

namespace beltrami::atlas {

// Instead of one chart: several; or none, if the chart of the face that looks up the texel covers no texel next to it.
constexpr Index several = -2, lone = -3;

struct LookedUp {
  std::int64_t texel;
  Index chart;  // that owns the texels next to it that the faces show which look it up; or `several`, or `lone`
};

// The uncovered texels that faces look up, ascending, each once. Throws Cancelled if the poll asks to stop.
std::vector<LookedUp> find_looked_up(const Mesh& mesh, const Charts& charts, const Windows& windows,
                                     const Ownership& ownership, const Poll& poll);

}  // namespace beltrami::atlas
