#include "arm.hpp"

#include "../arithmetic.hpp"

namespace kinematics {

double (*const volatile sine)(double) = std::sin;
double (*const volatile cosine)(double) = std::cos;
double (*const volatile arc_tangent)(double, double) = std::atan2;
double (*const volatile power)(double, double) = std::pow;

namespace {

constexpr int prismatic = 3;

void turn(double* R, const double* by) {
    for (int i = 0; i < 9; i += 3) {
        const double a = R[i], b = R[i + 1], c = R[i + 2];
        for (int k = 0; k < 3; ++k) R[i + k] = a * by[k] + b * by[3 + k] + c * by[6 + k];
    }
}

}  // namespace

double along(const double* row, const double* v) { return row[0] * v[0] + row[1] * v[1] + row[2] * v[2]; }

void place(const Arm& arm, const double* q, std::vector<Frame>& out, Sines sines) {
    out[0] = Frame();
    for (std::size_t k = 0; k < arm.bodies; ++k) {
        const double* row = arm.table.data() + k * Arm::width;
        const int kind = static_cast<int>(row[2]);
        const double angle = row[30] * q[static_cast<std::size_t>(row[1])];
        Frame here = out[static_cast<std::size_t>(row[0])];
        for (int i = 0; i < 3; ++i) here.p[i] += along(here.R + 3 * i, row + 4);
        if (row[10] != 0.0) turn(here.R, row + 11);
        if (kind == prismatic) {
            for (int i = 0; i < 3; ++i) here.p[i] += along(here.R + 3 * i, row + 7) * angle;
        } else {
            double c, s;
            if (sines == Sines::PORTABLE) {
                arithmetic::cosine_and_sine(angle, c, s);
            } else {
                s = sine(angle), c = cosine(angle);
            }
            s = row[3] * s;
            const int u = (kind + 1) % 3, w = (kind + 2) % 3;
            for (int i = 0; i < 9; i += 3) {
                const double first = here.R[i + u], second = here.R[i + w];
                here.R[i + u] = first * c + second * s;
                here.R[i + w] = second * c - first * s;
            }
            if (row[20] != 0.0) turn(here.R, row + 21);
        }
        out[k + 1] = here;
    }
}

void tool_rows(const Arm& arm, const double* q, std::vector<Frame>& frames, double* out) {
    place(arm, q, frames);
    const Frame& body = frames[arm.tool_body];
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 4; ++k) {
            const double last = k == 3 ? 1.0 : 0.0;
            out[4 * i + k] = body.R[3 * i] * arm.tool[k] + body.R[3 * i + 1] * arm.tool[4 + k] +
                             body.R[3 * i + 2] * arm.tool[8 + k] + body.p[i] * last;
        }
}

}  // namespace kinematics
