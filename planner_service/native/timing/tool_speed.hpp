// How fast the tool's origin moves along a trajectory. That is no polynomial of time, so its peak is found by sampling.
#pragma once

#include <vector>

#include "curve.hpp"

namespace timing {

// A robot's bodies: a row of BodyTree.table for each but the base. And where the tool's origin is in its body.
struct Arm {
    static constexpr std::size_t width = 31;
    std::size_t bodies;
    const double* table;
    std::size_t tool_body;
    double tool[3];
};

// Speeds in m/s at configurations q with velocities qd, a row each.
std::vector<double> tool_speeds(const Arm& arm, std::size_t joints, std::size_t rows, const double* q, const double* qd);

// The largest along a trajectory, by sampling ever closer around the highest samples.
double peak_tool_speed(const Arm& arm, const Path& path, const Motion& motion);

}  // namespace timing
