// planner_service.native._core: one module for all compiled code but the proof's, which is certify/native.
#include "collision/kernel.hpp"
#include "timing/timing.hpp"

NB_MODULE(_core, m) {
    nanobind::set_leak_warnings(false);  // a checker that lives as long as the process is no leak
    collision::bind(m);
    timing::bind(m);
}
