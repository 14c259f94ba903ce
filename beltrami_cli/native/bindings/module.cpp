// The Python module of the core. Bindings check arguments, release the interpreter lock, and convert types.
#include "bindings/bindings.hpp"

NB_MODULE(_native, module) {
  beltrami::bindings::bind_triangulated(module);
  beltrami::bindings::bind_grid(module);
  beltrami::bindings::bind_colours(module);
  beltrami::bindings::bind_atlas(module);
  beltrami::bindings::bind_noise(module);
  beltrami::bindings::bind_patches(module);
  beltrami::bindings::bind_points(module);
}
