#include "inverse_dynamics.hpp"

namespace timing {

namespace {

constexpr int prismatic = 3;

struct Vector {
    double x = 0.0, y = 0.0, z = 0.0;
};

Vector operator+(const Vector& a, const Vector& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vector operator-(const Vector& a, const Vector& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vector operator*(const Vector& a, double k) { return {a.x * k, a.y * k, a.z * k}; }
Vector cross(const Vector& a, const Vector& b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }

Vector times(const double* A, const Vector& v) {
    return {A[0] * v.x + A[1] * v.y + A[2] * v.z, A[3] * v.x + A[4] * v.y + A[5] * v.z, A[6] * v.x + A[7] * v.y + A[8] * v.z};
}

Vector times_transposed(const double* A, const Vector& v) {
    return {A[0] * v.x + A[3] * v.y + A[6] * v.z, A[1] * v.x + A[4] * v.y + A[7] * v.z, A[2] * v.x + A[5] * v.y + A[8] * v.z};
}

Vector vector_of(const double* v) { return {v[0], v[1], v[2]}; }

// How a body moves, and what acts on it and on those that it carries, about its origin.
struct State {
    Vector axis, lever, omega, alpha, moved, force, moment;
};

}  // namespace

std::vector<double> inverse_dynamics(const kinematics::Arm& arm, const std::vector<BodyInertia>& bodies, std::size_t count,
                                     std::size_t cases, const double* q, const double* qd, const double* qdd, const double* gravity) {
    const std::size_t n = arm.joints;
    std::vector<double> out(cases * count * n, 0.0);
    std::vector<kinematics::Frame> frames(bodies.size());
    std::vector<State> states(bodies.size());
    const auto row_of = [&](std::size_t k) { return arm.table.data() + (k - 1) * kinematics::Arm::width; };
    for (std::size_t i = 0; i < count; ++i) {
        kinematics::place(arm, q + i * n, frames, kinematics::Sines::PORTABLE);
        for (std::size_t k = 1; k < bodies.size(); ++k) {
            const std::size_t parent = static_cast<std::size_t>(row_of(k)[0]);
            states[k].axis = times(frames[k].R, vector_of(row_of(k) + 7));
            states[k].lever = vector_of(frames[k].p) - vector_of(frames[parent].p);
        }
        for (std::size_t v = 0; v < cases; ++v) {
            const std::size_t at = (v * count + i) * n;
            states[0].moved = {0.0, 0.0, gravity[v]};
            for (State& state : states) state.force = state.moment = Vector();
            for (std::size_t k = 1; k < bodies.size(); ++k) {
                const double* row = row_of(k);
                const State& below = states[static_cast<std::size_t>(row[0])];
                State& here = states[k];
                const std::size_t joint = static_cast<std::size_t>(row[1]);
                const Vector spin = here.axis * (row[30] * qd[at + joint]), push = here.axis * (row[30] * qdd[at + joint]);
                here.omega = below.omega, here.alpha = below.alpha;
                here.moved = below.moved + cross(below.alpha, here.lever) + cross(below.omega, cross(below.omega, here.lever));
                if (static_cast<int>(row[2]) == prismatic) {
                    here.moved = here.moved + push + cross(below.omega, spin) * 2.0;
                } else {
                    here.omega = below.omega + spin;
                    here.alpha = below.alpha + push + cross(below.omega, spin);
                }
            }
            for (std::size_t k = bodies.size() - 1; k > 0; --k) {
                const double* row = row_of(k);
                const BodyInertia& body = bodies[k];
                State &here = states[k], &below = states[static_cast<std::size_t>(row[0])];
                if (body.mass > 0.0) {
                    const double* R = frames[k].R;
                    const Vector c = times(R, vector_of(body.centre));
                    const Vector force = (here.moved + cross(here.alpha, c) + cross(here.omega, cross(here.omega, c))) * body.mass;
                    const Vector turning = times(R, times(body.tensor, times_transposed(R, here.alpha)));
                    const Vector spinning = times(R, times(body.tensor, times_transposed(R, here.omega)));
                    here.force = here.force + force;
                    here.moment = here.moment + (turning + cross(here.omega, spinning) + cross(c, force));
                }
                const Vector& acting = static_cast<int>(row[2]) == prismatic ? here.force : here.moment;
                double& torque = out[at + static_cast<std::size_t>(row[1])];
                torque = torque + row[30] * (here.axis.x * acting.x + here.axis.y * acting.y + here.axis.z * acting.z);
                below.force = below.force + here.force;
                below.moment = below.moment + (here.moment + cross(here.lever, here.force));
            }
        }
    }
    return out;
}

}  // namespace timing
