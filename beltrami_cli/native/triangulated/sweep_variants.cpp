#include "triangulated/sweep_variants.hpp"

#include <cstring>

#include "parametric/window_sweep.hpp"

namespace beltrami::triangulated {

SweepGroup choose_sweep() {
  [[maybe_unused]] const char* set = parametric::sweep_instruction_set();
#ifdef BELTRAMI_X86_VARIANTS
  if (std::strcmp(set, "x86-64-v4") == 0) return x86_64_v4::sweep_group;
  if (std::strcmp(set, "x86-64-v3") == 0) return x86_64_v3::sweep_group;
#endif
  return baseline::sweep_group;
}

const LengthSweep& choose_length_sweep() {
  [[maybe_unused]] const char* set = parametric::sweep_instruction_set();
#ifdef BELTRAMI_X86_VARIANTS
  if (std::strcmp(set, "x86-64-v4") == 0) return x86_64_v4::length_sweep;
  if (std::strcmp(set, "x86-64-v3") == 0) return x86_64_v3::length_sweep;
#endif
  return baseline::length_sweep;
}

}  // namespace beltrami::triangulated
