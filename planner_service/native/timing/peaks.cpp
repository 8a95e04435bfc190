#include "peaks.hpp"

#include <limits>
#include <optional>
#include <vector>

namespace timing {

namespace {

constexpr double tolerance = 1e-9, least_share = 1e-12;  // TOLERANCE and MIN_SHARE of limit_check.py

// Relative error of a peak on a blend: a thousandth of the tolerance.
constexpr double exact = 1e-12;

// Rounds of splitting intervals of time, and as many more for every so many intervals at the start. Every fifth round halves
// them, and after 60 halvings both ends are one number. For intervals that are then still open the bound counts.
constexpr std::size_t most_rounds = 300, intervals_per_most = 1200;

// Intervals split per round: those with the highest bounds, since a peak found there rules out most of the others.
constexpr std::size_t batch = 24;
constexpr double infinity = std::numeric_limits<double>::infinity();

// The larger of two as numpy has it: what is no number wins.
double larger(double a, double b) { return std::isnan(a) || a >= b ? a : b; }
double smaller(double a, double b) { return std::isnan(a) || a <= b ? a : b; }

// Index of the largest; the first of equals, and of what is no number.
std::size_t index_of_largest(const std::vector<double>& values) {
    std::size_t best = 0;
    for (std::size_t k = 0; k < values.size(); ++k) {
        if (std::isnan(values[k])) return k;
        if (values[k] > values[best]) best = k;
    }
    return best;
}

double largest(const std::vector<double>& values) { return values[index_of_largest(values)]; }

// The largest rate x share / limit; ``rates`` and ``times`` have ``columns`` numbers for each row.
Peak straight_peak(const std::vector<double>& rates, const std::vector<double>& times, std::size_t columns,
                   const std::vector<double>& share, const double* limit, std::size_t joints) {
    const std::size_t rows = rates.size() / columns;
    std::vector<double> per_joint(share.size()), ratios(share.size());
    std::vector<std::size_t> fastest(rows);
    for (std::size_t r = 0; r < rows; ++r) {
        const std::vector<double> own(rates.begin() + static_cast<std::ptrdiff_t>(r * columns),
                                      rates.begin() + static_cast<std::ptrdiff_t>((r + 1) * columns));
        fastest[r] = index_of_largest(own);
        for (std::size_t k = 0; k < joints; ++k) {
            const std::size_t at = r * joints + k;
            per_joint[at] = share[at] > 0.0 ? share[at] / limit[k] : 0.0;
            ratios[at] = own[fastest[r]] * per_joint[at];
        }
    }
    if (!(largest(ratios) < infinity))
        for (std::size_t at = 0; at < ratios.size(); ++at) {
            if (!(per_joint[at] > 0.0)) ratios[at] = 0.0;
            else if (std::isnan(ratios[at])) ratios[at] = infinity;
        }
    const std::size_t at = index_of_largest(ratios), row = at / joints;
    return {ratios[at], at % joints, times[row * columns + fastest[row]]};
}

void straight_peaks(const Path& path, const Motion& motion, const std::vector<const double*>& limits,
                    const std::vector<std::size_t>& rows, std::array<Peak, 3>& peaks) {
    if (rows.empty()) return;
    const std::size_t n = path.joints;
    std::vector<double> share, speeds, rates, times, jerks, starts;
    for (const std::size_t row : rows) {
        const double* line = path.tangents + static_cast<std::size_t>(path.lines[motion.geometry[row]]) * n;
        for (std::size_t k = 0; k < n; ++k) share.push_back(std::fabs(line[k]) > least_share ? std::fabs(line[k]) : 0.0);
        const double *c = motion.cubic(row), h = motion.durations[row], start = motion.knots[row];
        const double turning = smaller(larger(c[3] != 0.0 ? -c[2] / (3.0 * c[3]) : 0.0, 0.0), h);
        for (const double at : {0.0, turning, h}) {
            speeds.push_back(std::fabs(c[1] + at * (2.0 * c[2] + 3.0 * c[3] * at)));
            rates.push_back(std::fabs(2.0 * c[2] + 6.0 * c[3] * at));
            times.push_back(start + at);
        }
        jerks.push_back(std::fabs(6.0 * c[3]));
        starts.push_back(start);
    }
    peaks[0] = straight_peak(speeds, times, 3, share, limits[0], n);
    peaks[1] = straight_peak(rates, times, 3, share, limits[1], n);
    if (limits.size() > 2) peaks[2] = straight_peak(jerks, starts, 1, share, limits[2], n);
}

// The largest jump of acceleration as a peak with an infinite ratio; none if acceleration never jumps. The arm is at rest before
// and after; a start at speed continues another motion and is no jump. The path's own curvature adds nothing: it is zero where
// blends meet straight pieces, and where the path is passed at speed it is smooth.
std::optional<Peak> jump(const Path& path, const Motion& motion) {
    const std::size_t n = path.joints, count = motion.count;
    std::vector<double> first(count * n), last(count * n), begins((count + 1) * n), ends((count + 1) * n);
    double fastest = motion.cubic(0)[1];
    for (std::size_t k = 0; k < count; ++k) {
        const auto piece = static_cast<std::size_t>(motion.geometry[k]);
        path.tangent(piece, motion.cubic(k)[0], &first[k * n]);
        path.tangent(piece, motion.ends[k], &last[k * n]);
        fastest = larger(fastest, motion.cubic(k)[1]);
    }
    for (std::size_t k = 0; k + 1 < count; ++k)
        if (motion.cubic(k + 1)[1] > tolerance * fastest)
            std::copy(&first[(k + 1) * n], &first[(k + 1) * n] + n, &last[k * n]);
    std::vector<double> jumps(begins.size());
    double highest = 0.0;
    for (std::size_t k = 0; k < count; ++k) {
        const double* c = motion.cubic(k);
        const double at_start = 2.0 * c[2], at_end = 2.0 * c[2] + 6.0 * c[3] * motion.durations[k];
        for (std::size_t j = 0; j < n; ++j) {
            begins[k * n + j] = first[k * n + j] * at_start;
            ends[(k + 1) * n + j] = last[k * n + j] * at_end;
            highest = larger(larger(highest, std::fabs(begins[k * n + j])), std::fabs(ends[(k + 1) * n + j]));
        }
    }
    for (std::size_t k = 0; k < jumps.size(); ++k) jumps[k] = std::fabs(begins[k] - ends[k]);
    if (motion.cubic(0)[1] > tolerance * fastest) std::fill(jumps.begin(), jumps.begin() + static_cast<std::ptrdiff_t>(n), 0.0);
    const std::size_t at = index_of_largest(jumps);
    if (jumps[at] <= tolerance * highest) return std::nullopt;
    return Peak{infinity, at % n, motion.knots[at / n]};
}

// The coefficients of a polynomial, the constant term first, or those of Bernstein's form. A velocity on a blend has the highest
// degree: f is of degree five, and y and ds/dt are of degrees three and two where s(t) has jerk.
class Polynomial {
  public:
    static constexpr std::size_t most = 18;

