// Arithmetic with the bits of Python's and numpy's on every processor.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace arithmetic {

// math.fsum of finite numbers: their exact sum, rounded once (Shewchuk, Discrete & Computational Geometry 18, 1997).
inline double exact_sum(const std::vector<double>& values) {
    std::vector<double> parts;  // that do not overlap, in increasing order; their sum is exact
    for (double x : values) {
        std::size_t kept = 0;
        for (std::size_t k = 0; k < parts.size(); ++k) {
            double y = parts[k];
            if (std::fabs(x) < std::fabs(y)) std::swap(x, y);
            const double sum = x + y, rest = y - (sum - x);
            if (rest != 0.0) parts[kept++] = rest;
            x = sum;
        }
        parts.resize(kept);
        parts.push_back(x);
    }
    double total = 0.0, rest = 0.0;
    while (!parts.empty() && rest == 0.0) {
        const double x = total, y = parts.back();
        parts.pop_back();
        total = x + y;
        rest = y - (total - x);
    }
    // Half way between two numbers the parts that are left decide which is nearer.
    if (!parts.empty() && (rest < 0.0) == (parts.back() < 0.0)) {
        const double twice = 2.0 * rest, other = total + twice;
        if (twice == other - total) total = other;
    }
    return total;
}

// cosines_and_sines in geometry/arrays.py, in three steps, the second of which may be for several angles at once: what is left
// of an angle after whole quarter turns, Taylor series, and turning back.
struct Quarters {
    double rest;
    std::int64_t turns;
};

inline Quarters quarters_of(double x) {
    const double quarters = std::floor(x * 0.63661977236758134308 + 0.5);
    const double rest = (x - quarters * 1.57079632673412561417) - quarters * 6.07710050650619224932e-11;
    return {rest, static_cast<std::int64_t>(quarters)};
}

template <class Number>
void near_zero(const Number& r, Number& cosine, Number& sine) {
    static constexpr double odd[] = {1.0 / 355687428096000.0, -1.0 / 1307674368000.0, 1.0 / 6227020800.0, -1.0 / 39916800.0,
                                     1.0 / 362880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0};
    static constexpr double even[] = {1.0 / 20922789888000.0, -1.0 / 87178291200.0, 1.0 / 479001600.0, -1.0 / 3628800.0,
                                      1.0 / 40320.0, -1.0 / 720.0, 1.0 / 24.0, -1.0 / 2.0};
    const Number u = r * r;
    Number s = u * 0.0, c = s;
    for (const double coefficient : odd) s = s * u + coefficient;
    for (const double coefficient : even) c = c * u + coefficient;
    sine = r + r * u * s;
    cosine = 1.0 + u * c;
}

inline void turn_back(std::int64_t turns, double& cosine, double& sine) {
    if ((turns & 1) != 0) std::swap(cosine, sine);
    if (((turns + 1) & 2) != 0) cosine = -cosine;
    if ((turns & 2) != 0) sine = -sine;
}

inline void cosine_and_sine(double x, double& cosine, double& sine) {
    const Quarters quarters = quarters_of(x);
    near_zero(quarters.rest, cosine, sine);
    turn_back(quarters.turns, cosine, sine);
}

}  // namespace arithmetic
