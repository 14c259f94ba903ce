#include "instruction_set.hpp"

#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <vector>

namespace beltrami {
namespace {

// The best first.
std::vector<InstructionSet> usable_sets() {
  std::vector<InstructionSet> sets;
#ifdef BELTRAMI_X86_VARIANTS
  __builtin_cpu_init();
  if (__builtin_cpu_supports("x86-64-v4")) sets.push_back(InstructionSet::x86_64_v4);
  if (__builtin_cpu_supports("x86-64-v3")) sets.push_back(InstructionSet::x86_64_v3);
#endif
  sets.push_back(InstructionSet::baseline);
  return sets;
}

}  // namespace

InstructionSet choose_instruction_set() {
  const auto sets = usable_sets();
  const char* asked = std::getenv("BELTRAMI_SIMD");
  if (asked == nullptr) return sets.front();
  for (const InstructionSet set : sets)
    if (std::strcmp(name_of(set), asked) == 0) return set;
  throw std::invalid_argument("BELTRAMI_SIMD names an instruction set that this machine does not have");
}

const char* name_of(InstructionSet set) {
  switch (set) {
    case InstructionSet::x86_64_v4: return "x86-64-v4";
    case InstructionSet::x86_64_v3: return "x86-64-v3";
    default: return "baseline";
  }
}

}  // namespace beltrami
