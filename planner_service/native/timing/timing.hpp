#pragma once

#include <nanobind/nanobind.h>

namespace timing {

// Adds ``two_passes``, ``trajectory_peaks`` and ``tool_speeds``.
void bind(nanobind::module_& m);

}  // namespace timing
