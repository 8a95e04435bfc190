#pragma once

#include <nanobind/nanobind.h>

namespace collision {

// Adds ``CollisionKernel``, what it answers, and ``instruction_sets``.
void bind(nanobind::module_& m);

}  // namespace collision
