// A path and a motion along it, as timing needs them: path/joint_path.py and path/trajectory.py, to the last bit.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace timing {

// One blend; see path/corner_blend.py.
struct Blend {
    std::size_t joints;
    double s, width;
    const double *corner, *before, *after;

    double y(double at) const { return std::min(std::max((at - s) / width, -1.0), 1.0); }

    void position(double at, double* out) const {
        const double y_at = y(at), square = y_at * y_at;
        const double turned = (y_at + 1.0) / 2.0 + (square - 1.0) * 0.3125 - (square * square * square - 1.0) / 48.0;
        for (std::size_t k = 0; k < joints; ++k) {
            const double start = corner[k] - before[k] * width, end = corner[k] + after[k] * width;
            const double low = std::min(std::min(start, corner[k]), end), high = std::max(std::max(start, corner[k]), end);
            const double along = before[k] * (y_at + 1.0 - turned) + after[k] * turned;
            out[k] = std::min(std::max(start + along * width, low), high);
        }
    }

    void tangent(double at, double* out) const {
        const double y_at = y(at), square = y_at * y_at, share = 0.5 + y_at * (5.0 - square * square) / 8.0;
        for (std::size_t k = 0; k < joints; ++k) out[k] = before[k] + (after[k] - before[k]) * share;
    }
};

// JointPath.tables; see there.
struct Path {
    std::size_t joints, waypoint_count, pieces;
    const double *waypoints, *knots, *tangents, *breaks;
    const std::int64_t *lines, *rows;  // of each piece between breaks: its line, and its blend or -1
    const double* blends;              // of each blend s, width; corner, before, after, n numbers each

    bool blended(std::size_t piece) const { return rows[piece] >= 0; }
    double length() const { return knots[waypoint_count - 1]; }

    Blend blend(std::size_t piece) const {
        const double* from = blends + static_cast<std::size_t>(rows[piece]) * (2 + 3 * joints);
        return {joints, from[0], from[1], from + 2, from + 2 + joints, from + 2 + 2 * joints};
    }

    // The index of the piece on which s lies; at a break that of the later one.
    std::size_t piece_at(double s) const {
        const auto after = static_cast<std::size_t>(std::upper_bound(breaks, breaks + pieces + 1, s) - breaks);
        return std::min(after - 1, pieces - 1);
    }

    // dq/ds, continued beyond the ends of the piece.
    void tangent(std::size_t piece, double s, double* out) const {
        const double* line = tangents + static_cast<std::size_t>(lines[piece]) * joints;
        if (!blended(piece)) {
            std::copy(line, line + joints, out);
            return;
        }
        blend(piece).tangent(s, out);
    }

    // q(s), for s from 0 to the path's length.
    void position(double s, double* out) const {
        const std::size_t piece = piece_at(s);
        if (!blended(piece)) {
            const auto line = static_cast<std::size_t>(lines[piece]);
            const double *a = waypoints + line * joints, *b = a + joints;
            const double share = (s - knots[line]) / (knots[line + 1] - knots[line]);
            for (std::size_t k = 0; k < joints; ++k) out[k] = share < 1.0 ? a[k] + (b[k] - a[k]) * share : b[k];
            return;
        }
        if (s == 0.0 || s == length()) {
            const double* end = s == 0.0 ? waypoints : waypoints + (waypoint_count - 1) * joints;
            std::copy(end, end + joints, out);
            return;
        }
        blend(piece).position(s, out);
    }
};

// s(t) in pieces, c0 + c1 x + c2 x^2 + c3 x^3 each, with x the time since its start; Trajectory's fields of these names.
struct Motion {
    std::size_t count;
    const double *durations, *coefficients, *knots, *ends;  // ends: s where each piece ends
    const std::int64_t* geometry;                           // the piece of the path on which each runs

    const double* cubic(std::size_t k) const { return coefficients + 4 * k; }
    double duration() const { return knots[count]; }
};

}  // namespace timing
