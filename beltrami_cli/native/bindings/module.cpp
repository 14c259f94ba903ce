// The Python face of the core. Bindings check shapes and types, release the interpreter lock, and translate; no more.
#include <nanobind/nanobind.h>

#ifdef __GLIBC__
#include <malloc.h>
#endif

#include "bindings/atlas.hpp"
#include "bindings/parametric.hpp"
#include "bindings/points.hpp"
#include "bindings/segments.hpp"
#include "bindings/triangulated.hpp"

namespace {

// Gives back to the system what was freed; others' allocators do so by themselves.
void release_free_memory() {
#ifdef __GLIBC__
  malloc_trim(0);
#endif
}

}  // namespace

NB_MODULE(_native, module) {
  beltrami::bindings::bind_triangulated(module);
  beltrami::bindings::bind_segments(module);
  beltrami::bindings::bind_parametric(module);
  beltrami::bindings::bind_atlas(module);
  beltrami::bindings::bind_points(module);
  module.def("release_free_memory", &release_free_memory);
}
