#pragma once

#include <nanobind/nanobind.h>

namespace timing {

// Adds ``time_path``, ``continue_to_rest``, ``stop_duration``, ``two_passes``, ``tool_speeds`` and ``TrajectoryTables``.
void bind(nanobind::module_& m);

}  // namespace timing
