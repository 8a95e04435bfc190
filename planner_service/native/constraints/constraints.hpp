#pragma once

#include <nanobind/nanobind.h>

namespace constraints {

// Adds ``Projector``.
void bind(nanobind::module_& m);

}  // namespace constraints