    explicit Polynomial(std::size_t size) : size_(size) { std::fill(values_, values_ + size, 0.0); }
    std::size_t size() const { return size_; }
    double& operator[](std::size_t k) { return values_[k]; }
    double operator[](std::size_t k) const { return values_[k]; }
    const double* begin() const { return values_; }
    const double* end() const { return values_ + size_; }
    void pop_back() { --size_; }
    void insert_constant(double term) {
        std::copy_backward(values_, values_ + size_, values_ + size_ + 1);
        values_[0] = term;
        ++size_;
    }

  private:
    double values_[most];
    std::size_t size_;
};

Polynomial product(const Polynomial& a, const Polynomial& b) {
    Polynomial out(a.size() + b.size() - 1);
    for (std::size_t i = 0; i < b.size(); ++i)
        for (std::size_t k = 0; k < a.size(); ++k) out[i + k] += a[k] * b[i];
    return out;
}

void differentiate(Polynomial& a, double h) {
    for (std::size_t k = 1; k < a.size(); ++k) a[k - 1] = a[k] * static_cast<double>(k) / h;
    a.pop_back();
}

// Bernstein coefficients over [0, 1].
Polynomial bernstein(const Polynomial& a) {
    const std::size_t n = a.size() - 1;
    Polynomial out(a);
    double choose = 1.0;
    for (std::size_t i = 0; i <= n; ++i) {
        out[i] = a[i] / choose;
        choose = choose * static_cast<double>(n - i) / static_cast<double>(i + 1);  // exact: the product is a whole number
    }
    for (std::size_t i = n; i-- > 0;)
        for (std::size_t k = i + 1; k <= n; ++k) out[k] = out[k - 1] + out[k];
    return out;
}

// ds/dt, and f(y(s)) ds/dt, as polynomials on one piece of time that lies on a blend, which runs from 0 to 1.
// With u and v the tangents before and after the corner, the velocity is u ds/dt + (v - u) f ds/dt.
struct Rates {
    Polynomial plain, turning;
};

Rates rates_of(const Blend& blend, const double* c, double h, std::size_t terms) {
    const double y0 = (c[0] - blend.s) / blend.width, cube = y0 * y0 * y0;
    Polynomial travel(terms), y(terms), speed(terms);
    double power = h;
    for (std::size_t k = 0; k < terms; ++k) {
        travel[k] = c[k + 1] * power;
        y[k] = travel[k] / blend.width;
        speed[k] = travel[k] * static_cast<double>(k + 1) / h;
        power *= h;
    }
    Polynomial share(1);
    share[0] = -0.125;
    for (const double term : {-0.625 * y0, -1.25 * y0 * y0, -1.25 * cube, 0.625 * (1.0 - cube * y0),
                              0.5 + y0 * (5.0 - cube * y0) / 8.0}) {
        share = product(share, y);
        share.insert_constant(term);
    }
    Rates out{Polynomial(share.size() + terms - 1), product(share, speed)};
    for (std::size_t k = 0; k < terms; ++k) out.plain[k] = speed[k];
    return out;
}

// Bernstein coefficients of each joint's ratio to its limit on pieces of time: for each piece ``size`` rows of ``joints``.
struct Ratios {
    std::size_t pieces, size, joints;
    std::vector<double> values;

