#include "line.hpp"

#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <utility>

#include "descent.hpp"

namespace kinematics {

namespace {

constexpr double pi = 3.14159265358979323846;
constexpr double limit_slack = 1e-9, verified = 1e-7, singular = 1e-8, same = 1e-8;
constexpr double line_metres = 1e-3, line_radians = 5e-3, sampled_share = 0.9, max_step = 0.2;
constexpr int max_halvings = 6, steps = 40, spread = 36;
constexpr double thinned_share = 0.6;

double (*const volatile arc_sine)(double) = std::asin;
double (*const volatile arc_cosine)(double) = std::acos;

using Configuration = std::vector<double>;

// Robot, and memory to work in.
struct Work {
    const Arm& arm;
    const Hypot& hypot;
    std::vector<Frame> frames;
    std::vector<double> q;
    double rows[12] = {};

    Work(const Arm& a, const Hypot& h) : arm(a), hypot(h), frames(a.bodies + 1), q(a.joints) {}
};

double rotation_distance(const Pose& a, const Pose& b) {
    double apart = 0.0, opposed = 0.0;
    for (int k = 0; k < 4; ++k) {
        const double minus = power(a.quaternion[k] - b.quaternion[k], 2.0), plus = power(a.quaternion[k] + b.quaternion[k], 2.0);
        apart = k == 0 ? minus : apart + minus;
        opposed = k == 0 ? plus : opposed + plus;
    }
    apart = std::sqrt(apart);
    opposed = std::sqrt(opposed);
    return 4.0 * arc_tangent(std::min(apart, opposed), std::max(apart, opposed));
}

// ``interpolate`` between two poses, whose angle is computed once.
class Line {
  public:
    Line(const Pose& a, const Pose& b) : a_(a), b_(b), half_(rotation_distance(a, b) / 2.0), sine_(sine(half_)) {
        const double *p = a.quaternion, *q = b.quaternion;
        product_ = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3];
    }

    Pose at(double u) const {
        Pose out;
        for (int k = 0; k < 3; ++k) out.position[k] = a_.position[k] + u * (b_.position[k] - a_.position[k]);
        if (sine_ < 1e-9) {
            std::copy_n(u > 0.5 ? b_.quaternion : a_.quaternion, 4, out.quaternion);
            return out;
        }
        const double near = sine((1.0 - u) * half_) / sine_, far = std::copysign(sine(u * half_) / sine_, product_);
        double* q = out.quaternion;
        for (int k = 0; k < 4; ++k) q[k] = near * a_.quaternion[k] + far * b_.quaternion[k];
        const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
        if (std::fabs(norm - 1.0) > 1e-12)  // as ``Pose``
            for (int k = 0; k < 4; ++k) q[k] /= norm;
        return out;
    }

  private:
    const Pose &a_, &b_;
    double half_, sine_, product_ = 0.0;
};

// Three rows of four: the rotation, and the position.
void rows_of(const Pose& pose, double* out) {
    const double w = pose.quaternion[0], x = pose.quaternion[1], y = pose.quaternion[2], z = pose.quaternion[3];
    const double R[9] = {1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z),       2.0 * (x * z + w * y),
                         2.0 * (x * y + w * z),       1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
                         2.0 * (x * z - w * y),       2.0 * (y * z + w * x),       1.0 - 2.0 * (x * x + y * y)};
    for (int i = 0; i < 3; ++i) {
        std::copy_n(R + 3 * i, 3, out + 4 * i);
        out[4 * i + 3] = pose.position[i];
    }
}

