// Damped least squares towards a pose of the tool: numeric_inverse.py, to the last bit.
#pragma once

#include "arm.hpp"

namespace kinematics {

// Moves ``q`` within bounds to a configuration with the tool at rows ``target`` (three of four); whether it arrives.
bool descend(const Arm& arm, const double* target, const double* lower, const double* upper, int steps, double* q,
             std::vector<Frame>& frames);

}  // namespace kinematics
