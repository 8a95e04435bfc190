#pragma once

#include <nanobind/nanobind.h>

namespace kinematics {

void bind(nanobind::module_& m);

}  // namespace kinematics
