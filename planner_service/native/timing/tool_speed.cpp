#include "tool_speed.hpp"

#include "../arithmetic.hpp"

namespace timing {

namespace {

// Radians of path between the first samples, on average: joints that turn so little hardly bend the tool's path.
constexpr double spacing = 0.04;

// The factor by which what samples may have missed shrinks when they are 32 times closer: speed is smooth between the ends of
// pieces of time, which are sampled themselves.
constexpr double closer = 1024.0;
constexpr int looks = 3, splits = 32, prismatic = 3;

// Two samples side by side: every processor has registers for two numbers.
typedef double Pair __attribute__((vector_size(16)));

struct Step {
    std::size_t q_index;
    int kind;
    double sign, multiplier;
    const double *offset, *slide, *before, *after;  // the rotations are null if they are none

    explicit Step(const double* row)
        : q_index(static_cast<std::size_t>(row[1])),
          kind(static_cast<int>(row[2])),
          sign(row[3]),
          multiplier(row[30]),
          offset(row + 4),
          slide(row + 7),
          before(row[10] != 0.0 ? row + 11 : nullptr),
          after(row[20] != 0.0 ? row + 21 : nullptr) {}
};

struct Pose {
    Pair R[9], p[3];
};

void turn(Pair* R, const double* by) {
    for (int i = 0; i < 3; ++i) {
        const Pair a = R[3 * i], b = R[3 * i + 1], c = R[3 * i + 2];
        for (int k = 0; k < 3; ++k) R[3 * i + k] = a * by[k] + b * by[3 + k] + c * by[6 + k];
    }
}

Pair along(const Pair* row, const double* v) { return row[0] * v[0] + row[1] * v[1] + row[2] * v[2]; }

void cosines_and_sines(const Pair& angles, Pair& cosines, Pair& sines) {
    Pair rests;
    std::int64_t turns[2];
    for (int k = 0; k < 2; ++k) {
        const arithmetic::Quarters quarters = arithmetic::quarters_of(angles[k]);
        rests[k] = quarters.rest;
        turns[k] = quarters.turns;
    }
    arithmetic::near_zero(rests, cosines, sines);
    for (int k = 0; k < 2; ++k) {
        double c = cosines[k], s = sines[k];
        arithmetic::turn_back(turns[k], c, s);
        cosines[k] = c;
        sines[k] = s;
    }
}

// The joints that move the tool: speeds of its origin for two samples at a time.
class Chain {
  public:
    explicit Chain(const Arm& arm) : arm_(arm) {
        for (std::size_t body = arm.tool_body; body > 0;) {
            const double* row = arm.table + (body - 1) * Arm::width;
            steps_.emplace_back(row);
            body = static_cast<std::size_t>(row[0]);
        }
        std::reverse(steps_.begin(), steps_.end());
        poses_.resize(steps_.size());
    }

    // A number for each joint of the robot.
    Pair speeds(const Pair* q, const Pair* qd) {
        const Pose tool = place(q);
        Pair at[3], velocity[3] = {};
        for (int i = 0; i < 3; ++i) at[i] = tool.p[i] + along(tool.R + 3 * i, arm_.tool);
        for (std::size_t k = steps_.size(); k-- > 0;) {
            const Step& step = steps_[k];
            const Pose& pose = poses_[k];
            Pair move[3];
            for (int i = 0; i < 3; ++i) move[i] = along(pose.R + 3 * i, step.slide);
            if (step.kind != prismatic) {
                const Pair x = move[0], y = move[1], z = move[2];
                const Pair u = at[0] - pose.p[0], v = at[1] - pose.p[1], w = at[2] - pose.p[2];
                move[0] = y * w - z * v;
                move[1] = z * u - x * w;
                move[2] = x * v - y * u;
            }
            const bool first = k + 1 == steps_.size();
            for (int i = 0; i < 3; ++i) {
                const Pair moved = move[i] * (qd[step.q_index] * step.multiplier);
                velocity[i] = first ? moved : velocity[i] + moved;
            }
        }
        const Pair square = velocity[0] * velocity[0] + velocity[1] * velocity[1] + velocity[2] * velocity[2];
        return Pair{std::sqrt(square[0]), std::sqrt(square[1])};
    }

  private:
    const Arm& arm_;
    std::vector<Step> steps_;  // from the base to the tool
    std::vector<Pose> poses_;

