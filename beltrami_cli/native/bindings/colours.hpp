// Rows of colours, for Python.
#pragma once

#include <nanobind/nanobind.h>

namespace beltrami::bindings {

void bind_colours(nanobind::module_& module);

}  // namespace beltrami::bindings
