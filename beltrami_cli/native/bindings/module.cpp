// The Python face of the core. Bindings check shapes and types, release the interpreter lock, and translate; no more.
#include <nanobind/nanobind.h>

#include "bindings/atlas.hpp"
#include "bindings/canvas.hpp"
#include "bindings/colours.hpp"
#include "bindings/parametric.hpp"
#include "bindings/points.hpp"
#include "bindings/segments.hpp"
#include "bindings/triangulated.hpp"

NB_MODULE(_native, module) {
  beltrami::bindings::bind_triangulated(module);
  beltrami::bindings::bind_segments(module);
  beltrami::bindings::bind_parametric(module);
  beltrami::bindings::bind_canvas(module);
  beltrami::bindings::bind_colours(module);
  beltrami::bindings::bind_atlas(module);
  beltrami::bindings::bind_points(module);
}
