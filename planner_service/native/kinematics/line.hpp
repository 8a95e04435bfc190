// Straight lines of the tool: inverse.py and wxai_inverse.py, to the last bit. What is not an ordinary line (one that ends
// early, or a pose that leaves an angle free) is left to them. Lines are thinned as cartesian_waypoints.py says.
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

// ``WxaiInverse``.
struct ClosedForm {
    double shoulder[2], upper[2], fore[2], hand[2];  // x, z
    double last, signs[6], low[6], high[6];
    double waist[9], base_offset[3], tool[9], tool_offset[3];
    double upper_square, fore_square, fold, fold_angle;

    static constexpr std::size_t numbers = 55;
    explicit ClosedForm(const double* values);
};

// Waypoints (n each, one after the other) of the whole line; none if it is left to Python.
std::optional<std::vector<double>> walk(const Arm& arm, const ClosedForm* closed_form, const Pose& begin, const Pose& end,
                                        const double* start, int points, const Hypot& hypot);

// The rows of a line (N, n) that keep the tool on it; ``stops`` are kept, the last of them the last row.
std::vector<int> thinned(const Arm& arm, const double* waypoints, int rows, const std::vector<int>& stops, const Hypot& hypot);

}  // namespace kinematics
