// Timing laws, from a path to its motion: what timing/laws.py does without a speed limit of the caller's and without limits of
// jerk, to the last bit. What it leaves to Python it throws ``Unusual`` for.
#pragma once

#include <array>
#include <stdexcept>
#include <vector>

#include "peaks.hpp"
#include "segments.hpp"

namespace timing {

struct Law {
    int gridpoints;  // of TOPP-RA; 0 for one constant speed on each blend
};

// There is no motion that keeps the limits: what ``TimingFailed`` of timing/profiles.py says.
struct Failed : std::runtime_error {
    using std::runtime_error::runtime_error;
};

// The motion along one segment, to rest.
std::vector<Phase> phases_of(const Law& law, const Segment& segment);

// A motion along all of a path, with what Trajectory computes when it is made.
struct TimedPath {
    std::vector<double> durations, coefficients, knots, ends;
    std::vector<std::int64_t> geometry;
    std::array<Peak, 3> peaks;  // before it was slowed down
    double dilation = 1.0;

    Motion motion() const;
};

// From where to where in s a motion goes, and whether it begins at rest.
struct Span {
    double begin, end;
    bool from_rest;
};

// A motion of these durations and coefficients along a part of a path, with what Trajectory computes when it is made.
TimedPath lawful_motion(const Path& path, const std::vector<std::size_t>& corners, std::vector<double> durations,
                        std::vector<double> coefficients, const Span& span);

// The fastest motion of a law along a path that stops at these waypoints, slowed down if that exceeds a limit.
TimedPath time_path(const Law& law, const Path& path, const Limits& limits, const std::vector<std::size_t>& corners);

// The motion along the rest of a path from s on, where it has a speed; its limits are not verified. ``Failed`` if there is none.
std::vector<Phase> continue_to_rest(const Law& law, const Path& path, const Limits& limits, const std::vector<std::size_t>& corners,
                                    double s, double speed, double blend_share);

// Seconds of trapezoids along a path without its blends, which stops at these waypoints.
double stop_duration(const Path& path, const Limits& limits, const std::vector<std::size_t>& turns);

}  // namespace timing
