// How far points reach along directions: what geometry/mesh.py asks of every face of a hull.
#pragma once

#include <nanobind/nanobind.h>

namespace geometry {

// Adds the function.
void bind(nanobind::module_& m);

}  // namespace geometry