    // BodyTree.poses of these bodies; returns the last.
    Pose place(const Pair* q) {
        const Pair zero{0.0, 0.0}, one{1.0, 1.0};
        Pose here{{one, zero, zero, zero, one, zero, zero, zero, one}, {zero, zero, zero}};
        for (std::size_t k = 0; k < steps_.size(); ++k) {
            const Step& step = steps_[k];
            for (int i = 0; i < 3; ++i) here.p[i] += along(here.R + 3 * i, step.offset);
            if (step.before != nullptr) turn(here.R, step.before);
            const Pair angle = q[step.q_index] * step.multiplier;
            if (step.kind == prismatic) {
                for (int i = 0; i < 3; ++i) here.p[i] += along(here.R + 3 * i, step.slide) * angle;
            } else {
                Pair c, s;
                cosines_and_sines(angle, c, s);
                s = step.sign * s;
                const int u = (step.kind + 1) % 3, w = (step.kind + 2) % 3;
                for (int i = 0; i < 9; i += 3) {
                    const Pair first = here.R[i + u], second = here.R[i + w];
                    here.R[i + u] = first * c + second * s;
                    here.R[i + w] = second * c - first * s;
                }
                if (step.after != nullptr) turn(here.R, step.after);
            }
            poses_[k] = here;
        }
        return here;
    }
};

// The speed at each of ``count`` samples, whose q and qd ``sample(k, q, qd)`` gives.
template <class Sample>
std::vector<double> speeds_at(const Arm& arm, std::size_t joints, std::size_t count, Sample sample) {
    Chain chain(arm);
    std::vector<double> out(count), q(joints), qd(joints);
    std::vector<Pair> both_q(joints), both_qd(joints);
    for (std::size_t k = 0; k < count; k += 2) {
        for (std::size_t side = 0; side < 2; ++side) {
            sample(std::min(k + side, count - 1), q.data(), qd.data());
            for (std::size_t j = 0; j < joints; ++j) both_q[j][side] = q[j], both_qd[j][side] = qd[j];
        }
        const Pair speeds = chain.speeds(both_q.data(), both_qd.data());
        for (std::size_t side = 0; side < 2 && k + side < count; ++side) out[k + side] = speeds[side];
    }
    return out;
}

// Trajectory.moving at one time.
void moving(const Path& path, const Motion& motion, double t, double* q, double* qd) {
    const auto after = static_cast<std::size_t>(std::upper_bound(motion.knots, motion.knots + motion.count + 1, t) - motion.knots);
    const std::size_t piece = std::min(after, motion.count) - 1;
    const bool last = t == motion.duration();
    const double h = motion.durations[piece];
    const double x = last ? motion.durations[motion.count - 1] : std::min(std::max(t - motion.knots[piece], 0.0), h);
    const double* c = motion.cubic(piece);
    double s = c[0] + x * (c[1] + x * (c[2] + x * c[3]));
    s = last ? motion.ends[motion.count - 1] : std::min(std::max(s, c[0]), motion.ends[piece]);
    const double rate = last ? 0.0 : std::max(c[1] + x * (2.0 * c[2] + 3.0 * c[3] * x), 0.0);
    path.position(s, q);
    path.tangent(static_cast<std::size_t>(motion.geometry[piece]), s, qd);
    for (std::size_t k = 0; k < path.joints; ++k) qd[k] *= rate;
}

}  // namespace

std::vector<double> tool_speeds(const Arm& arm, std::size_t joints, std::size_t rows, const double* q, const double* qd) {
    return speeds_at(arm, joints, rows, [&](std::size_t k, double* q_at, double* qd_at) {
        std::copy(q + k * joints, q + (k + 1) * joints, q_at);
        std::copy(qd + k * joints, qd + (k + 1) * joints, qd_at);
    });
}

double peak_tool_speed(const Arm& arm, const Path& path, const Motion& motion) {
    if (motion.count == 0) return 0.0;
    std::vector<double> times;
    for (std::size_t k = 0; k < motion.count; ++k) {
        const double way = motion.ends[k] - motion.cubic(k)[0];
        const double count = std::max(std::ceil(way / spacing), 1.0);
        for (double within = 0.0; within < count; within += 1.0)
            times.push_back(std::min(motion.knots[k] + motion.durations[k] * (within / count), motion.duration()));
    }
    times.push_back(motion.duration());
    double best = 0.0, missed = 0.003;
    for (int look = 0; look < looks && !times.empty(); ++look, missed /= closer) {
        const std::vector<double> speeds = speeds_at(arm, path.joints, times.size(), [&](std::size_t k, double* q, double* qd) {
            moving(path, motion, times[k], q, qd);
        });
        best = std::max(best, *std::max_element(speeds.begin(), speeds.end()));
        if (best == 0.0) break;  // the tool's origin does not move
        std::vector<double> near;
        for (std::size_t k = 0; k + 1 < times.size(); ++k)
            if (std::max(speeds[k + 1], speeds[k]) > best * (1.0 - missed))
                for (int i = 0; i <= splits; ++i)
                    near.push_back(std::min(times[k] + (times[k + 1] - times[k]) * (i / static_cast<double>(splits)), motion.duration()));
        times.swap(near);
    }
    return best;
}

}  // namespace timing
