#include "tool_speed.hpp"

namespace timing {

namespace {

constexpr double spacing = 0.04, closer = 1024.0;
constexpr int looks = 3, splits = 32, prismatic = 3;

// Geometry's cosines_and_sines: Taylor series, the same bits on every processor.
void cosine_and_sine(double x, double& cosine, double& sine) {
    static constexpr double odd[] = {355687428096000.0, -1307674368000.0, 6227020800.0, -39916800.0, 362880.0, -5040.0, 120.0, -6.0};
    static constexpr double even[] = {20922789888000.0, -87178291200.0, 479001600.0, -3628800.0, 40320.0, -720.0, 24.0, -2.0};
    const double quarters = std::floor(x * 0.63661977236758134308 + 0.5);
    const double r = (x - quarters * 1.57079632673412561417) - quarters * 6.07710050650619224932e-11, u = r * r;
    double s = 0.0, c = 0.0;
    for (const double factorial : odd) s = s * u + 1.0 / factorial;
    for (const double factorial : even) c = c * u + 1.0 / factorial;
    s = r + r * u * s;
    c = 1.0 + u * c;
    const auto turns = static_cast<std::int64_t>(quarters);
    sine = (turns & 1) != 0 ? c : s;
    cosine = (turns & 1) != 0 ? s : c;
    if (((turns + 1) & 2) != 0) cosine = -cosine;
    if ((turns & 2) != 0) sine = -sine;
}

struct Step {
    std::size_t parent, q_index;
    int kind;
    double sign;
    const double *offset, *slide, *before, *after;  // the rotations are null if they are none

    explicit Step(const double* row)
        : parent(static_cast<std::size_t>(row[0])),
          q_index(static_cast<std::size_t>(row[1])),
          kind(static_cast<int>(row[2])),
          sign(row[3]),
          offset(row + 4),
          slide(row + 7),
          before(row[10] != 0.0 ? row + 11 : nullptr),
          after(row[20] != 0.0 ? row + 21 : nullptr) {}
};

struct Pose {
    double R[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    double p[3] = {0.0, 0.0, 0.0};
};

void turn(double* R, const double* by) {
    for (int i = 0; i < 3; ++i) {
        const double a = R[3 * i], b = R[3 * i + 1], c = R[3 * i + 2];
        for (int k = 0; k < 3; ++k) R[3 * i + k] = a * by[k] + b * by[3 + k] + c * by[6 + k];
    }
}

double along(const double* row, const double* v) { return row[0] * v[0] + row[1] * v[1] + row[2] * v[2]; }

// BodyTree.poses; ``out`` has room for all bodies.
void place(const Arm& arm, const double* q, std::vector<Pose>& out) {
    for (std::size_t k = 0; k < arm.bodies; ++k) {
        const Step step(arm.table + k * Arm::width);
        Pose here = out[step.parent];
        for (int i = 0; i < 3; ++i) here.p[i] += along(here.R + 3 * i, step.offset);
        if (step.before != nullptr) turn(here.R, step.before);
        const double angle = q[step.q_index];
        if (step.kind == prismatic) {
            for (int i = 0; i < 3; ++i) here.p[i] += along(here.R + 3 * i, step.slide) * angle;
        } else {
            double c, s;
            cosine_and_sine(angle, c, s);
            s = step.sign * s;
            const int u = (step.kind + 1) % 3, w = (step.kind + 2) % 3;
            for (int i = 0; i < 9; i += 3) {
                const double first = here.R[i + u], second = here.R[i + w];
                here.R[i + u] = first * c + second * s;
                here.R[i + w] = second * c - first * s;
            }
            if (step.after != nullptr) turn(here.R, step.after);
        }
        out[k + 1] = here;
    }
}

double speed_at(const Arm& arm, const double* q, const double* qd, std::vector<Pose>& poses) {
    place(arm, q, poses);
    const Pose& tool = poses[arm.tool_body];
    double at[3], velocity[3] = {0.0, 0.0, 0.0};
    for (int i = 0; i < 3; ++i) at[i] = tool.p[i] + along(tool.R + 3 * i, arm.tool);
    bool first = true;
    for (std::size_t body = arm.tool_body; body > 0;) {
        const Step step(arm.table + (body - 1) * Arm::width);
        const Pose& pose = poses[body];
        double move[3];
        for (int i = 0; i < 3; ++i) move[i] = along(pose.R + 3 * i, step.slide);
        if (step.kind != prismatic) {
            const double x = move[0], y = move[1], z = move[2];
            const double u = at[0] - pose.p[0], v = at[1] - pose.p[1], w = at[2] - pose.p[2];
            move[0] = y * w - z * v;
            move[1] = z * u - x * w;
            move[2] = x * v - y * u;
        }
        for (int i = 0; i < 3; ++i) velocity[i] = first ? move[i] * qd[step.q_index] : velocity[i] + move[i] * qd[step.q_index];
        first = false;
        body = step.parent;
    }
    return std::sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1] + velocity[2] * velocity[2]);
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
    std::vector<Pose> poses(arm.bodies + 1);
    std::vector<double> out(rows);
    for (std::size_t k = 0; k < rows; ++k) out[k] = speed_at(arm, q + k * joints, qd + k * joints, poses);
    return out;
}

double peak_tool_speed(const Arm& arm, const Path& path, const Motion& motion) {
    if (motion.count == 0) return 0.0;
    std::vector<Pose> poses(arm.bodies + 1);
    std::vector<double> q(path.joints), qd(path.joints), times, speeds;
    for (std::size_t k = 0; k < motion.count; ++k) {
        const double way = motion.ends[k] - motion.cubic(k)[0];
        const double count = std::max(std::ceil(way / spacing), 1.0);
        for (double within = 0.0; within < count; within += 1.0)
            times.push_back(std::min(motion.knots[k] + motion.durations[k] * (within / count), motion.duration()));
    }
    times.push_back(motion.duration());
    double best = 0.0, missed = 0.003;
    for (int look = 0; look < looks && !times.empty(); ++look, missed /= closer) {
        speeds.clear();
        for (const double t : times) {
            moving(path, motion, t, q.data(), qd.data());
            speeds.push_back(speed_at(arm, q.data(), qd.data(), poses));
            best = std::max(best, speeds.back());
        }
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
