#include "curve.hpp"

#include <algorithm>
#include <cmath>

namespace proof {

namespace {

constexpr int newton_steps = 6;

double integral(double y) {
    const double square = y * y;
    return (y + 1.0) / 2.0 + (square - 1.0) * 0.3125 - (square * square * square - 1.0) / 48.0;
}

double moved_to(double y, double before, double after, double width) {
    const double turned = integral(y);
    const double along = before * (y + 1.0 - turned) + after * turned;
    return along * width;
}

// y where a joint turns back on a blend; see _turning in corner_blend.py.
double turning_of(double before, double after) {
    if (!(before * after < 0.0)) return 1.0;
    const double share = before / (before - after), wanted = std::sqrt(std::min(share, 1.0 - share));
    double z = std::min(wanted / std::sqrt(1.25), 1.0);
    for (int step = 0; step < newton_steps; ++step) {
        const double rest = 1.25 + z * (-1.25 + z * (0.625 - 0.125 * z));
        const double slope = rest + z * (-0.625 + z * (0.625 - 0.1875 * z)), root = std::sqrt(rest);
        z = std::min(z + (wanted - z * root) * root / slope, 1.0);
    }
    return share > 0.5 ? 1.0 - z : z - 1.0;
}

}  // namespace

Curve::Curve(std::size_t dof, const PathTables& tables) : n_(dof), t_(tables), travelled_(tables.pieces * dof, 0.0) {
    for (std::size_t piece = 0; piece < t_.pieces; ++piece) {
        if (t_.rows[piece] < 0) continue;
        const double* before = t_.blends + static_cast<std::size_t>(t_.rows[piece]) * (2 + 3 * n_) + 2 + n_;
        turnings_.resize(std::max(turnings_.size(), (static_cast<std::size_t>(t_.rows[piece]) + 1) * n_));
        double* turnings = &turnings_[static_cast<std::size_t>(t_.rows[piece]) * n_];
        for (std::size_t k = 0; k < n_; ++k) turnings[k] = turning_of(before[k], before[n_ + k]);
    }
    std::vector<double> q(n_), moved(n_);
    for (std::size_t piece = 0; piece + 1 < t_.pieces; ++piece) {
        on_piece(piece, t_.breaks[piece + 1], q.data(), moved.data());
        for (std::size_t k = 0; k < n_; ++k) travelled_[(piece + 1) * n_ + k] = travelled_[piece * n_ + k] + moved[k];
    }
}

void Curve::at(double s, double* q, double* travel) const {
    const double end = length();
    s = std::min(std::max(s, 0.0), end);
    if (t_.pieces == 0) {
        std::copy(t_.waypoints, t_.waypoints + n_, q);
        std::fill(travel, travel + n_, 0.0);
        return;
    }
    const auto after = static_cast<std::size_t>(std::upper_bound(t_.breaks, t_.breaks + t_.pieces + 1, s) - t_.breaks);
    const std::size_t piece = std::min(after - 1, t_.pieces - 1);
    on_piece(piece, s, q, travel);
    for (std::size_t k = 0; k < n_; ++k) travel[k] = travelled_[piece * n_ + k] + travel[k];
    if (s == 0.0) std::copy(t_.waypoints, t_.waypoints + n_, q);
    if (s == end) {
        const double* last = t_.waypoints + (t_.waypoint_count - 1) * n_;
        std::copy(last, last + n_, q);
    }
}

bool Curve::strays(double start, double end, double* out) const {
    std::fill(out, out + n_, 0.0);
    if (t_.pieces == 0) return true;
    const double *first = t_.breaks, *last = t_.breaks + t_.pieces;  // without the end of the last piece
    const auto before = static_cast<std::size_t>(std::upper_bound(first + 1, last, start) - first) - 1;
    const auto after = static_cast<std::size_t>(std::lower_bound(first + 1, last, end) - first) - 1;
    bool turns = false;
    for (std::size_t piece = before; piece <= after; ++piece) {
        const bool blend = t_.rows[piece] >= 0;
        if (!blend && (piece == before || t_.rows[piece - 1] >= 0)) continue;
        if (turns) return false;
        turns = true;
        const double *one, *two;
        double share = 1.0;
        if (blend) {
            one = t_.blends + static_cast<std::size_t>(t_.rows[piece]) * (2 + 3 * n_) + 2 + n_;
            two = one + n_;
            share = turned(piece, end) - turned(piece, start);
        } else {
            one = t_.tangents + static_cast<std::size_t>(t_.lines[piece - 1]) * n_;
            two = t_.tangents + static_cast<std::size_t>(t_.lines[piece]) * n_;
        }
        for (std::size_t k = 0; k < n_; ++k) out[k] = 0.25 * (end - start) * (share * std::fabs(two[k] - one[k]));
    }
    return true;
}

double Curve::turned(std::size_t piece, double s) const {
    const double* blend = t_.blends + static_cast<std::size_t>(t_.rows[piece]) * (2 + 3 * n_);
    const double y = std::min(std::max((s - blend[0]) / blend[1], -1.0), 1.0), square = y * y;
    return 0.5 + y * (0.625 - 0.125 * square * square);
}

void Curve::on_piece(std::size_t piece, double s, double* q, double* moved) const {
    if (t_.rows[piece] >= 0) {
        on_blend(static_cast<std::size_t>(t_.rows[piece]), s, q, moved);
        return;
    }
    const auto line = static_cast<std::size_t>(t_.lines[piece]);
    on_line(line, s, q);
    const double since = s - t_.breaks[piece];
    for (std::size_t k = 0; k < n_; ++k) moved[k] = std::fabs(t_.tangents[line * n_ + k]) * since;
}

void Curve::on_line(std::size_t line, double s, double* q) const {
    const double *a = t_.waypoints + line * n_, *b = a + n_;
    const double start = t_.knots[line], end = t_.knots[line + 1];
    const double share = (s - start) / (end - start);
    for (std::size_t k = 0; k < n_; ++k) q[k] = share < 1.0 ? a[k] + (b[k] - a[k]) * share : b[k];
}

void Curve::on_blend(std::size_t row, double s, double* q, double* moved) const {
    const double *blend = t_.blends + row * (2 + 3 * n_), *turnings = &turnings_[row * n_];
    const double width = blend[1], y = std::min(std::max((s - blend[0]) / width, -1.0), 1.0);
    for (std::size_t k = 0; k < n_; ++k) {
        const double *at = blend + 2 + k, corner = at[0], before = at[n_], after = at[2 * n_], turning = turnings[k];
        const double start = corner - before * width, end = corner + after * width;
        const double here = moved_to(y, before, after, width);
        const double low = std::min(std::min(start, corner), end), high = std::max(std::max(start, corner), end);
        q[k] = std::min(std::max(start + here, low), high);
        const double there = moved_to(std::min(y, turning), before, after, width);
        moved[k] = std::fabs(there) + std::fabs(here - there);
    }
}

}  // namespace proof
