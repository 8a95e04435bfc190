// Damped least squares towards a pose of the tool: Levenberg-Marquardt steps whose damping is proportional to the squared error
// (Sugihara, IEEE T-RO 27(5), 2011); the steps of numeric_inverse.py.
#pragma once

#include "arm.hpp"

namespace kinematics {

// Moves ``q`` within bounds to a configuration with the tool at rows ``target`` (three of four); whether it arrives.
bool descend(const Arm& arm, const double* target, const double* lower, const double* upper, int steps, double* q,
             std::vector<Frame>& frames);

}  // namespace kinematics
