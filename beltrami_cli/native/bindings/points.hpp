#pragma once

#include <nanobind/nanobind.h>

namespace beltrami::bindings {

void bind_points(nanobind::module_& module);

}  // namespace beltrami::bindings