// Pose.from_matrix of tool rows.
Pose pose_of(const double* T) {
    const double r00 = T[0], r01 = T[1], r02 = T[2], r10 = T[4], r11 = T[5], r12 = T[6], r20 = T[8], r21 = T[9], r22 = T[10];
    const double squares[4] = {1.0 + r00 + r11 + r22, 1.0 + r00 - r11 - r22, 1.0 - r00 + r11 - r22, 1.0 - r00 - r11 + r22};
    const auto k = std::max_element(squares, squares + 4) - squares;
    const double s = 2.0 * std::sqrt(squares[k]);
    const double a = (r21 - r12) / s, b = (r02 - r20) / s, c = (r10 - r01) / s;
    const double d = (r01 + r10) / s, e = (r02 + r20) / s, f = (r12 + r21) / s;
    const double found[4][4] = {{s / 4.0, a, b, c}, {a, s / 4.0, d, e}, {b, d, s / 4.0, f}, {c, e, f, s / 4.0}};
    const double* q = found[k];
    const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]) * (q[0] < 0.0 ? -1.0 : 1.0);
    return {{T[3], T[7], T[11]}, {q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm}};
}

// The angles within the limits that differ by whole turns.
void within(double angle, double low, double high, std::vector<double>& out) {
    const double full = 2.0 * pi;
    out.clear();
    const double turns = std::ceil((angle - high - limit_slack) / full) + 0.0;  // no -0: an angle keeps the sign of its zero
    for (double base = angle - full * turns; base >= low - limit_slack; base -= full)
        out.push_back(std::min(std::max(base, low), high));
}

// A sum of three numbers, rounded once, as ``math.fsum``.
double sum_of(double a, double b, double c) {
    const auto two = [](double x, double y, double& off) {
        const double sum = x + y, part = sum - x;
        off = (x - (sum - part)) + (y - part);
        return sum;
    };
    double first = 0.0, second = 0.0;
    const double sum = two(two(a, b, first), c, second);
    return sum + (first + second);
}

class Solver {
  public:
    Solver(const ClosedForm& form, Work& work) : form_(form), work_(work) {}

    bool determined(const Pose& pose) {
        target(pose);
        const double reach = work_.hypot(wrist_, 2);
        if (reach < singular) return false;
        const double direction[2] = {(wrist_[0] * x_[0] + wrist_[1] * x_[1]) / reach, x_[2]};
        return work_.hypot(direction, 2) >= singular;
    }

    void solve(const Pose& pose, const std::vector<Configuration>& near, std::vector<Configuration>& solutions) {
        solutions.clear();
        target(pose);
        const double reach = work_.hypot(wrist_, 2), ahead = arc_tangent(wrist_[1], wrist_[0]);
        Pairs waists{{ahead, reach}, {ahead + pi, -reach}};
        if (reach < singular) waists = free([&](const Configuration& q) { return form_.signs[0] * q[0]; }, near, 0.0);
        for (const auto& [waist, radius] : waists) {
            if (!possible(0, waist)) continue;
            const double c = cosine(waist), s = sine(waist);
            const double across = c * x_[1] - s * x_[0], flat_of[2] = {c * x_[0] + s * x_[1], x_[2]};
            const double flat = work_.hypot(flat_of, 2), level = arc_tangent(-x_[2], flat_of[0]);
            Pairs wrists{{level, arc_tangent(across, flat)}, {level + pi, arc_tangent(across, -flat)}};
            if (flat < singular) wrists = free([&](const Configuration& q) { return pitch_of(q); }, near, std::copysign(pi / 2.0, across));
            for (const auto& [pitch, yaw] : wrists) {
                if (!possible(4, yaw)) continue;
                const double sp = sine(pitch), cp = cosine(pitch), up[3] = {sp * c, sp * s, cp};
                const double roll = arc_tangent(along(y_, up), along(z_, up));
                const double joint[2] = {radius - (form_.hand[0] * cp - form_.hand[1] * -sp) - form_.shoulder[0],
                                         wrist_[2] - (form_.hand[0] * -sp + form_.hand[1] * cp) - form_.shoulder[1]};
                elbows(joint, waist, pitch, yaw, roll, solutions);
            }
        }
    }