    double* row(std::size_t piece, std::size_t i) { return &values[(piece * size + i) * joints]; }
};

struct Interval {
    std::size_t row;  // piece of time x joints + joint
    double low, high, bound;
    Polynomial b;
};

double largest_size(const Polynomial& b) {
    double out = std::fabs(b[0]);
    for (const double value : b) out = larger(out, std::fabs(value));
    return out;
}

double where_to_split(const Polynomial& b) {
    const std::size_t n = b.size() - 1;
    const double first = b[1] - b[0], last = b[n] - b[n - 1];
    double share = first / (first - last);
    if (n > 1) {
        const double after = first / (2.0 * b[1] - b[0] - b[2]), before = last / (2.0 * b[n - 1] - b[n] - b[n - 2]);
        const auto degree = static_cast<double>(n - 1);
        const double near = (std::fabs(first) < std::fabs(last) ? after : degree + before) / degree;
        if (near > 0.0 && near < 1.0) share = near;
    }
    if (!(first * last < 0.0)) share = 0.5;
    return smaller(larger(share, exact), 1.0 - exact);
}

// The highest absolute value of polynomials on pieces of time, or ``best`` if that is higher. A polynomial lies
// between its smallest and largest Bernstein coefficients: intervals that cannot exceed the best value so far are dropped, the
// others split (de Casteljau) until none is left. If some are left after all rounds, or overflow, their bound is the peak.
class Search {
  public:
    Search(Peak best, std::size_t joints, const std::vector<double>& starts, const std::vector<double>& durations)
        : best_(best), joints_(joints), starts_(starts), durations_(durations) {}

