// Colours on a canvas, for Python.
#pragma once

#include <nanobind/nanobind.h>

namespace beltrami::bindings {

void bind_canvas(nanobind::module_& module);

}  // namespace beltrami::bindings