  private:
    const ClosedForm& form_;
    Work& work_;
    double rows_[12] = {};
    double x_[3] = {}, y_[3] = {}, z_[3] = {}, wrist_[3] = {};  // the last body's axes and the wrist, in the waist's frame
    std::vector<double> turns_[6];

    using Pairs = std::vector<std::pair<double, double>>;

    void target(const Pose& pose) {
        rows_of(pose, rows_);
        double axes[3][3], arm[3];
        for (int k = 0; k < 3; ++k)
            for (int i = 0; i < 3; ++i) axes[k][i] = along(rows_ + 4 * i, form_.tool + 3 * k);
        for (int i = 0; i < 3; ++i)
            arm[i] = pose.position[i] - form_.base_offset[i] - axes[0][i] * form_.tool_offset[0] -
                     axes[1][i] * form_.tool_offset[1] - axes[2][i] * form_.tool_offset[2];
        double* const turned[3] = {x_, y_, z_};
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) turned[k][i] = along(form_.waist + 3 * i, axes[k]);
        for (int i = 0; i < 3; ++i) wrist_[i] = along(form_.waist + 3 * i, arm) - form_.last * x_[i];
    }

    double pitch_of(const Configuration& q) const {
        return sum_of(form_.signs[1] * q[1], form_.signs[2] * q[2], form_.signs[3] * q[3]);
    }

    // A free angle: that of the given configurations, then every ten degrees; each beside the same number.
    template <typename Angle>
    static Pairs free(const Angle& angle, const std::vector<Configuration>& near, double beside) {
        Pairs out;
        for (const Configuration& q : near) out.emplace_back(angle(q), beside);
        for (int k = 0; k < spread; ++k) out.emplace_back(2.0 * pi * k / spread, beside);
        return out;
    }

    bool possible(std::size_t joint, double angle) {
        within(form_.signs[joint] * angle, form_.low[joint], form_.high[joint], turns_[0]);
        return !turns_[0].empty();
    }

    void elbows(const double* joint, double waist, double pitch, double yaw, double roll, std::vector<Configuration>& solutions) {
        const double square = joint[0] * joint[0] + joint[1] * joint[1];
        double cosine_of = (square - form_.upper_square - form_.fore_square) / 2.0 / form_.fold;
        if (std::fabs(cosine_of) > 1.0) {
            if (std::fabs(cosine_of) > 1.0 + 1e-14) return;
            cosine_of = std::copysign(1.0, cosine_of);
        }
        const double bend = arc_cosine(cosine_of);
        for (const double elbow : {form_.fold_angle - bend, form_.fold_angle + bend}) {
            const double c = cosine(-elbow), s = sine(-elbow);
            const double reached[2] = {form_.upper[0] + (form_.fore[0] * c - form_.fore[1] * s),
                                       form_.upper[1] + (form_.fore[0] * s + form_.fore[1] * c)};
            const double first = arc_tangent(reached[1], reached[0]) - arc_tangent(joint[1], joint[0]);
            const double angles[6] = {waist, first, elbow, pitch - first - elbow, yaw, roll};
            add(angles, solutions);
        }
    }

    // The configurations of these angles within the limits that are not there yet.
    void add(const double* angles, std::vector<Configuration>& solutions) {
        std::size_t count = 1;
        for (std::size_t k = 0; k < 6; ++k) {
            within(form_.signs[k] * angles[k], form_.low[k], form_.high[k], turns_[k]);
            count *= turns_[k].size();
        }
        for (std::size_t number = 0; number < count; ++number) {
            Configuration q(6);
            std::size_t left = number;
            for (std::size_t k = 6; k-- > 0; left /= turns_[k].size()) q[k] = turns_[k][left % turns_[k].size()];
            const auto is_same = [&q](const Configuration& other) {
                for (std::size_t k = 0; k < 6; ++k)
                    if (!(std::fabs(q[k] - other[k]) <= same)) return false;
                return true;
            };
            if (std::any_of(solutions.begin(), solutions.end(), is_same)) continue;
            tool_rows(work_.arm, q.data(), work_.frames, work_.rows);
            for (int k = 0; k < 12; ++k)
                if (!(std::fabs(work_.rows[k] - rows_[k]) <= verified)) throw std::logic_error("the closed form is off");
            solutions.push_back(std::move(q));
        }
    }
};