    Peak highest(Ratios& ratios) {
        std::vector<double> begins, ends, bounds;
        for (std::size_t piece = 0; piece < ratios.pieces; ++piece)
            for (std::size_t k = 0; k < joints_; ++k) {
                begins.push_back(std::fabs(ratios.row(piece, 0)[k]));
                ends.push_back(std::fabs(ratios.row(piece, ratios.size - 1)[k]));
                double bound = begins.back();
                for (std::size_t i = 1; i < ratios.size; ++i) bound = larger(bound, std::fabs(ratios.row(piece, i)[k]));
                bounds.push_back(bound);
            }
        better(begins, [](std::size_t k) { return Place{k, 0.0}; });
        better(ends, [](std::size_t k) { return Place{k, 1.0}; });
        std::vector<Interval> intervals;
        for (std::size_t row = 0; row < bounds.size(); ++row) {
            if (!(bounds[row] > best_.ratio * (1.0 + exact))) continue;
            intervals.push_back({row, 0.0, 1.0, bounds[row], Polynomial(ratios.size)});
            for (std::size_t i = 0; i < ratios.size; ++i) intervals.back().b[i] = ratios.row(row / joints_, i)[row % joints_];
        }
        const std::size_t rounds = most_rounds * (1 + bounds.size() / intervals_per_most);
        for (std::size_t count = 0; count <= rounds; ++count) {
            const double needed = best_.ratio * (1.0 + exact);
            intervals.erase(std::remove_if(intervals.begin(), intervals.end(),
                                           [&](const Interval& each) { return !(each.bound > needed); }),
                            intervals.end());
            if (intervals.empty()) break;
            bounds.clear();
            for (const Interval& each : intervals) bounds.push_back(each.bound);
            if (count == rounds || largest(bounds) == infinity) {
                better(bounds, [&](std::size_t k) { return Place{intervals[k].row, intervals[k].low}; });
                break;
            }
            if (intervals.size() > batch)
                std::stable_sort(intervals.begin(), intervals.end(),
                                 [](const Interval& a, const Interval& b) { return a.bound > b.bound; });
            split(intervals, count % 5 == 4);
        }
        return best_;
    }

  private:
    Peak best_;
    std::size_t joints_;
    const std::vector<double>&starts_, &durations_;

    struct Place {
        std::size_t row;
        double share;
    };

    template <class At>
    void better(const std::vector<double>& values, At at) {
        const std::size_t k = index_of_largest(values);
        if (!(values[k] > best_.ratio)) return;
        const Place found = at(k);
        const std::size_t piece = found.row / joints_;
        best_ = {values[k], found.row % joints_, starts_[piece] + found.share * durations_[piece]};
    }

