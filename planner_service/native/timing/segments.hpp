// The segments of a path between its stops, and the limits along each: timing/segments.py, bit for bit.
#pragma once

#include <vector>

#include "curve.hpp"
#include "profiles.hpp"

namespace timing {

struct Limits {
    const double *velocity, *acceleration, *jerk;
};

// The part of a path between two stops: pieces [first, end). It may start at speed, on the way.
struct Segment {
    const Path& path;
    const Limits& limits;
    std::size_t first, end;
    double start;
    double entry = 0.0;
    double blend_share = 1.0;  // of the limits, that may be used on blends
    std::vector<std::size_t> first_pieces;  // of its sections

    Segment(const Path& path, const Limits& limits, std::size_t first, std::size_t end, double start);

    double length() const { return path.breaks[end] - start; }
    // Its straight sections, including the waypoints that lie on them, and its blends.
    std::vector<Section> sections() const;
    std::vector<std::size_t> moving_joints() const;
    // The first piece of the section on which s lies.
    std::size_t first_piece_at(double s) const;
};

// The segments from s on, or from the start; the speed is that at s.
std::vector<Segment> segments_of(const Path& path, const Limits& limits, const std::vector<std::size_t>& corners, double s, double speed);

// Of a path without its blends, which stops at each of these waypoints.
std::vector<Section> straight_sections(const Path& path, const Limits& limits, const std::vector<std::size_t>& turns);

}  // namespace timing
