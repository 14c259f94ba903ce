#pragma once

#include <nanobind/nanobind.h>

namespace beltrami::bindings {

void bind_parametric(nanobind::module_& module);

}  // namespace beltrami::bindings
