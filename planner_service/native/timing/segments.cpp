#include "segments.hpp"

#include <limits>

namespace timing {

namespace {

constexpr double least_share = 1e-12, steepest = 0.625;

// |x|, or 0 for a joint that stands still.
double share_of(double x) { return std::fabs(x) > least_share ? std::fabs(x) : 0.0; }

// The smaller of a bound and limit / share, for a joint with a share.
void bound(double& most, double limit, double share) {
    if (share > 0.0) most = std::min(most, limit / share);
}

}  // namespace

Segment::Segment(const Path& along, const Limits& most, std::size_t first_piece, std::size_t end_piece, double from)
    : path(along), limits(most), first(first_piece), end(end_piece), start(from) {
    for (std::size_t k = first; k < end; ++k)
        if (k == first || path.blended(k) || path.blended(k - 1)) first_pieces.push_back(k);
}

std::vector<Section> Segment::sections() const {
    const std::size_t n = path.joints;
    std::vector<Section> out;
    std::vector<double> before(n), after(n);
    for (std::size_t k = 0; k < first_pieces.size(); ++k) {
        const std::size_t piece = first_pieces[k];
        const double from = k == 0 ? start : path.breaks[piece];
        const double to = path.breaks[k + 1 < first_pieces.size() ? first_pieces[k + 1] : end], whole = to - path.breaks[piece];
        path.tangent(piece, path.breaks[piece], before.data());
        path.tangent(piece, path.breaks[piece + 1], after.data());
        double speed = std::numeric_limits<double>::infinity(), acceleration = speed, turning = speed;
        for (std::size_t j = 0; j < n; ++j) {
            const double u = share_of(before[j]), v = share_of(after[j]), share = path.blended(piece) ? std::max(u, v) : u;
            bound(speed, limits.velocity[j], share);
            bound(acceleration, limits.acceleration[j], share);
            if (!path.blended(piece)) continue;
            const double turn = std::fabs((v > 0.0 ? after[j] : 0.0) - (u > 0.0 ? before[j] : 0.0));
            bound(turning, limits.acceleration[j], turn * 2.0 * steepest / whole);
        }
        out.push_back({from, to - from, std::min(speed, std::sqrt(turning)), acceleration, path.blended(piece)});
    }
    return out;
}

std::vector<std::size_t> Segment::moving_joints() const {
    const std::size_t n = path.joints;
    std::vector<double> tangent(n), most(n, 0.0);
    for (std::size_t piece = first; piece < end; ++piece)
        for (const double s : {path.breaks[piece], path.breaks[piece + 1]}) {
            path.tangent(piece, s, tangent.data());
            for (std::size_t j = 0; j < n; ++j) most[j] = std::max(most[j], share_of(tangent[j]));
        }
    std::vector<std::size_t> joints;
    for (std::size_t j = 0; j < n; ++j)
        if (most[j] > 0.0) joints.push_back(j);
    return joints;
}

std::size_t Segment::first_piece_at(double s) const {
    std::size_t k = 0;
    while (k + 1 < first_pieces.size() && path.breaks[first_pieces[k + 1]] <= s) ++k;
    return first_pieces[k];
}

std::vector<Segment> segments_of(const Path& path, const Limits& limits, const std::vector<std::size_t>& corners, double s, double speed) {
    std::vector<Segment> out;
    if (!(path.length() > s)) return out;
    std::size_t first = path.piece_at(s);
    const auto until = [&](std::size_t stop) {
        if (stop <= first) return;
        out.emplace_back(path, limits, first, stop, out.empty() ? s : path.breaks[first]);
        first = stop;
    };
    for (const std::size_t corner : corners)
        until(static_cast<std::size_t>(std::lower_bound(path.breaks, path.breaks + path.pieces + 1, path.knots[corner]) - path.breaks));
    until(path.pieces);
    out.front().entry = speed;
    return out;
}

std::vector<Section> straight_sections(const Path& path, const Limits& limits, const std::vector<std::size_t>& turns) {
    std::vector<Section> out;
    for (std::size_t k = 0; k <= turns.size(); ++k) {
        const std::size_t line = k == 0 ? 0 : turns[k - 1];
        const double start = path.knots[line], end = k < turns.size() ? path.knots[turns[k]] : path.length();
        double speed = std::numeric_limits<double>::infinity(), acceleration = speed;
        for (std::size_t j = 0; j < path.joints; ++j) {
            const double share = share_of(path.tangents[line * path.joints + j]);
            bound(speed, limits.velocity[j], share);
            bound(acceleration, limits.acceleration[j], share);
        }
        out.push_back({start, end - start, speed, acceleration, false});
    }
    return out;
}

}  // namespace timing
