#include "law.hpp"

#include <cstdio>
#include <limits>
#include <optional>
#include <string>

#include "../arithmetic.hpp"
#include "two_passes.hpp"

namespace timing {

namespace {

constexpr double short_segment = 1e-3, least_run_up = 1e-6, most_speed = 1e4, steepest = 0.625;
constexpr int blend_gridpoints = 24, least_gridpoints = 4;
constexpr double half_pi = 1.57079632679489661923;
constexpr double tolerance = 1e-9, overshoot = 1e-9, rounding = 1e-14, most_dilation = 1e9;

void require(bool usual) {
    if (!usual) throw Unusual();
}

// Throws the message, or ``Unusual`` where limits are such that Python would say something else.
[[noreturn]] void fail(const Segment& segment, const std::string& message) {
    for (std::size_t j = 0; j < segment.path.joints; ++j)
        for (const double limit : {segment.limits.velocity[j], segment.limits.acceleration[j]})
            require(limit > 0.0 && std::isfinite(limit));
    throw Failed("TOPP-RA" + message);
}

// A number as Python's ``:.6g`` writes it.
std::string six_digits(double x) {
    char out[32];
    std::snprintf(out, sizeof out, "%.6g", x);
    return out;
}

bool finite(const std::vector<double>& values) {
    return std::all_of(values.begin(), values.end(), [](double x) { return std::isfinite(x); });
}

// Whether a blend leaves no usable straight section to the stop after it or, from rest, to the stop before it.
bool blend_at_stop(const std::vector<Section>& sections, double entry) {
    const std::size_t count = sections.size();
    if (count == 1) return sections[0].blended;
    const auto unusable = [](const Section& end, const Section& inner) {
        return end.blended || end.length < least_run_up * inner.length;
    };
    return unusable(sections[count - 1], sections[count - 2]) || (!(entry > 0.0) && unusable(sections[0], sections[1]));
}

// Seconds of a trapezoid as long as all sections together, under the lowest limits of any.
double slowest_seconds(const std::vector<Section>& sections) {
    std::vector<double> lengths;
    double speed = sections[0].speed, acceleration = sections[0].acceleration;
    for (const Section& section : sections) {
        lengths.push_back(section.length);
        speed = std::min(speed, section.speed);
        acceleration = std::min(acceleration, section.acceleration);
    }
    return seconds(trapezoid(arithmetic::exact_sum(lengths), speed, acceleration));
}

// The grid points of a section, as shares of it from 0 to 1.
std::vector<double> grid_of(const Section& section, const Segment& segment, int gridpoints) {
    std::vector<double> grid;
    if (section.blended) {
        for (int k = 0; k <= blend_gridpoints; ++k) grid.push_back(k / static_cast<double>(blend_gridpoints));
        return grid;
    }
    const int share = static_cast<int>(std::ceil(gridpoints * (section.length / segment.length())));
    const int count = std::max(std::min(gridpoints, least_gridpoints), share);
    for (int k = 0; k <= count; ++k) {
        double cosine, sine;
        arithmetic::cosine_and_sine(half_pi * k / count, cosine, sine);
        grid.push_back(sine * sine);
    }
    return grid;
}

// ds/dt at the grid points, one section after the other. ``unit``: about the motion's duration.
std::vector<double> optimal_speeds(const Segment& segment, const std::vector<Section>& sections,
                                   const std::vector<std::vector<double>>& grids, double unit) {
    const Path& path = segment.path;
    const double length = segment.length(), scaled = segment.entry * (unit / length);
    std::vector<double> points;
    for (std::size_t k = 0; k < sections.size(); ++k)
        for (std::size_t i = 0; i + 1 < grids[k].size(); ++i)
            points.push_back((sections[k].start - segment.start) / length + grids[k][i] * (sections[k].length / length));
    points.push_back(1.0);
    for (std::size_t i = 0; i + 1 < points.size(); ++i)
        if (!(points[i + 1] > points[i]))
            fail(segment, " on the segment from s = " + six_digits(segment.start) + ": grid points of a tiny blend coincide");
    const std::vector<std::size_t> joints = segment.moving_joints();
    const std::size_t n = joints.size();
    std::vector<double> first, second, squares, acceleration, tangent(path.joints);
    first.reserve(points.size() * n);
    second.reserve(points.size() * n);
    for (const std::size_t j : joints) {
        acceleration.push_back(segment.limits.acceleration[j] * (unit * unit));
        require(std::isfinite(segment.limits.velocity[j] * unit));
    }
    for (const double point : points) {
        const double s = segment.start + point * length;
        const std::size_t piece = segment.first_piece_at(s);
        path.tangent(piece, s, tangent.data());
        double bend = 0.0, width = 1.0;
        const double *u = nullptr, *v = nullptr;
        if (path.blended(piece)) {
            const Blend blend = path.blend(piece);
            const double y = blend.y(s);
            bend = steepest * (1.0 - y * y * y * y);
            width = blend.width, u = blend.before, v = blend.after;
        }
        double speed = std::numeric_limits<double>::infinity();
        const double share = path.blended(piece) ? segment.blend_share : 1.0;
        for (const std::size_t j : joints) {
            const double slope = tangent[j] * length, curve = u == nullptr ? 0.0 : (v[j] - u[j]) * bend / width * (length * length);
            if (slope != 0.0) speed = std::min(speed, segment.limits.velocity[j] * unit / std::fabs(slope));
            first.push_back(segment.blend_share < 1.0 ? slope / share : slope);
            second.push_back(segment.blend_share < 1.0 ? curve / share : curve);
        }
        if (segment.blend_share < 1.0) {
            speed = speed * share;
            if (squares.empty()) speed = std::max(speed, scaled);
        }
        speed = std::min(speed, most_speed);
        squares.push_back(speed * speed);
    }
    require(finite(first) && finite(second) && finite(acceleration) && std::isfinite(scaled));
    const Grid grid{n, points.size(), first.data(), second.data(), nullptr, acceleration.data(), squares.data(), points.data()};
    std::vector<double> speeds = two_passes(grid, scaled);
    if (speeds.empty() || !finite(speeds))
        fail(segment, ": no motion from s = " + six_digits(segment.start) + " at ds/dt = " + six_digits(segment.entry) +
                          " to rest keeps the limits");
    for (double& speed : speeds) speed = speed * (length / unit);
    speeds[0] = segment.entry;
    return speeds;
}

// The motion with these speeds at the grid points and constant acceleration in between.
std::vector<Phase> constant_accelerations(const Segment& segment, const std::vector<Section>& sections,
                                          const std::vector<std::vector<double>>& grids, const std::vector<double>& speeds) {
    std::vector<Phase> phases;
    std::size_t at = 0;
    for (std::size_t k = 0; k < sections.size(); ++k)
        for (std::size_t i = 0; i + 1 < grids[k].size(); ++i, ++at) {
            const double before = grids[k][i] * sections[k].length, after = grids[k][i + 1] * sections[k].length;
            const double v0 = speeds[at], v1 = speeds[at + 1];
            if (!(v0 + v1 > 0.0))
                fail(segment, ": speed 0 from s = " + six_digits(sections[k].start + before) + " to " +
                                  six_digits(sections[k].start + after));
            const double duration = 2.0 * (after - before) / (v0 + v1);
            require(duration != 0.0);
            phases.push_back({duration, sections[k].start + before, v0, (v1 - v0) / duration});
        }
    return phases;
}

// The fastest motion, ``unit`` being about its duration; ``Failed`` if there is none.
std::vector<Phase> time_optimal(const Segment& segment, const std::vector<Section>& sections, int gridpoints, double unit) {
    std::vector<std::vector<double>> grids;
    for (const Section& section : sections) grids.push_back(grid_of(section, segment, gridpoints));
    return constant_accelerations(segment, sections, grids, optimal_speeds(segment, sections, grids, unit));
}

// What Trajectory checks, with half its slack: what only nearly passes is left to Python.
void require_lawful(const TimedPath& timed, const Path& path, const std::vector<std::size_t>& corners, const Span& span) {
    const std::size_t count = timed.durations.size();
    const double *c = timed.coefficients.data();
    require(count > 0 && span.end > span.begin && finite(timed.durations) && finite(timed.coefficients) && c[0] == span.begin);
    double jumps = 0.0, fastest = 0.0;
    std::vector<double> arrivals, slowest;
    for (std::size_t k = 0; k < count; ++k, c += 4) {
        const double h = timed.durations[k];
        const auto rate = [&](double x) { return c[1] + x * (2.0 * c[2] + 3.0 * c[3] * x); };
        require(h > 0.0 && timed.ends[k] >= c[0] && std::isfinite(2.0 * c[2] + 6.0 * c[3] * h));
        jumps += std::fabs(c[0] + h * (c[1] + h * (c[2] + h * c[3])) - timed.ends[k]);
        arrivals.push_back(rate(h));
        const double turning = c[3] != 0.0 ? std::min(std::max(-c[2] / (3.0 * c[3]), 0.0), h) : 0.0;
        slowest.push_back(std::min(std::min(c[1], arrivals.back()), rate(turning)));
        fastest = std::max(fastest, std::max(c[1], arrivals.back()));
    }
    const double slack = overshoot * fastest / 2.0;
    require(finite(arrivals) && jumps <= (overshoot + rounding * path.length() * static_cast<double>(count)) / 2.0);
    c = timed.coefficients.data();
    for (std::size_t k = 0; k < count; ++k) {
        const double departure = k > 0 ? arrivals[k - 1] : span.from_rest ? 0.0 : c[1];
        require(slowest[k] >= -slack && std::fabs(departure - c[4 * k + 1]) <= slack);
    }
    require(arrivals.back() <= slack);
    for (const std::size_t corner : corners) {
        if (!(span.begin < path.knots[corner] && path.knots[corner] < span.end)) continue;
        std::size_t k = 0;
        while (k < count && !(c[4 * k] == path.knots[corner] && c[4 * k + 1] <= slack)) ++k;
        require(k < count);
    }
}

// The piece of the path on which each piece of s(t) runs: _geometry in trajectory.py.
void locate(TimedPath& timed, const Path& path) {
    const double gap = overshoot + rounding * path.length();
    timed.geometry.clear();
    for (std::size_t k = 0; k < timed.durations.size(); ++k) {
        const double start = timed.coefficients[4 * k], end = timed.ends[k];
        const double middle = std::min(start + (end - start) / 2.0, std::nextafter(end, 0.0));
        const std::size_t piece = path.piece_at(middle);
        const std::size_t after = path.piece_at(std::min(start + gap, middle)), before = path.piece_at(std::max(end - gap, middle));
        require(after == before || !(path.blended(after) || path.blended(before) || path.blended(piece)));
        timed.geometry.push_back(static_cast<std::int64_t>(piece));
    }
}

// Computes what follows from the durations and the coefficients.
void complete(TimedPath& timed, const Path& path, const std::vector<std::size_t>& corners, const Span& span) {
    timed.ends.clear();
    timed.knots.assign(1, 0.0);
    for (std::size_t k = 0; k < timed.durations.size(); ++k) {
        timed.ends.push_back(k + 1 < timed.durations.size() ? timed.coefficients[4 * (k + 1)] : span.end);
        timed.knots.push_back(timed.knots.back() + timed.durations[k]);
    }
    require_lawful(timed, path, corners, span);
    locate(timed, path);
}

}  // namespace

Motion TimedPath::motion() const {
    return {durations.size(), durations.data(), coefficients.data(), knots.data(), ends.data(), geometry.data()};
}

std::vector<Phase> phases_of(const Law& law, const Segment& segment) {
    const std::vector<Section> sections = segment.sections();
    std::optional<std::vector<Phase>> closed_form;
    if (!blend_at_stop(sections, segment.entry)) closed_form = speed_profile(sections, segment.entry);
    if (law.gridpoints == 0) {
        require(closed_form.has_value());
        return *closed_form;
    }
    if (closed_form && (sections.size() == 1 || segment.length() < short_segment)) return *closed_form;
    double unit = slowest_seconds(sections);
    if (closed_form) unit = std::min(seconds(*closed_form), unit);
    try {
        std::vector<Phase> optimal = time_optimal(segment, sections, law.gridpoints, unit);
        return closed_form && seconds(*closed_form) < seconds(optimal) ? *closed_form : optimal;
    } catch (const Failed&) {
        if (!closed_form) throw;
        return *closed_form;
    }
}

TimedPath lawful_motion(const Path& path, const std::vector<std::size_t>& corners, std::vector<double> durations,
                        std::vector<double> coefficients, const Span& span) {
    TimedPath timed;
    timed.durations = std::move(durations);
    timed.coefficients = std::move(coefficients);
    complete(timed, path, corners, span);
    return timed;
}

TimedPath time_path(const Law& law, const Path& path, const Limits& limits, const std::vector<std::size_t>& corners) {
    TimedPath timed;
    const Span whole{0.0, path.length(), true};
    for (const Segment& segment : segments_of(path, limits, corners, 0.0, 0.0))
        for (const Phase& phase : phases_of(law, segment)) {
            timed.durations.push_back(phase.duration);
            for (const double c : {phase.position, phase.speed, phase.acceleration / 2.0, 0.0}) timed.coefficients.push_back(c);
        }
    complete(timed, path, corners, whole);
    timed.peaks = trajectory_peaks(path, timed.motion(), limits);
    const double velocity = timed.peaks[0].ratio, acceleration = timed.peaks[1].ratio;
    if (std::max(velocity, acceleration) <= 1.0 + tolerance) return timed;
    const double factor = std::max(velocity, std::pow(acceleration, 0.5));
    require(factor >= 1.0 / most_dilation && factor <= most_dilation);
    timed.dilation = factor;
    const double powers[] = {1.0, factor, factor * factor, factor * factor * factor};
    for (double& duration : timed.durations) duration = duration * factor;
    for (std::size_t k = 0; k < timed.coefficients.size(); ++k) timed.coefficients[k] = timed.coefficients[k] / powers[k % 4];
    complete(timed, path, corners, whole);
    return timed;
}

std::vector<Phase> continue_to_rest(const Law& law, const Path& path, const Limits& limits, const std::vector<std::size_t>& corners,
                                    double s, double speed, double blend_share) {
    std::vector<Phase> out;
    for (Segment& segment : segments_of(path, limits, corners, s, speed)) {
        segment.blend_share = blend_share;
        for (const Phase& phase : phases_of(law, segment)) {
            require(phase.duration > 0.0 && std::isfinite(phase.duration) && std::isfinite(phase.acceleration));
            out.push_back(phase);
        }
    }
    return out;
}

double stop_duration(const Path& path, const Limits& limits, const std::vector<std::size_t>& turns) {
    require(path.length() > 0.0);
    double total = 0.0;
    for (const Section& section : straight_sections(path, limits, turns))
        for (const Phase& phase : trapezoid(section.length, section.speed, section.acceleration)) total += phase.duration;
    require(std::isfinite(total));
    return total;
}

}  // namespace timing
