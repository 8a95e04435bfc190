// planner_service.native._core: one module for all compiled code but the proof's, which is certify/native.
#include "collision/kernel.hpp"
#include "constraints/constraints.hpp"
#include "geometry/farthest.hpp"
#include "kinematics/kinematics.hpp"
#include "path/path.hpp"
#include "roadmap/roadmap.hpp"
#include "search/search.hpp"
#include "smoothing/smoothing.hpp"
#include "timing/timing.hpp"

NB_MODULE(_core, m) {
    nanobind::set_leak_warnings(false);  // a checker that lives as long as the process is no leak
    collision::bind(m);
    constraints::bind(m);
    geometry::bind(m);
    kinematics::bind(m);
    path::bind(m);
    roadmap::bind(m);
    search::bind(m);
    smoothing::bind(m);
    timing::bind(m);
}
