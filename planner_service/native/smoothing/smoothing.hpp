// Shortens polylines and finds how wide their corners may be blended: smoothing/smoothing.py says how.
// What the oracle throws passes through. tests/reference/smoothing.py has the same bits, questions and order.
#pragma once

#include <nanobind/nanobind.h>

#include <cstdint>
#include <vector>

#include "../search/constrained_oracle.hpp"

namespace smoothing {

using Polyline = std::vector<search::Configuration>;

// ``draws``: two random numbers for each cut that may be tried.
Polyline shortcut(const Polyline& waypoints, search::Oracle& oracle, const std::vector<double>& draws, int misses);

// The same on constraints, in steps of at most ``longest``.
Polyline shortcut_on(const Polyline& waypoints, search::ConstrainedOracle& oracle, const std::vector<double>& draws, int misses,
                     double longest);

Polyline pulled_in(Polyline chain, search::Oracle& oracle);

Polyline without_short_pieces(Polyline chain, search::Oracle& oracle);

// A path before its corners are blended, as JointPath has it.
struct Corners {
    std::size_t joints, waypoint_count;
    const double *waypoints, *knots, *tangents;
    std::vector<std::int64_t> corners;
    const double* sizes;  // of each waypoint
};

// The widest free blend of each of the corners, 0 if none is as wide as ``least``.
std::vector<double> blend_widths(const Corners& path, search::Oracle& oracle, double least);

// Adds these functions.
void bind(nanobind::module_& m);

}  // namespace smoothing
