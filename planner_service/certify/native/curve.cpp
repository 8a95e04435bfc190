#include "curve.hpp"

#include <algorithm>
#include <cmath>

namespace proof {

namespace {

double integral(double y) {
    const double square = y * y;
    return (y + 1.0) / 2.0 + (square - 1.0) * 0.3125 - (square * square * square - 1.0) / 48.0;
}

double moved_to(double y, double before, double after, double width) {
    const double turned = integral(y);
    const double along = before * (y + 1.0 - turned) + after * turned;
    return along * width;
}

}  // namespace

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
    const auto line = static_cast<std::size_t>(t_.lines[piece]);
    if (t_.rows[piece] >= 0) {
        on_blend(static_cast<std::size_t>(t_.rows[piece]), s, q, travel);
    } else {
        on_line(line, s, q);
        const double since = s - t_.breaks[piece];
        for (std::size_t k = 0; k < n_; ++k) travel[k] = std::fabs(t_.tangents[line * n_ + k]) * since;
    }
    for (std::size_t k = 0; k < n_; ++k) travel[k] = t_.travelled[piece * n_ + k] + travel[k];
    if (s == 0.0) std::copy(t_.waypoints, t_.waypoints + n_, q);
    if (s == end) {
        const double* last = t_.waypoints + (t_.waypoint_count - 1) * n_;
        std::copy(last, last + n_, q);
    }
}

void Curve::on_line(std::size_t line, double s, double* q) const {
    const double *a = t_.waypoints + line * n_, *b = a + n_;
    const double start = t_.knots[line], end = t_.knots[line + 1];
    const double share = (s - start) / (end - start);
    for (std::size_t k = 0; k < n_; ++k) q[k] = share < 1.0 ? a[k] + (b[k] - a[k]) * share : b[k];
}

void Curve::on_blend(std::size_t row, double s, double* q, double* moved) const {
    const double* blend = t_.blends + row * (2 + 4 * n_);
    const double width = blend[1], y = std::min(std::max((s - blend[0]) / width, -1.0), 1.0);
    for (std::size_t k = 0; k < n_; ++k) {
        const double *at = blend + 2 + k, corner = at[0], before = at[n_], after = at[2 * n_], turning = at[3 * n_];
        const double start = corner - before * width, end = corner + after * width;
        const double here = moved_to(y, before, after, width);
        const double low = std::min(std::min(start, corner), end), high = std::max(std::max(start, corner), end);
        q[k] = std::min(std::max(start + here, low), high);
        const double there = moved_to(std::min(y, turning), before, after, width);
        moved[k] = std::fabs(there) + std::fabs(here - there);
    }
}

}  // namespace proof
