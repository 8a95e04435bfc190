// How close a motion comes to the limits of its joints: what ``peaks`` of timing/limit_check.py says.
#pragma once

#include <array>

#include "segments.hpp"

namespace timing {

struct Peak {
    double ratio = 0.0;
    std::size_t joint = 0;
    double time = 0.0;
};

// The peaks of velocity, acceleration and jerk, each relative to its limit.
std::array<Peak, 3> trajectory_peaks(const Path& path, const Motion& motion, const Limits& limits);

}  // namespace timing
