// Where a driver's setpoint can be as each of some targets comes; gate/tracking.py has the argument.
#pragma once

#include <cstddef>
#include <vector>

namespace timing {

// Of n joints each, when the first target comes.
struct Setpoint {
    const double *place, *radius, *speed, *change, *due;
};

struct Course {
    std::vector<double> places, radii, going, before, changes, due;  // ``due`` is empty where it is ``places``
};

// ``low``, ``in_time`` and ``high``: the shares of its way that a setpoint has covered when the next target comes, at least, without
// jitter, and at most. ``aside``: where it is due is not where it is about.
Course course(std::size_t n, std::size_t count, const Setpoint& now, const double* targets, double low, double in_time, double high,
              double goal_time, bool aside);

}  // namespace timing
