#include "profiles.hpp"

#include <algorithm>
#include <cmath>

namespace timing {

namespace {

constexpr double rounding = 2e-15, speed_tolerance = 1e-9;

double ramp_time(double v0, double v1, double acceleration) { return std::fabs(v1 - v0) / acceleration; }

double ramp_distance(double v0, double v1, double acceleration) {
    return (v0 + v1) / 2.0 * ramp_time(v0, v1, acceleration);
}

// The largest speed from ``low`` to ``high`` whose ramps fit into ``distance``; see profiles.py.
template <class Ramps>
double largest_speed(double distance, double low, double estimate, double high, Ramps ramps) {
    high = std::max(low, high);
    if (ramps(high) <= distance) return high;
    const auto narrow = [&](double guess) { (ramps(guess) <= distance ? low : high) = guess; };
    for (const double guess : {estimate * (1.0 - rounding), estimate * (1.0 + rounding)})
        if (low < guess && guess < high) narrow(guess);
    for (double middle = low + (high - low) / 2.0; low < middle && middle < high; middle = low + (high - low) / 2.0) narrow(middle);
    return low;
}

// The largest speed at one end of a section, given the speed at the other.
double reachable_speed(const Section& section, double speed) {
    if (section.blended) return speed;
    const double estimate = std::sqrt(speed * speed + 2.0 * section.acceleration * section.length);
    return largest_speed(section.length, speed, estimate, section.speed,
                         [&](double v) { return ramp_distance(speed, v, section.acceleration); });
}

// Speed up from v0, cruise if there is room, slow down to v1.
void between(const Section& section, double v0, double v1, std::vector<Phase>& phases) {
    const double distance = section.length, a = section.acceleration;
    const double estimate = std::sqrt((v0 * v0 + v1 * v1) / 2.0 + a * distance);
    const double peak = largest_speed(distance, std::max(v0, v1), estimate, section.speed,
                                      [&](double v) { return ramp_distance(v0, v, a) + ramp_distance(v, v1, a); });
    if (!(peak > 0.0)) throw Unusual();
    const double up = ramp_distance(v0, peak, a), down = ramp_distance(peak, v1, a), cruise = std::max(0.0, distance - up - down);
    for (const Phase& phase : {Phase{ramp_time(v0, peak, a), 0.0, v0, std::copysign(1.0, peak - v0) * a},
                               Phase{cruise / peak, up, peak, 0.0},
                               Phase{ramp_time(peak, v1, a), distance - down, peak, std::copysign(1.0, v1 - peak) * a}})
        if (phase.duration > 0.0) phases.push_back({phase.duration, section.start + phase.position, phase.speed, phase.acceleration});
}

}  // namespace

std::vector<Phase> trapezoid(double distance, double speed, double acceleration) {
    const bool reached = distance / speed >= speed / acceleration;
    const double peak = reached ? speed : std::sqrt(distance) * std::sqrt(acceleration), ramp = peak / acceleration;
    const double cruise = reached ? distance / speed - ramp : 0.0, ramp_way = peak * ramp / 2.0;
    std::vector<Phase> phases;
    for (const Phase& phase : {Phase{ramp, 0.0, 0.0, acceleration}, Phase{cruise, ramp_way, peak, 0.0},
                               Phase{ramp, distance - ramp_way, peak, -acceleration}})
        if (phase.duration > 0.0) phases.push_back(phase);
    return phases;
}

std::optional<std::vector<Phase>> speed_profile(const std::vector<Section>& sections, double entry) {
    const std::size_t count = sections.size();
    if (count == 1 && !sections[0].blended && entry == 0.0) {
        std::vector<Phase> at_rest = trapezoid(sections[0].length, sections[0].speed, sections[0].acceleration);
        for (Phase& phase : at_rest) phase.position = sections[0].start + phase.position;
        return at_rest;
    }
    std::vector<double> speeds{entry};
    for (std::size_t k = 0; k + 1 < count; ++k) speeds.push_back(std::min(sections[k].speed, sections[k + 1].speed));
    speeds.push_back(0.0);
    for (std::size_t k = 0; k < count; ++k) speeds[k + 1] = std::min(speeds[k + 1], reachable_speed(sections[k], speeds[k]));
    for (std::size_t k = count; k-- > 0;) speeds[k] = std::min(speeds[k], reachable_speed(sections[k], speeds[k + 1]));
    const double highest_entry = sections[0].blended ? speeds[1] : speeds[0];
    if (highest_entry < entry * (1.0 - speed_tolerance)) return std::nullopt;
    speeds[0] = entry;
    std::vector<Phase> phases;
    for (std::size_t k = 0; k < count; ++k) {
        if (!sections[k].blended) {
            between(sections[k], speeds[k], speeds[k + 1], phases);
            continue;
        }
        if (speeds[k] == 0.0) throw Unusual();
        phases.push_back({sections[k].length / speeds[k], sections[k].start, speeds[k], 0.0});
    }
    return phases;
}

double seconds(const std::vector<Phase>& phases) {
    if (phases.empty()) throw Unusual();
    double total = phases.front().duration;
    for (std::size_t k = 1; k < phases.size(); ++k) total += phases[k].duration;
    return total;
}

}  // namespace timing
