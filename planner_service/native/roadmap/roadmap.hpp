#pragma once

#include <nanobind/nanobind.h>

namespace roadmap {

void bind(nanobind::module_& m);

}  // namespace roadmap
