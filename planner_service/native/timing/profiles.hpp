// Motions along a line with bounded speed and acceleration: the part of timing/profiles.py without limits of jerk, bit for bit.
#pragma once

#include <optional>
#include <vector>

namespace timing {

// Thrown where Python would raise or the numbers are extreme: the reference in Python then decides.
struct Unusual {};

// An interval of time with constant acceleration, and the motion where it starts.
struct Phase {
    double duration, position, speed, acceleration;
};

// One straight line or one blend, where it starts in s, and its limits; on a blend only that of the speed counts.
struct Section {
    double start, length, speed, acceleration;
    bool blended;
};

// The fastest rest-to-rest motion, from position 0.
std::vector<Phase> trapezoid(double distance, double speed, double acceleration);

// speed_profile; none if the entry speed is too high to slow down in time.
std::optional<std::vector<Phase>> speed_profile(const std::vector<Section>& sections, double entry);

double seconds(const std::vector<Phase>& phases);

}  // namespace timing
