#include "underway.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace timing {

namespace {

constexpr double meeting = 5e-10;  // arc length up to which s is taken for a break of the path
constexpr double sliver = 1e-12;   // seconds: a shorter piece of time is left out
constexpr double least_share = 1e-12, steepest = 0.625;
constexpr int intervals = 24;  // of constant braking on a whole blend

// The tangent at s, and how it changes.
struct Rates {
    std::vector<double> slope, bend;
};

Rates rates_at(const Path& path, std::size_t piece, double s) {
    Rates out{std::vector<double>(path.joints), std::vector<double>(path.joints, 0.0)};
    path.tangent(piece, s, out.slope.data());
    if (!path.blended(piece)) return out;
    const Blend blend = path.blend(piece);
    const double y = blend.y(s), turning = steepest * (1.0 - y * y * y * y);
    for (std::size_t k = 0; k < path.joints; ++k) out.bend[k] = (blend.after[k] - blend.before[k]) * turning / blend.width;
    return out;
}

// The least and the largest value of d2s/dt2 that is within the limits.
struct Window {
    double low = -std::numeric_limits<double>::infinity(), high = std::numeric_limits<double>::infinity();

    bool open() const { return -std::numeric_limits<double>::infinity() < low && low <= high; }

    // Those at a place at which the square of ds/dt is ``square`` + ``twice`` times the value.
    void narrow(const Rates& rates, double square, double twice, const double* acceleration) {
        for (std::size_t k = 0; k < rates.slope.size(); ++k) {
            const double per_change = rates.slope[k] + twice * rates.bend[k];
            if (!(std::fabs(per_change) > least_share)) continue;
            const double fixed = rates.bend[k] * square;
            const double a = (-acceleration[k] - fixed) / per_change, b = (acceleration[k] - fixed) / per_change;
            low = std::max(low, std::min(a, b));
            high = std::min(high, std::max(a, b));
        }
    }
};

}  // namespace

double Underway::moved(double s) const {
    const double on = std::min(std::max(s - begin, 0.0), left.length());
    const double* end_of_breaks = left.breaks + left.pieces + 1;
    for (const double* at = std::lower_bound(left.breaks, end_of_breaks, on - 2.0 * meeting); at != end_of_breaks; ++at) {
        if (std::fabs(*at - on) <= meeting) return *at;
        if (*at > on) break;
    }
    return on;
}

State Underway::at(double t) const {
    if (law.count == 0 || t >= law.duration()) return {moved(end), 0.0};
    t = std::max(t, 0.0);
    const auto after = static_cast<std::size_t>(std::upper_bound(law.knots, law.knots + law.count + 1, t) - law.knots);
    const std::size_t k = std::min(after, law.count) - 1;
    const double x = std::min(std::max(t - law.knots[k], 0.0), law.durations[k]), *c = law.cubic(k);
    const double s = std::min(std::max(c[0] + x * (c[1] + x * (c[2] + x * c[3])), c[0]), law.ends[k]);
    return {moved(s), std::max(c[1] + x * (2.0 * c[2] + 3.0 * c[3] * x), 0.0)};
}

std::vector<Row> Underway::rows(double until) const {
    std::vector<Row> out;
    const auto before = static_cast<std::size_t>(std::lower_bound(law.knots, law.knots + law.count + 1, splice) - law.knots);
    for (std::size_t k = before > 0 ? before - 1 : 0; k < law.count; ++k) {
        const double x = std::max(splice - law.knots[k], 0.0), last = std::min(until - law.knots[k], law.durations[k]), *c = law.cubic(k);
        if (!(last - x > sliver)) continue;
        const double s = x > 0.0 ? c[0] + x * (c[1] + x * (c[2] + x * c[3])) : c[0];
        const double rate = std::max(c[1] + x * (2.0 * c[2] + 3.0 * c[3] * x), 0.0);
        out.push_back({last - x, moved(s), rate, c[2] + 3.0 * c[3] * x, c[3]});
    }
    return out;
}

std::optional<Braking> Underway::braking(const State& from, double rest, const double* acceleration, double margin) const {
    Braking out;
    double s = from.s, rate = from.rate;
    rest = std::min(rest, left.length());
    while (s < rest) {
        const std::size_t piece = left.piece_at(s);
        const double begins = left.breaks[piece], ends = left.breaks[piece + 1], stop = std::min(ends, rest);
        const double share = std::ceil(intervals * (stop - s) / (ends - begins));
        const int steps = left.blended(piece) ? std::max(1, static_cast<int>(share)) : 1;
        const auto place = [&](int k) { return std::min(s + (stop - s) * (k / static_cast<double>(steps)), stop); };
        double a = place(0);
        Rates here = rates_at(left, piece, a);
        for (int k = 0; k < steps; ++k) {
            const double b = place(k + 1), length = b - a;
            double square = rate * rate;
            Rates there = rates_at(left, piece, b);
            Window at_first;
            at_first.narrow(here, square, 0.0, acceleration);
            Window window = at_first;
            window.narrow(there, square, 2.0 * length, acceleration);
            if (!window.open()) window = at_first;
            if (!window.open()) return std::nullopt;
            const double change = window.low + margin * (window.high - window.low);
            square += 2.0 * change * length;
            if (square <= 0.0) {
                out.rows.push_back({rate / -change, a, rate, change / 2.0, 0.0});
                out.end = std::min(a + rate * rate / (-2.0 * change), b);
                return out;
            }
            const double after = std::sqrt(square);
            out.rows.push_back({2.0 * (b - a) / (rate + after), a, rate, change / 2.0, 0.0});
            rate = after, a = b, here = std::move(there);
        }
        s = a;
    }
    return std::nullopt;
}

}  // namespace timing