// The configuration nearest to ``before`` for a pose, into ``q``; false if there is none.
bool next(Work& work, Solver* solver, const Pose& pose, const double* before, std::vector<Configuration>& solutions, double* q) {
    const std::size_t n = work.arm.joints;
    if (solver == nullptr) {
        double target[12];
        rows_of(pose, target);
        std::copy_n(before, n, q);
        return descend(work.arm, target, work.arm.lower.data(), work.arm.upper.data(), steps, q, work.frames);
    }
    solver->solve(pose, {Configuration(before, before + n)}, solutions);
    double least = 0.0;
    const Configuration* nearest = nullptr;
    for (const Configuration& solution : solutions) {
        double most = 0.0;
        for (std::size_t k = 0; k < n; ++k) most = std::max(most, std::fabs(solution[k] - before[k]));
        if (nearest == nullptr || most < least) {
            least = most;
            nearest = &solution;
        }
    }
    if (nearest == nullptr) return false;
    std::copy(nearest->begin(), nearest->end(), q);
    return true;
}

void between(const double* a, const double* b, double u, std::vector<double>& out) {
    for (std::size_t k = 0; k < out.size(); ++k) out[k] = a[k] + u * (b[k] - a[k]);
}

// Whether the tool stays at its line while the joints go straight from ``before`` to ``q``.
bool fits(Work& work, const double* before, const double* q, const Pose& first, const Pose& last) {
    double most = 0.0;
    for (std::size_t k = 0; k < work.arm.joints; ++k) most = std::max(most, std::fabs(q[k] - before[k]));
    if (most > max_step) return false;
    const Line line(first, last);
    double metres = 0.0, radians = 0.0;
    for (const double u : {0.25, 0.5, 0.75}) {
        between(before, q, u, work.q);
        tool_rows(work.arm, work.q.data(), work.frames, work.rows);
        const Pose pose = line.at(u);
        double wanted[12], turns = 0.0, shifts = 0.0;
        rows_of(pose, wanted);
        for (int i = 0; i < 12; i += 4) {
            const double a = work.rows[i] - wanted[i], b = work.rows[i + 1] - wanted[i + 1], c = work.rows[i + 2] - wanted[i + 2];
            turns += a * a + b * b + c * c;
            shifts += (work.rows[i + 3] - wanted[i + 3]) * (work.rows[i + 3] - wanted[i + 3]);
        }
        metres = std::max(metres, std::sqrt(shifts));
        radians = std::max(radians, 2.0 * arc_sine(std::min(1.0, std::sqrt(turns / 8.0))));
    }
    return metres <= sampled_share * line_metres && radians <= sampled_share * line_radians;
}

// Metres from the line through two positions.
double off_line(const Work& work, const Pose& tool, const Pose& first, const Pose& last) {
    double a[3], b[3];
    for (int k = 0; k < 3; ++k) {
        a[k] = tool.position[k] - first.position[k];
        b[k] = last.position[k] - first.position[k];
    }
    const double length = work.hypot(b, 3);
    if (length == 0.0) return work.hypot(a, 3);
    const double normal[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    return work.hypot(normal, 3) / length;
}

// ``_fits`` of cartesian_waypoints.py.
bool stays(Work& work, const double* a, const double* b, const Pose& first, const Pose& last) {
    const Line line(first, last);
    for (int k = 1; k < 8; ++k) {
        const double u = k / 8.0;
        between(a, b, u, work.q);
        tool_rows(work.arm, work.q.data(), work.frames, work.rows);
        const Pose tool = pose_of(work.rows);
        if (off_line(work, tool, first, last) > thinned_share * line_metres) return false;
        if (rotation_distance(tool, line.at(u)) > thinned_share * line_radians) return false;
    }
    return true;
}

}  // namespace

