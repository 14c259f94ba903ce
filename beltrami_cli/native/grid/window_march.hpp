// One iteration of the short-time Beltrami kernel on a grid, by a heap march from every cell.
//
// A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images on manifolds" (2007), eqs. (8), (9),
// over the stencils of grid/stencils.hpp.
#pragma once

#include <cstddef>
#include <cstdint>

#include "grid/stencils.hpp"
#include "grid/window_sweep.hpp"
#include "parallel.hpp"

namespace beltrami::grid {

// As smooth_by_sweeps, by a heap march for every owned cell; cells further than window_radius in rows or columns
// are left out, which 0 turns off.
std::int64_t smooth_by_marching(const Grid& grid, Planes metric, Planes colours, const SweepParameters& parameters,
                                int window_radius, Scheme scheme, float* smoothed, unsigned threads,
                                const Poll& poll = {});

// As distances_by_sweeps, by the march that smooth_by_marching makes from the cell.
void distances_by_marching(const Grid& grid, Planes metric, const SweepParameters& parameters, int window_radius,
                           Scheme scheme, std::size_t cell, float* distances);

}  // namespace beltrami::grid
