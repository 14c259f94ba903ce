// One iteration of the short-time Beltrami kernel on a grid, by sweeps over a window of fixed order.
//
// A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images on manifolds" (2007), eqs. (8), (9).
// The distances solve the discrete eikonal equation of fast marching, but without a heap: the cells of the window
// are updated in an order fixed beforehand, so that sixteen neighbouring centres go through the same operations
// side by side in the lanes of vector registers.
#pragma once

#include <cstddef>
#include <cstdint>

#include "parallel.hpp"
#include "parametric/grid.hpp"
#include "parametric/window_program.hpp"

namespace beltrami::parametric {

struct SweepParameters {
  float time_step;  // t, squared length
  float radius;     // sqrt(-4 t ln threshold), length
  float beta;       // lengths per unit of colour
  int repairs;      // passes over all stencils after the outward one
};

// Distances come from `metric` colours, averages are taken over `colours`; both have grid.cells() values a plane.
// Writes the owned cells of `smoothed` (planes as in colours) and copies the others. Returns the sum over
// owned cells of how many samples each kernel held. Bit-identical for any number of threads and any instruction set.
// poll counts cells of the grid; throws Cancelled if it asks to
// stop.
std::int64_t smooth_by_sweeps(const Grid& grid, Planes metric, Planes colours, const SweepParameters& parameters,
                              const WindowProgram& program, float* smoothed, unsigned threads, const Poll& poll = {});

// Distances from one owned cell, as smooth_by_sweeps takes them: (2 program.radius + 1)^2 values, row by row, infinite
// beyond parameters.radius. The time step has no effect.
void distances_by_sweeps(const Grid& grid, Planes metric, const SweepParameters& parameters, const WindowProgram& program,
                         std::size_t cell, float* distances);

// Which instruction set smooth_by_sweeps uses on this machine: "x86-64-v4", "x86-64-v3" or "baseline". The variable
// BELTRAMI_SIMD of the environment may ask for a lesser one.
const char* sweep_instruction_set();

}  // namespace beltrami::parametric
