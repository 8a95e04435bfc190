#include "obstruction.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace kinematics {

namespace {

constexpr double margin = 1e-5;     // metres by which solids overlap at least: above what the checker may call free, and rounding
constexpr double growth = 1.000001;  // of bounds on motions, above their rounding
constexpr std::size_t most_joints = 16;

Vector plus(const Vector& a, const Vector& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
Vector minus(const Vector& a, const Vector& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
double norm(const Vector& a) { return std::sqrt(dot(a, a)); }
Vector cross(const Vector& a, const Vector& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

struct Rigid {
    Vector x{1.0, 0.0, 0.0}, y{0.0, 1.0, 0.0}, z{0.0, 0.0, 1.0}, p{};  // columns, and the origin

    static Rigid of(const double* rows) {
        return {{rows[0], rows[4], rows[8]}, {rows[1], rows[5], rows[9]}, {rows[2], rows[6], rows[10]}, {rows[3], rows[7], rows[11]}};
    }
    Vector turn(const Vector& v) const {
        return {x[0] * v[0] + y[0] * v[1] + z[0] * v[2], x[1] * v[0] + y[1] * v[1] + z[1] * v[2], x[2] * v[0] + y[2] * v[1] + z[2] * v[2]};
    }
    Vector turn_back(const Vector& v) const { return {dot(x, v), dot(y, v), dot(z, v)}; }
    Vector operator()(const Vector& v) const { return plus(turn(v), p); }
    Vector back(const Vector& v) const { return turn_back(minus(v, p)); }
    Rigid operator*(const Rigid& o) const { return {turn(o.x), turn(o.y), turn(o.z), (*this)(o.p)}; }
    Rigid inverse() const {
        Rigid out{{x[0], y[0], z[0]}, {x[1], y[1], z[1]}, {x[2], y[2], z[2]}, {}};
        const Vector q = out.turn(p);
        out.p = {-q[0], -q[1], -q[2]};
        return out;
    }
};

Vector rotated(const Vector& a, double c, double s, const Vector& v) {
    const Vector w = cross(a, v);
    const double k = dot(a, v) * (1.0 - c);
    return {v[0] * c + w[0] * s + a[0] * k, v[1] * c + w[1] * s + a[1] * k, v[2] * c + w[2] * s + a[2] * k};
}

Rigid about(const Joint& joint, double x) {
    Rigid out;
    if (joint.slides) {
        for (std::size_t i = 0; i < 3; ++i) out.p[i] = x * joint.axis[i];
        return out;
    }
    double c, s;
    arithmetic::cosine_and_sine(x, c, s);
    out.x = rotated(joint.axis, c, s, out.x), out.y = rotated(joint.axis, c, s, out.y), out.z = rotated(joint.axis, c, s, out.z);
    out.p = minus(joint.point, rotated(joint.axis, c, s, joint.point));
    return out;
}

// The turn by the least angle of a unit vector onto another; false if they are nearly opposed.
bool onto(const Vector& from, const Vector& to, Rigid& out) {
    const double c = dot(from, to);
    if (c < -0.5) return false;
    const Vector w = cross(from, to);
    const auto column = [&](const Vector& v) {  // v + w x v + w x (w x v) / (1 + c)
        const Vector a = cross(w, v), b = cross(w, a);
        return plus(v, {a[0] + b[0] / (1.0 + c), a[1] + b[1] / (1.0 + c), a[2] + b[2] / (1.0 + c)});
    };
    out.x = column(out.x), out.y = column(out.y), out.z = column(out.z);
    return true;
}

// Signed distance of a point of the solid's frame to its outside, negative out there.
double depth_in(const Solid& solid, const Vector& p) {
    const double* s = solid.size;
    switch (solid.kind) {
        case Solid::Kind::SPHERE: return s[0] - norm(p);
        case Solid::Kind::CAPSULE: {
            const double z = p[2] - std::max(-s[1], std::min(s[1], p[2]));
            return s[0] - std::sqrt(p[0] * p[0] + p[1] * p[1] + z * z);
        }
        case Solid::Kind::CYLINDER: {
            const double side = s[0] - std::sqrt(p[0] * p[0] + p[1] * p[1]), end = s[1] - std::fabs(p[2]);
            if (side >= 0.0 && end >= 0.0) return std::min(side, end);
            return -std::sqrt(std::min(side, 0.0) * std::min(side, 0.0) + std::min(end, 0.0) * std::min(end, 0.0));
        }
        default: {
            double inner = 1e300, outer = 0.0;
            for (std::size_t i = 0; i < 3; ++i) {
                const double gap = s[i] - std::fabs(p[i]);
                inner = std::min(inner, gap);
                if (gap < 0.0) outer += gap * gap;
            }
            return inner >= 0.0 ? inner : -std::sqrt(outer);
        }
    }
}

}  // namespace

bool Obstruction::blocks(const Loop& loop, const Target& target, const Box& box) const {
    const std::size_t m = loop.joints.size();
    std::array<Rigid, most_joints + 1> links;
    std::array<Vector, most_joints> axes, points;
    std::array<double, most_joints> ways;
    double turned = 0.0;  // by how much the tool turns, at most
    for (std::size_t k = 0; k < m; ++k) {
        const Joint& joint = loop.joints[k];
        const Span& span = box[joint.q];
        const double middle = span.middle();
        axes[k] = links[k].turn(joint.axis), points[k] = links[k](joint.point);
        links[k + 1] = links[k] * about(joint, joint.multiplier * middle);
        const double half = std::max(span.high - middle, middle - span.low) + 1e-12 * (1.0 + std::fabs(middle));
        ways[k] = std::fabs(joint.multiplier) * half * growth;
        if (joint.slides) continue;
        ways[k] = std::min(ways[k], 2.0);
        turned += std::fabs(joint.multiplier) * half * growth;
    }
    // Where the tool is, but for ``shift`` metres, ``lean`` radians about any axis and ``spin`` about ``spindle``, and what brings
    // the middle of the box there.
    const Rigid tool = links[m] * Rigid::of(loop.tool), wanted = Rigid::of(target.rows);
    Rigid reference = wanted;
    double lean = std::min(target.turn_error, 2.0), spin = 0.0;
    Vector spindle{};
    bool by_tool = true;
    const Vector errors = target.position_errors;
    double shift = std::min(target.position_error, norm(errors)) * growth + 1e-9;
    if (target.wanted == Wanted::AXIS) {
        reference = tool;
        reference.p = {};
        Rigid least;
        const Vector from = tool.turn(target.axis), to = wanted.turn(target.axis);
        by_tool = onto(from, to, least);
        reference = least * reference;
        reference.p = wanted.p;
        spindle = target.axis;
        spin = std::min(2.0, turned + 2.0 * norm(minus(to, from)) + target.turn_error);
    } else if (target.wanted == Wanted::POSITION) {
        reference = tool;
        reference.p = wanted.p;
        lean = std::min(2.0, turned);
    }
    lean = lean * growth + 1e-9, spin = spin * growth + 1e-9;
    const Rigid moved = reference * tool.inverse();
    std::array<double, most_joints + 1> sums;  // of the first joints' motions
    const auto sum_up = [&](const Vector& x) {
        sums[0] = 0.0;
        for (std::size_t k = 0; k < m; ++k) {
            double far = 1.0;
            if (!loop.joints[k].slides) far = norm(cross(minus(x, points[k]), axes[k])) + 1e-9;
            sums[k + 1] = sums[k] + ways[k] * far;
        }
    };
    const auto with_tool = [&](const Vector& x) {  // how far a point fixed to the tool may be from ``reference``
        const Vector y = tool.back(x);
        const double along = dot(y, spindle);
        return shift + lean * norm(y) + (spin > 0.0 ? spin * std::sqrt(std::max(0.0, dot(y, y) - along * along)) : 0.0);
    };
    for (const auto& [first, second] : pairs_) {
        for (int turn = 0; turn < 2; ++turn) {
            const Solid& solid = solids_[turn == 0 ? first : second];
            const Solid& other = solids_[turn == 0 ? second : first];
            if (solid.link == 0) continue;
            const Vector middle = links[solid.link](solid.middle), around = links[other.link](other.middle);
            const double reach = solid.radius + other.radius;
            bool direct = norm(minus(middle, around)) < reach;
            bool from_tool = by_tool && other.link == 0 && norm(minus(moved(middle), around)) < reach;
            if (!direct && !from_tool) continue;
            const std::size_t low = std::min(solid.link, other.link), high = std::max(solid.link, other.link);
            for (const Solid::Ball& ball : solid.balls) {
                const Vector x = links[solid.link](ball.centre);
                sum_up(x);
                for (int side = 0; side < 2; ++side) {
                    if (side == 0 ? !direct : !from_tool) continue;
                    const double motion = side == 0 ? sums[high] - sums[low] : sums[m] - sums[solid.link] + with_tool(x);
                    const Vector at = links[other.link].back(side == 0 ? x : moved(x));
                    if (other.kind != Solid::Kind::PLANES) {
                        const Rigid frame = Rigid::of(other.rows);
                        if (depth_in(other, frame.back(at)) + ball.radius > motion * growth + margin) return true;
                        continue;
                    }
                    double inner = 1e300;
                    for (const Solid::Plane& plane : other.planes) {
                        inner = std::min(inner, plane.offset - dot(plane.normal, at));
                        if (inner < motion) break;
                    }
                    if (inner > motion * growth + margin) return true;
                    for (const Solid::Ball& one : other.balls)
                        if (one.radius + ball.radius - norm(minus(at, one.centre)) > motion * growth + margin) return true;
                }
            }
        }
    }
    return false;
}

}  // namespace kinematics