ClosedForm::ClosedForm(const double* values) {
    const auto take = [&values](double* to, std::size_t count) {
        std::copy_n(values, count, to);
        values += count;
    };
    for (double* pair : {shoulder, upper, fore, hand}) take(pair, 2);
    take(&last, 1);
    for (double* six : {signs, low, high}) take(six, 6);
    take(waist, 9);
    take(base_offset, 3);
    take(tool, 9);
    take(tool_offset, 3);
    for (double* one : {&upper_square, &fore_square, &fold, &fold_angle}) take(one, 1);
}

std::vector<Configuration> solve(const Arm& arm, const ClosedForm& closed_form, const Pose& pose,
                                 const std::vector<Configuration>& near, const Hypot& hypot) {
    Work work(arm, hypot);
    std::vector<Configuration> solutions;
    Solver(closed_form, work).solve(pose, near, solutions);
    return solutions;
}

bool determined(const Arm& arm, const ClosedForm& closed_form, const Pose& pose, const Hypot& hypot) {
    Work work(arm, hypot);
    return Solver(closed_form, work).determined(pose);
}

Walked walk(const Arm& arm, const ClosedForm* closed_form, const Pose& begin, const Pose& end, const double* start, int points,
            const Hypot& hypot) {
    const std::size_t n = arm.joints;
    Work work(arm, hypot);
    std::optional<Solver> solver;
    if (closed_form != nullptr) solver.emplace(*closed_form, work);
    const Line line(begin, end);
    const double shortest = 1.0 / (points - 1) / (1 << max_halvings);
    Walked out{{start, start + n}, {0.0}, std::nullopt, {}};
    std::vector<double> q(n), pending;
    std::vector<Configuration> solutions;
    Pose here = begin;
    for (int k = 1; k < points; ++k) {
        pending.push_back(static_cast<double>(k) / (points - 1));
        while (!pending.empty()) {
            const Pose pose = line.at(pending.back());
            const double *before = out.waypoints.data() + out.waypoints.size() - n, behind = out.fractions.back();
            const bool found = next(work, solver ? &*solver : nullptr, pose, before, solutions, q.data());
            if (found && fits(work, before, q.data(), here, pose)) {
                out.waypoints.insert(out.waypoints.end(), q.begin(), q.end());
                out.fractions.push_back(pending.back());
                here = pose;
                pending.pop_back();
            } else if (pending.back() - behind <= shortest * (1.0 + 1e-9)) {
                out.stop = pending.back();
                if (found) out.beyond = q;
                return out;
            } else {
                pending.push_back((behind + pending.back()) / 2.0);
            }
        }
    }
    return out;
}

std::vector<int> thinned(const Arm& arm, const double* waypoints, int rows, const std::vector<int>& stops, const Hypot& hypot) {
    const std::size_t n = arm.joints;
    Work work(arm, hypot);
    std::vector<Pose> poses;
    const auto row = [&](int k) { return waypoints + static_cast<std::size_t>(k) * n; };
    const auto pose = [&](int k) -> const Pose& { return poses[static_cast<std::size_t>(k)]; };
    for (int k = 0; k < rows; ++k) {
        tool_rows(arm, row(k), work.frames, work.rows);
        poses.push_back(pose_of(work.rows));
    }
    std::vector<int> kept{0};
    for (const int stop : stops)
        while (kept.back() < stop) {
            const int first = kept.back();
            int span = stop - first;
            while (span > 1 && !stays(work, row(first), row(first + span), pose(first), pose(first + span)))
                span = std::max(1, span * 3 / 4);
            kept.push_back(first + span);
        }
    return kept;
}

}  // namespace kinematics
