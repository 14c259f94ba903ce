#pragma once

#include <nanobind/nanobind.h>

namespace beltrami::bindings {

void bind_triangulated(nanobind::module_& module);

}  // namespace beltrami::bindings
