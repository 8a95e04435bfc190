// Numbers known up to an error, and enclosures of sines, cosines and angles (docs/design/certified-ik.md states the lemmas).
// Nothing is rounded outwards step by step: what uses these adds one bound of all rounding errors, far above them, at the end.
#pragma once

#include <algorithm>
#include <cmath>

#include "../arithmetic.hpp"

namespace kinematics {

constexpr double pi = 3.14159265358979323846;

// Every number within ``rad`` of ``mid``.
struct Ball {
    double mid = 0.0, rad = 0.0;
};

inline Ball operator+(Ball a, Ball b) { return {a.mid + b.mid, a.rad + b.rad}; }
inline Ball operator*(Ball a, double x) { return {a.mid * x, a.rad * std::fabs(x)}; }
inline Ball operator*(Ball a, Ball b) {
    return {a.mid * b.mid, std::fabs(a.mid) * b.rad + a.rad * (std::fabs(b.mid) + b.rad)};
}
inline double largest(Ball a) { return std::fabs(a.mid) + a.rad; }

struct Span {
    double low = 0.0, high = 0.0;

    double middle() const { return 0.5 * (low + high); }
    double half() const { return 0.5 * (high - low); }
};

// Above the error of arithmetic::cosine_and_sine for angles up to 1000 (Lemma 1), and of ``angle_of`` (Lemma 2).
constexpr double sine_error = 4e-15, angle_error = 1e-13;

// Cosines and sines of all angles of a span within 1000 (Lemma 1).
inline void cosines_and_sines(Span angles, Ball& cosine, Ball& sine) {
    double c[2], s[2];
    arithmetic::cosine_and_sine(angles.low, c[0], s[0]);
    arithmetic::cosine_and_sine(angles.high, c[1], s[1]);
    double low_c = std::min(c[0], c[1]), high_c = std::max(c[0], c[1]);
    double low_s = std::min(s[0], s[1]), high_s = std::max(s[0], s[1]);
    const double first = std::ceil(angles.low / (0.5 * pi) - 1e-9), last = std::floor(angles.high / (0.5 * pi) + 1e-9);
    for (double quarter = first; quarter <= std::min(last, first + 3.0); quarter += 1.0) {  // where one of them is 1 or -1
        switch (static_cast<long>(quarter) & 3) {
            case 0: high_c = 1.0; break;
            case 1: high_s = 1.0; break;
            case 2: low_c = -1.0; break;
            default: low_s = -1.0;
        }
    }
    cosine = {0.5 * (low_c + high_c), 0.5 * (high_c - low_c) + sine_error};
    sine = {0.5 * (low_s + high_s), 0.5 * (high_s - low_s) + sine_error};
}

// The angle of (x, y) != 0 from the x axis, in [-pi, pi] (Lemma 2).
inline double angle_of(double y, double x) {
    static constexpr double eighths[] = {0.0, 0.12435499454676144, 0.24497866312686414, 0.3587706702705722, 0.4636476090008061,
                                         0.5585993153435624, 0.6435011087932844, 0.7188299996216245, 0.7853981633974483};
    const double a = std::fabs(x), b = std::fabs(y);
    const bool steep = b > a;
    const double t = steep ? a / b : b / a, base = std::floor(8.0 * t + 0.5);
    const double u = (t - 0.125 * base) / (1.0 + 0.125 * base * t), v = u * u;
    const double series = 1.0 - v * (1.0 / 3 - v * (1.0 / 5 - v * (1.0 / 7 - v * (1.0 / 9 - v * (1.0 / 11)))));
    double angle = eighths[static_cast<int>(base)] + u * series;
    if (steep) angle = 0.5 * pi - angle;
    if (x < 0.0) angle = pi - angle;
    return y < 0.0 ? -angle : angle;
}

// The angle in [0, pi] whose cosine is x in [-1, 1] (Lemma 2).
inline double angle_with_cosine(double x) { return angle_of(std::sqrt((1.0 - x) * (1.0 + x)), x); }

}  // namespace kinematics
