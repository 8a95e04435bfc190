#include "two_passes.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace timing {

namespace {

constexpr double nowhere = 1e-12;         // a smaller coefficient of u leaves a bound of x alone
constexpr double rounding = 1e-13;        // a gap this small is none
constexpr double slack = 1e-9;            // a gap that rounding may explain
constexpr int most_steps = 200;
const double no_number = std::numeric_limits<double>::quiet_NaN();

struct Line {
    double offset, slope;
    double at(double x) const { return offset + slope * x; }
};

// What bounds the acceleration u and the squared speed x at one point: lower(x) <= u <= upper(x) for all lines, x <= most.
class Program {
  public:
    explicit Program(std::size_t rows) { lower_.reserve(2 * rows + 1), upper_.reserve(2 * rows + 1); }

    // The limits at point i, those of point i + 1 as they are after the step, and the speeds from which that is left.
    void set(const Grid& grid, std::size_t i, double next_square) {
        lower_.clear(), upper_.clear();
        most_ = grid.squares[i];
        const double step = 2.0 * (grid.points[i + 1] - grid.points[i]);
        const std::size_t n = grid.rows;
        const auto constant = [&](std::size_t at) { return grid.constant == nullptr ? 0.0 : grid.constant[at]; };
        for (std::size_t k = 0; k < n; ++k) add(grid.first[i * n + k], grid.second[i * n + k], constant(i * n + k), grid.limit[k]);
        for (std::size_t k = 0; k < n; ++k) {
            const std::size_t at = (i + 1) * n + k;
            add(grid.first[at] + step * grid.second[at], grid.second[at], constant(at), grid.limit[k]);
        }
        const double slope = -1.0 / step;
        lower_.push_back({0.0, slope});
        upper_.push_back({next_square / step, slope});
    }

    double lowest(double x, Line& line) const {
        double best = -std::numeric_limits<double>::infinity();
        for (const Line& each : lower_) {
            const double u = each.at(x);
            if (u > best) best = u, line = each;
        }
        return best;
    }

    double highest(double x, Line& line) const {
        double best = std::numeric_limits<double>::infinity();
        for (const Line& each : upper_) {
            const double u = each.at(x);
            if (u < best) best = u, line = each;
        }
        return best;
    }

    // The largest x that leaves room for u, by Newton's method from above: lowest - highest is convex in x.
    double largest_square() const {
        double x = most_;
        Line low{}, high{};
        for (int step = 0; step < most_steps; ++step) {
            const double bottom = lowest(x, low), gap = bottom - highest(x, high);
            if (gap <= rounding * (1.0 + std::fabs(bottom))) return x;
            const double slope = low.slope - high.slope;
            if (!(slope > 0.0)) return gap <= slack * (1.0 + std::fabs(bottom)) ? x : no_number;
            const double before = x;
            x -= gap / slope;
            if (x >= before) return before;
            if (x < 0.0) return x > -slack * (1.0 + most_) ? 0.0 : no_number;
        }
        return no_number;
    }

  private:
    std::vector<Line> lower_, upper_;
    double most_ = 0.0;

    // -limit <= a u + b x + c <= limit.
    void add(double a, double b, double c, double limit) {
        const double least = -limit - c, largest = limit - c, slope = -b / a;
        if (std::fabs(a) < nowhere) {
            if (std::fabs(b) > nowhere) most_ = std::min(most_, (b > 0.0 ? largest : least) / b);
            return;
        }
        lower_.push_back({(a > 0.0 ? least : largest) / a, slope});
        upper_.push_back({(a > 0.0 ? largest : least) / a, slope});
    }
};

}  // namespace

std::vector<double> two_passes(const Grid& grid, double entry) {
    const std::size_t last = grid.count - 1;
    Program program(grid.rows);
    std::vector<double> reachable(grid.count), speeds(grid.count);
    for (std::size_t i = last; i-- > 0;) {  // backward: the squared speeds from which the rest can be travelled
        program.set(grid, i, reachable[i + 1]);
        reachable[i] = program.largest_square();
        if (!(reachable[i] >= 0.0)) return {};
    }
    double x = entry * entry;
    if (!(x <= reachable[0] + 1e-5)) return {};
    speeds[0] = entry;
    for (std::size_t i = 0; i < last; ++i) {  // forward: as fast as possible
        program.set(grid, i, reachable[i + 1]);
        Line line{};
        const double bottom = program.lowest(x, line), top = program.highest(x, line);
        if (!(bottom <= top + slack * (1.0 + std::fabs(bottom)))) return {};
        double next = x + 2.0 * (grid.points[i + 1] - grid.points[i]) * top;
        const double lowered = next - 1e-8, share = 0.9999 * next;  // as toppra does, so that rounding cannot exceed a limit
        next = lowered > share ? lowered : share;
        x = next > 0.0 ? (next < reachable[i + 1] ? next : reachable[i + 1]) : 0.0;
        speeds[i + 1] = std::sqrt(x);
    }
    return speeds;
}

}  // namespace timing
