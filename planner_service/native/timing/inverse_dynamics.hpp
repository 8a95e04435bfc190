// Joint torques by the recursive Newton-Euler algorithm: what timing/torque_bound.py says.
#pragma once

#include <cstddef>
#include <vector>

#include "../kinematics/arm.hpp"

namespace timing {

// A body's mass, its centre, and its tensor about that by rows.
struct BodyInertia {
    double mass, centre[3], tensor[9];
};

// Torques (cases, count, joints) of motions through ``count`` configurations q (count, joints), each with several rates and
// accelerations (cases, count, joints) and gravities (cases). ``bodies`` has one more than the arm: the fixed base is first.
std::vector<double> inverse_dynamics(const kinematics::Arm& arm, const std::vector<BodyInertia>& bodies, std::size_t count,
                                     std::size_t cases, const double* q, const double* qd, const double* qdd, const double* gravity);

}  // namespace timing
