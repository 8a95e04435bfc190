#include "setpoint.hpp"

#include <algorithm>
#include <cmath>

namespace timing {

Course course(std::size_t n, std::size_t count, const Setpoint& now, const double* targets, double low, double in_time, double high,
              double goal_time, bool aside) {
    const double mean = 0.5 * (low + high), off = 0.5 * (high - low);
    const std::size_t rows = (count + 1) * n;
    Course out;
    out.going.resize(count * n);
    for (auto* each : {&out.places, &out.radii, &out.before, &out.changes}) each->resize(rows);
    if (aside) out.due.resize(rows);
    std::copy(now.place, now.place + n, out.places.begin());
    std::copy(now.radius, now.radius + n, out.radii.begin());
    std::copy(now.speed, now.speed + n, out.before.begin());
    std::copy(now.change, now.change + n, out.changes.begin());
    if (aside) std::copy(now.due, now.due + n, out.due.begin());
    for (std::size_t k = 0, next = n; k < count * n; ++k, ++next) {
        const double target = targets[k], way = target - out.places[k];
        out.places[next] = (1.0 - mean) * out.places[k] + mean * target;
        out.radii[next] = (1.0 - low) * out.radii[k] + off * std::abs(way);
        if (aside) out.due[next] = (1.0 - in_time) * out.due[k] + in_time * target;
        out.going[k] = (aside ? target - out.due[k] : way) / goal_time;
        const bool stands = low >= 1.0;  // it was at the target, and stood still, when the next came
        out.before[next] = stands ? 0.0 : out.going[k];
        out.changes[next] = stands ? 0.0 : out.going[k] - out.before[k];
    }
    return out;
}

}  // namespace timing
