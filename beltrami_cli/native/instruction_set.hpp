// Code compiled once for each instruction set from the same source, and the choice between them at run time.
//
// The sources of such code are compiled with BELTRAMI_VARIANT naming their innermost namespace and the compiler's flags the
// instruction set. Contraction to fused multiply-add is off for all, so that every variant gives the same bits.
#pragma once

namespace beltrami {

enum class InstructionSet { baseline, x86_64_v3, x86_64_v4 };

// The best supported instruction set, or that of the environment variable BELTRAMI_SIMD: "x86-64-v4", "x86-64-v3" or
// "baseline". Throws std::invalid_argument if the processor does not support it.
InstructionSet choose_instruction_set();

const char* name_of(InstructionSet set);

// BELTRAMI_DECLARE_VARIANTS(declaration) declares something in the namespace of every variant, and
// BELTRAMI_VARIANT_OF(name, set) is the one of an instruction set.
#ifdef BELTRAMI_X86_VARIANTS
#define BELTRAMI_DECLARE_VARIANTS(...) \
  namespace baseline {                 \
  __VA_ARGS__;                         \
  }                                    \
  namespace x86_64_v3 {                \
  __VA_ARGS__;                         \
  }                                    \
  namespace x86_64_v4 {                \
  __VA_ARGS__;                         \
  }
#define BELTRAMI_VARIANT_OF(name, set)                                \
  ((set) == ::beltrami::InstructionSet::x86_64_v4   ? x86_64_v4::name \
   : (set) == ::beltrami::InstructionSet::x86_64_v3 ? x86_64_v3::name \
                                                    : baseline::name)
#else
#define BELTRAMI_DECLARE_VARIANTS(...) \
  namespace baseline {                 \
  __VA_ARGS__;                         \
  }
#define BELTRAMI_VARIANT_OF(name, set) (static_cast<void>(set), baseline::name)
#endif

}  // namespace beltrami
