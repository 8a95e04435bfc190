#include "descent.hpp"

#include <algorithm>

namespace kinematics {

namespace {

// A start has arrived when its tool is this close to the pose, in metres and radians. At 1e-6 one solution of the WidowX AI,
// 2 mrad from a wrist singularity, looked like ten; the last steps are quadratic and cost little.
constexpr double exact = 1e-8;

// The damping per squared error. With any value from 0 to 0.5, 39 to 40 % of random starts arrive on the WidowX AI.
constexpr double damping_share = 0.02;

// Keep the normal matrix invertible, limit a step (rad), and say when a joint is on its limit: numeric_inverse.py has why.
constexpr double damping_floor = 1e-11, max_step = 2.0, at_limit = 1e-12;

// The scaled error (6), its Jacobian (6 x n), and the larger error in metres and radians.
double error_at(const Arm& arm, const double* q, const double* target, std::vector<Frame>& frames, double* error,
                std::vector<double>& jacobian) {
    place(arm, q, frames);
    const Frame& body = frames[arm.tool_body];
    double tool[9], point[3], shift[3], E[9], v[3];
    for (int i = 0; i < 3; ++i) {
        const double* row = body.R + 3 * i;
        for (int k = 0; k < 3; ++k) tool[3 * i + k] = row[0] * arm.tool[k] + row[1] * arm.tool[4 + k] + row[2] * arm.tool[8 + k];
        point[i] = body.p[i] + (row[0] * arm.tool[3] + row[1] * arm.tool[7] + row[2] * arm.tool[11]);
        shift[i] = target[4 * i + 3] - point[i];
    }
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) E[3 * i + k] = along(target + 4 * i, tool + 3 * k);
    v[0] = (E[7] - E[5]) / 2.0;
    v[1] = (E[2] - E[6]) / 2.0;
    v[2] = (E[3] - E[1]) / 2.0;
    const double length = std::sqrt(along(v, v)), angle = arc_tangent(length, (E[0] + E[4] + E[8] - 1.0) / 2.0);
    for (int i = 0; i < 3; ++i) {
        error[i] = shift[i] * arm.scale;
        error[3 + i] = v[i] * (length > 0.0 ? angle / length : 1.0);
    }
    std::fill(jacobian.begin(), jacobian.end(), 0.0);
    for (const Moved& moved : arm.chain) {
        const Frame& frame = frames[moved.body];
        double axis[3], lever[3];
        for (int i = 0; i < 3; ++i) {
            axis[i] = along(frame.R + 3 * i, moved.axis);
            lever[i] = point[i] - frame.p[i];
        }
        const double linear[3] = {axis[1] * lever[2] - axis[2] * lever[1], axis[2] * lever[0] - axis[0] * lever[2],
                                  axis[0] * lever[1] - axis[1] * lever[0]};
        for (std::size_t i = 0; i < 3; ++i) {
            jacobian[i * arm.joints + moved.joint] += (moved.slides ? axis[i] : linear[i]) * arm.scale * moved.multiplier;
            jacobian[(3 + i) * arm.joints + moved.joint] += (moved.slides ? 0.0 : axis[i]) * moved.multiplier;
        }
    }
    return std::max(std::sqrt(along(shift, shift)), angle);
}

// _solved: x with A x = x, by Cholesky decomposition.
void solve(double (*A)[6], double* x) {
    for (int j = 0; j < 6; ++j) {
        A[j][j] = std::sqrt(A[j][j]);
        for (int r = j + 1; r < 6; ++r) A[r][j] /= A[j][j];
        x[j] /= A[j][j];
        for (int r = j + 1; r < 6; ++r)
            for (int c = j + 1; c < 6; ++c) A[r][c] -= A[r][j] * A[c][j];
        for (int r = j + 1; r < 6; ++r) x[r] -= A[r][j] * x[j];
    }
    for (int j = 5; j >= 0; --j) {
        x[j] /= A[j][j];
        for (int r = 0; r < j; ++r) x[r] -= A[j][r] * x[j];
    }
}

// _step: dq (n) for an error and its Jacobian, in which joints held at their limits are set to nothing.
void step_of(const double* q, const double* error, std::vector<double>& J, const double* lower, const double* upper,
             std::size_t n, std::vector<double>& dq) {
    for (std::size_t k = 0; k < n; ++k) {
        double pull = J[k] * error[0];
        for (std::size_t i = 1; i < 6; ++i) pull += J[i * n + k] * error[i];
        const bool held = (q[k] <= lower[k] + at_limit && pull < 0.0) || (q[k] >= upper[k] - at_limit && pull > 0.0);
        for (std::size_t i = 0; held && i < 6; ++i) J[i * n + k] = 0.0;
    }
    double normal[6][6], x[6], squared = error[0] * error[0];
    for (int i = 1; i < 6; ++i) squared += error[i] * error[i];
    for (std::size_t i = 0; i < 6; ++i) {
        x[i] = error[i];
        for (std::size_t j = 0; j < 6; ++j) {
            normal[i][j] = J[i * n] * J[j * n];
            for (std::size_t k = 1; k < n; ++k) normal[i][j] += J[i * n + k] * J[j * n + k];
        }
        normal[i][i] += damping_share * squared + damping_floor;
    }
    solve(normal, x);
    double longest = 0.0;
    for (std::size_t k = 0; k < n; ++k) {
        dq[k] = J[k] * x[0];
        for (std::size_t i = 1; i < 6; ++i) dq[k] += J[i * n + k] * x[i];
        longest = std::max(longest, std::fabs(dq[k]));
    }
    const double share = max_step / std::max(longest, max_step);
    for (std::size_t k = 0; k < n; ++k) dq[k] *= share;
}

}  // namespace

bool descend(const Arm& arm, const double* target, const double* lower, const double* upper, int steps, double* q,
             std::vector<Frame>& frames) {
    const std::size_t n = arm.joints;
    std::vector<double> jacobian(6 * n), dq(n);
    double error[6];
    for (std::size_t k = 0; k < n; ++k) q[k] = std::min(std::max(q[k], lower[k]), upper[k]);
    for (int step = 0; step <= steps; ++step) {
        if (error_at(arm, q, target, frames, error, jacobian) <= exact) return true;
        if (step == steps) break;
        step_of(q, error, jacobian, lower, upper, n, dq);
        for (std::size_t k = 0; k < n; ++k) q[k] = std::min(std::max(q[k] + dq[k], lower[k]), upper[k]);
    }
    return false;
}

}  // namespace kinematics
