// Which of the compiled instruction sets the sweeps use on this machine.
#pragma once

#include "triangulated/group_sweep.hpp"
#include "triangulated/length_sweep.hpp"

namespace beltrami::triangulated {

// The best that the processor has, or the one that the variable BELTRAMI_SIMD of the environment names: "x86-64-v4",
// "x86-64-v3" or "baseline". Throws std::invalid_argument if the processor does not have it.
SweepGroup choose_sweep();
const LengthSweep& choose_length_sweep();

}  // namespace beltrami::triangulated
