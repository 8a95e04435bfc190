#pragma once

#include <nanobind/nanobind.h>

namespace roadmap {

void bind_places(nanobind::module_& m);

}  // namespace roadmap
