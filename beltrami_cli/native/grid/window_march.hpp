// One iteration of the short-time Beltrami kernel on a grid by fast marching with a heap: for windows that are too wide for
// sweeps, for the exact scheme of the paper, and as the reference of tests.
#pragma once

#include <cstddef>
#include <cstdint>

#include "grid/stencils.hpp"
#include "grid/window_sweep.hpp"
#include "parallel.hpp"

namespace beltrami::grid {

// As smooth_by_sweeps, by fast marching over the stencils from every owned cell, without cells further than
// window_radius in rows or columns; 0: no limit.
std::int64_t smooth_by_marching(const Grid& grid, Planes metric, Planes colours, const SweepParameters& parameters,
                                int window_radius, Scheme scheme, float* smoothed, unsigned threads,
                                const Poll& poll = {});

// As distances_by_sweeps, by the march of smooth_by_marching.
void distances_by_marching(const Grid& grid, Planes metric, const SweepParameters& parameters, int window_radius,
                           Scheme scheme, std::size_t cell, float* distances);

}  // namespace beltrami::grid
