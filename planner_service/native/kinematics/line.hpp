// The closed-form inverse kinematics of arms built like the WidowX AI (tool_arm.py), and straight lines of the tool
// (tool_line.py). Lines are thinned as cartesian_waypoints.py says.
#pragma once

#include <functional>
#include <optional>

#include "arm.hpp"

namespace kinematics {

// Python's own ``math.hypot``, of so many numbers: the C library's has other bits.
using Hypot = std::function<double(const double*, int)>;

struct Pose {
    double position[3];
    double quaternion[4];  // w, x, y, z
};

// ``closed_form`` of tool_arm.py.
struct ClosedForm {
    double shoulder[2], upper[2], fore[2], hand[2];  // x, z
    double last, signs[6], low[6], high[6];
    double waist[9], base_offset[3], tool[9], tool_offset[3];
    double upper_square, fore_square, fold, fold_angle;

    static constexpr std::size_t numbers = 55;
    explicit ClosedForm(const double* values);
};

// Every configuration within the limits for a pose, those that reach forward before those backwards. Where it leaves an angle
// free, an even spread, and before that what keeps the angles of ``near`` (rows of six).
std::vector<std::vector<double>> solve(const Arm& arm, const ClosedForm& closed_form, const Pose& pose,
                                       const std::vector<std::vector<double>>& near, const Hypot& hypot);

// Whether a pose leaves no angle free.
bool determined(const Arm& arm, const ClosedForm& closed_form, const Pose& pose, const Hypot& hypot);

// Waypoints (n each, one after the other), and which share of the line is behind each. If it ends early: the share at which the
// pose is that could not be reached, and the configuration (n) nearest to the last for it, if there is one.
struct Walked {
    std::vector<double> waypoints, fractions;
    std::optional<double> stop;
    std::vector<double> beyond;
};

Walked walk(const Arm& arm, const ClosedForm* closed_form, const Pose& begin, const Pose& end, const double* start, int points,
            const Hypot& hypot);

// The rows of a line (N, n) that keep the tool on it; ``stops`` are kept, the last of them the last row.
std::vector<int> thinned(const Arm& arm, const double* waypoints, int rows, const std::vector<int>& stops, const Hypot& hypot);

}  // namespace kinematics
