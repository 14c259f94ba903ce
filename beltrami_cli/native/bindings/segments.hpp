#pragma once

#include <nanobind/nanobind.h>

namespace beltrami::bindings {

void bind_segments(nanobind::module_& module);

}  // namespace beltrami::bindings
