#include "projector.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace constraints {

namespace {

// These are those of kinematics/constraint_set.py.
constexpr double KEPT = 0.8, AIM = 0.5, SAMPLE = 0.95, BOUND = 0.97, ROUNDING = 1e-9, FACING_AWAY = 1e-9, LEAST_PROGRESS = 0.1, MOST_DETOUR = 2.0;
constexpr double DAMPING = 1e-6, LEAST_DAMPING = 1e-12, LONGEST_STEP = 0.3;
constexpr int STEPS = 12;
constexpr int TILT = 3, TURN = 4;

double dot(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

void cross(const double* a, const double* b, double* out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

// R^T v
void turned_back(const double* R, const double* v, double* out) {
    for (int k = 0; k < 3; ++k) out[k] = R[k] * v[0] + R[3 + k] * v[1] + R[6 + k] * v[2];
}

kinematics::Frame composed(const kinematics::Frame& a, const kinematics::Frame& b) {
    kinematics::Frame out;
    for (int i = 0; i < 3; ++i) {
        const double* row = a.R + 3 * i;
        for (int k = 0; k < 3; ++k) out.R[3 * i + k] = row[0] * b.R[k] + row[1] * b.R[3 + k] + row[2] * b.R[6 + k];
        out.p[i] = dot(row, b.p) + a.p[i];
    }
    return out;
}

// The solution of A y = b for a symmetric, positive definite A, which is overwritten; false if it is not.
bool solve(std::vector<double>& A, std::vector<double>& b) {
    const std::size_t m = b.size();
    for (std::size_t i = 0; i < m; ++i)
        for (std::size_t j = 0; j <= i; ++j) {
            double sum = A[i * m + j];
            for (std::size_t k = 0; k < j; ++k) sum -= A[i * m + k] * A[j * m + k];
            if (i != j) {
                A[i * m + j] = sum / A[j * m + j];
            } else {
                if (!(sum > 0.0)) return false;
                A[i * m + i] = std::sqrt(sum);
            }
        }
    for (std::size_t i = 0; i < m; ++i) {
        for (std::size_t k = 0; k < i; ++k) b[i] -= A[i * m + k] * b[k];
        b[i] = b[i] / A[i * m + i];
    }
    for (std::size_t i = m; i-- > 0;) {
        for (std::size_t k = i + 1; k < m; ++k) b[i] -= A[k * m + i] * b[k];
        b[i] = b[i] / A[i * m + i];
    }
    return true;
}

double length(const Configuration& a, const Configuration& b) {
    double total = 0.0;
    for (std::size_t k = 0; k < a.size(); ++k) total += (b[k] - a[k]) * (b[k] - a[k]);
    return std::sqrt(total);
}

double largest(const std::vector<double>& shares) {
    double most = -std::numeric_limits<double>::infinity();
    for (const double share : shares) most = std::max(most, share);
    return most;
}

}  // namespace

Projector::Projector(kinematics::Arm arm, Joints joints, std::vector<Region> regions)
    : arm_(std::move(arm)), joints_(std::move(joints)), regions_(std::move(regions)), frames_(arm_.bodies + 1),
      measured_(regions_.size()), from_(arm_.joints), difference_(arm_.joints), on_(arm_.joints) {
    for (std::size_t r = 0; r < regions_.size(); ++r) {
        const Region& region = regions_[r];
        for (int k = 0; k < 3; ++k)
            if (std::isfinite(region.lower[k]) || std::isfinite(region.upper[k])) rows_.emplace_back(r, k);
        if (std::isfinite(region.chord)) rows_.emplace_back(r, TILT);
        if (std::isfinite(region.sine)) rows_.emplace_back(r, TURN);
        std::vector<int> moves(arm_.bodies + 1, 0);
        for (int body = static_cast<int>(region.body); body > 0; body = joints_.parent[static_cast<std::size_t>(body)])
            moves[static_cast<std::size_t>(body)] += 1;
        for (int body = static_cast<int>(region.base); body > 0; body = joints_.parent[static_cast<std::size_t>(body)])
            moves[static_cast<std::size_t>(body)] -= 1;
        moves_.push_back(std::move(moves));
    }
}

void Projector::place(const double* q) {
    kinematics::place(arm_, q, frames_, kinematics::Sines::PORTABLE);
    for (std::size_t r = 0; r < regions_.size(); ++r) {
        const Region& region = regions_[r];
        Measured& here = measured_[r];
        const kinematics::Frame a = composed(frames_[region.base], region.frame), b = composed(frames_[region.body], region.at);
        std::copy_n(a.R, 9, here.rotation);
        std::copy_n(b.p, 3, here.origin);
        const double apart[] = {b.p[0] - a.p[0], b.p[1] - a.p[1], b.p[2] - a.p[2]};
        turned_back(a.R, apart, here.at);
        for (int k = 0; k < 3; ++k) {
            const double column[] = {b.R[k], b.R[3 + k], b.R[6 + k]};
            double out[3];
            turned_back(a.R, column, out);
            for (int i = 0; i < 3; ++i) here.rows[3 * i + k] = out[i];
        }
    }
}

void Projector::measure(const double* q, Shares& shares) {
    place(q);
    shares.clear();
    for (const auto& [r, kind] : rows_) {
        const Region& region = regions_[r];
        const double* R = measured_[r].rows;
        if (kind == TILT) {
            const double lean = R[8] - 1.0;
            shares.push_back(std::sqrt(R[2] * R[2] + R[5] * R[5] + lean * lean) / region.chord);
        } else if (kind == TURN) {
            const double f = 1.0 + (R[0] + R[4] + R[8]), g = R[3] - R[1], norm = std::sqrt(f * f + g * g);
            shares.push_back(norm > 0.0 ? std::fabs(g) / norm / region.sine : 0.0);
        } else {
            const double p = measured_[r].at[kind], room = region.room[kind];
            shares.push_back(std::max((region.lower[kind] - p) / room, (p - region.upper[kind]) / room) + 1.0);
        }
    }
}

double Projector::share(const double* q) {
    Shares shares;
    measure(q, shares);
    return largest(shares);
}

bool Projector::has_room(const double* q) { return share(q) <= SAMPLE; }

// Rows of how the shares change with each joint, where the arm was placed last.
void Projector::gradients(const std::vector<std::size_t>& rows, std::vector<double>& out) const {
    const std::size_t n = arm_.joints;
    out.assign(rows.size() * n, 0.0);
    for (std::size_t at = 0; at < rows.size(); ++at) {
        const auto [r, kind] = rows_[rows[at]];
        const Region& region = regions_[r];
        const Measured& here = measured_[r];
        const double* R = here.rows;
        for (std::size_t body = 1; body <= arm_.bodies; ++body) {
            const int sign = moves_[r][body];
            if (sign == 0) continue;
            const kinematics::Frame& frame = frames_[body];
            double axis[3];
            for (int i = 0; i < 3; ++i) axis[i] = sign * dot(frame.R + 3 * i, joints_.axis[body].data());
            const bool slides = joints_.slides[body];
            double change = 0.0;
            if (kind < TILT) {
                double moved[3];
                if (slides) {
                    std::copy_n(axis, 3, moved);
                } else {
                    const double arm[] = {here.origin[0] - frame.p[0], here.origin[1] - frame.p[1], here.origin[2] - frame.p[2]};
                    cross(axis, arm, moved);
                }
                double along[3];
                turned_back(here.rotation, moved, along);
                const double p = here.at[kind], room = region.room[kind];
                const bool above = (p - region.upper[kind]) / room >= (region.lower[kind] - p) / room;
                change = (above ? along[kind] : -along[kind]) / room;
            } else if (!slides) {
                double turn[3];
                turned_back(here.rotation, axis, turn);
                if (kind == TILT) {
                    const double lean = R[8] - 1.0, chord = std::sqrt(R[2] * R[2] + R[5] * R[5] + lean * lean);
                    change = (turn[1] * R[2] - turn[0] * R[5]) / chord / region.chord;
                } else {
                    const double f = 1.0 + (R[0] + R[4] + R[8]), g = R[3] - R[1], norm = std::sqrt(f * f + g * g);
                    const double twist = (turn[0] * R[2] + turn[1] * R[5] + turn[2] * (R[8] + 1.0)) / std::max(1.0 + R[8], FACING_AWAY);
                    change = (g >= 0.0 ? twist : -twist) * (f / norm) / 2.0 / region.sine;
                }
            }
            out[at * n + joints_.index[body]] += joints_.multiplier[body] * change;
        }
    }
}

bool Projector::project(Configuration& q) {
    Shares at;
    return project(q, at);
}

bool Projector::project(Configuration& q, Shares& shares) {
    ++projections_;
    const std::size_t n = arm_.joints;
    std::vector<double>&J = J_, &A = A_, &y = y_;
    std::vector<std::size_t>& rows = used_;
    for (int step = 0; step < STEPS; ++step) {
        measure(q.data(), shares);
        if (largest(shares) <= KEPT) return true;
        rows.clear();
        y.clear();
        for (std::size_t k = 0; k < shares.size(); ++k)
            if (shares[k] > AIM) {
                rows.push_back(k);
                y.push_back(shares[k] - AIM);
            }
        gradients(rows, J);
        const std::size_t m = rows.size();
        A.assign(m * m, 0.0);
        for (std::size_t i = 0; i < m; ++i)
            for (std::size_t j = 0; j < m; ++j) {
                double sum = 0.0;
                for (std::size_t k = 0; k < n; ++k) sum += J[i * n + k] * J[j * n + k];
                A[i * m + j] = i == j ? sum * (1.0 + DAMPING) + LEAST_DAMPING : sum;
            }
        if (!solve(A, y)) return false;
        Configuration& move = on_;
        double widest = 0.0;
        for (std::size_t k = 0; k < n; ++k) {
            double sum = 0.0;
            for (std::size_t i = 0; i < m; ++i) sum += J[i * n + k] * y[i];
            move[k] = sum;
            widest = std::max(widest, std::fabs(sum));
        }
        if (!std::isfinite(widest)) return false;
        const double share = widest > LONGEST_STEP ? LONGEST_STEP / widest : 1.0;
        for (std::size_t k = 0; k < n; ++k) q[k] = std::min(std::max(q[k] - move[k] * share, arm_.lower[k]), arm_.upper[k]);
    }
    measure(q.data(), shares);
    return largest(shares) <= KEPT;
}

bool Projector::keeps(const Configuration& a, const Configuration& b) {
    Shares first, last;
    measure(a.data(), first);
    measure(b.data(), last);
    return keeps(a, b, first, last);
}

bool Projector::keeps(const Configuration& a, const Configuration& b, const Shares& first, const Shares& last) {
    if (!(std::max(largest(first), largest(last)) <= 1.0 + ROUNDING)) return false;
    const std::size_t n = arm_.joints;
    from_ = a;
    for (std::size_t k = 0; k < n; ++k) difference_[k] = b[k] - a[k];
    bend_.clear();
    for (const auto& [r, kind] : rows_) {
        const Region& region = regions_[r];
        double turns = 0.0, metres = 0.0;
        for (std::size_t i = 0; i < n; ++i) {
            if (region.reach[i] == 0.0) continue;
            turns += region.turns[i] * std::fabs(difference_[i]);
            for (std::size_t j = 0; j < n; ++j)
                metres += std::fabs(difference_[i]) * std::fabs(difference_[j]) *
                          std::min(region.reach[i] * region.turns[j], region.reach[j] * region.turns[i]);
        }
        const double most = kind == TILT ? turns * turns / region.chord
                            : kind == TURN ? 0.354 * (turns * turns) / region.sine
                                           : metres / region.room[kind];
        bend_.push_back(most / 8.0);
    }
    allowed_.clear();
    for (std::size_t k = 0; k < rows_.size(); ++k) allowed_.push_back(std::max(SAMPLE, std::max(first[k], last[k])));
    return part_is_kept(0.0, 1.0, first, last, 0);
}

bool Projector::step(const Configuration& from, Configuration& to, const Configuration& target, double distance, double step, bool fixed) {
    if (!fixed && !project(to, last_)) return false;
    if (!(length(to, target) <= distance - LEAST_PROGRESS * step && length(from, to) <= MOST_DETOUR * step)) return false;
    if (fixed) measure(to.data(), last_);
    if (from != reached_) {
        measure(from.data(), first_);
        reached_ = from;
    }
    if (!keeps(from, to, first_, last_)) return false;
    reached_ = to;
    std::swap(first_, last_);
    return true;
}

bool Projector::part_is_kept(double from, double to, const Shares& first, const Shares& last, int depth) {
    const double part = to - from, square = part * part;
    bool certain = true;
    for (std::size_t k = 0; k < rows_.size() && certain; ++k) certain = std::max(first[k], last[k]) + square * bend_[k] <= BOUND;
    if (certain || depth == MAX_DEPTH) return true;
    const double middle = (from + to) / 2.0;
    for (std::size_t k = 0; k < on_.size(); ++k) on_[k] = from_[k] + difference_[k] * middle;
    Shares& shares = between_[static_cast<std::size_t>(depth)];
    measure(on_.data(), shares);
    for (std::size_t k = 0; k < rows_.size(); ++k)
        if (shares[k] > allowed_[k]) return false;
    return part_is_kept(from, middle, first, shares, depth + 1) && part_is_kept(middle, to, shares, last, depth + 1);
}

long Projector::take() { return std::exchange(projections_, 0); }

}  // namespace constraints