    // Splits the first intervals (de Casteljau): their first parts come first, then their second parts, then the others.
    void split(std::vector<Interval>& intervals, bool in_half) {
        const std::size_t now = std::min(batch, intervals.size());
        std::vector<Interval> out(intervals.begin(), intervals.begin() + static_cast<std::ptrdiff_t>(now));
        std::vector<double> values;
        std::vector<Interval> seconds;
        for (Interval& first : out) {
            const double share = in_half ? 0.5 : where_to_split(first.b);
            Interval second = first;
            const double middle = first.low + share * (first.high - first.low);
            const std::size_t size = first.b.size();
            for (std::size_t k = 1; k < size; ++k) {
                for (std::size_t j = 0; j + k < size; ++j) second.b[j] += share * (second.b[j + 1] - second.b[j]);
                first.b[k] = second.b[0];
            }
            first.high = second.low = middle;
            first.bound = largest_size(first.b);
            second.bound = largest_size(second.b);
            values.push_back(std::fabs(second.b[0]));
            seconds.push_back(std::move(second));
        }
        better(values, [&](std::size_t k) { return Place{seconds[k].row, seconds[k].low}; });
        out.insert(out.end(), std::make_move_iterator(seconds.begin()), std::make_move_iterator(seconds.end()));
        out.insert(out.end(), std::make_move_iterator(intervals.begin() + static_cast<std::ptrdiff_t>(now)),
                   std::make_move_iterator(intervals.end()));
        intervals = std::move(out);
    }
};

void blend_peaks(const Path& path, const Motion& motion, const std::vector<const double*>& limits,
                 const std::vector<std::size_t>& rows, std::array<Peak, 3>& peaks) {
    const std::size_t n = path.joints;
    std::size_t terms = 1;  // fewer where s(t) has no jerk
    for (const std::size_t row : rows)
        for (std::size_t k = 1; k < 3; ++k)
            if (motion.cubic(row)[k + 1] != 0.0) terms = std::max(terms, k + 1);
    std::vector<Rates> rates;
    std::vector<double> starts, durations, before(rows.size() * n), turn(rows.size() * n);
    for (std::size_t r = 0; r < rows.size(); ++r) {
        const auto piece = static_cast<std::size_t>(motion.geometry[rows[r]]);
        path.tangent(piece, path.breaks[piece], &before[r * n]);
        path.tangent(piece, path.breaks[piece + 1], &turn[r * n]);
        for (std::size_t k = 0; k < n; ++k) turn[r * n + k] -= before[r * n + k];
        starts.push_back(motion.knots[rows[r]]);
        durations.push_back(motion.durations[rows[r]]);
        rates.push_back(rates_of(path.blend(piece), motion.cubic(rows[r]), durations[r], terms));
    }
    for (std::size_t order = 0; order < limits.size(); ++order) {
        const double* limit = limits[order];
        Ratios ratios{rows.size(), rates[0].plain.size(), n, std::vector<double>(rows.size() * rates[0].plain.size() * n)};
        bool all_finite = true;
        for (std::size_t r = 0; r < rows.size(); ++r) {
            const Polynomial plain = bernstein(rates[r].plain), turning = bernstein(rates[r].turning);
            const double *u = &before[r * n], *w = &turn[r * n];
            for (std::size_t i = 0; i < plain.size(); ++i) {
                double* row = ratios.row(r, i);
                for (std::size_t k = 0; k < n; ++k) row[k] = (u[k] * plain[i] + w[k] * turning[i]) / limit[k];
                for (std::size_t k = 0; k < n; ++k) all_finite &= std::isfinite(row[k]);
                if (all_finite) continue;
                for (std::size_t k = 0; k < n; ++k) {
                    if (u[k] * plain[i] + w[k] * turning[i] == 0.0) row[k] = 0.0;  // a joint that stands still may have any limit
                    if (std::isnan(row[k])) row[k] = infinity;
                }
            }
            differentiate(rates[r].plain, durations[r]);
            differentiate(rates[r].turning, durations[r]);
        }
        peaks[order] = Search(peaks[order], n, starts, durations).highest(ratios);
    }
}

}  // namespace

std::array<Peak, 3> trajectory_peaks(const Path& path, const Motion& motion, const Limits& limits) {
    std::array<Peak, 3> peaks;
    if (motion.count == 0) return peaks;
    const std::optional<Peak> jumping = jump(path, motion);
    std::vector<const double*> orders{limits.velocity, limits.acceleration};
    if (!jumping) orders.push_back(limits.jerk);
    std::vector<std::size_t> straight, blended;
    for (std::size_t k = 0; k < motion.count; ++k)
        (path.blended(static_cast<std::size_t>(motion.geometry[k])) ? blended : straight).push_back(k);
    straight_peaks(path, motion, orders, straight, peaks);
    if (!blended.empty()) blend_peaks(path, motion, orders, blended, peaks);
    if (jumping) peaks[2] = *jumping;
    return peaks;
}

}  // namespace timing
