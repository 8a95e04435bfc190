#include "complete.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

namespace kinematics {

namespace {

constexpr std::size_t most = 7;            // joints
constexpr std::size_t largest_side = 81;   // numbers of a polynomial of the most joints
constexpr double least_width = 1e-6;       // of a box that is split once more
constexpr double blocked_width = 1.0;      // of a box that is asked whether all of it collides
constexpr double lone_width = 0.2;         // of a box in whose middle a solution is looked for
constexpr double tube_width = 0.02;        // of a box through which solutions run on without end, and that is left as it is
constexpr int few_boxes = 2000;            // before which no box is asked whether they do
constexpr double least_damping = 1e-12;    // of the steps to them, which at singularities are many
constexpr int most_steps = 40;
constexpr std::size_t most_near = 64;      // configurations at the target that are kept of boxes in doubt
constexpr double arc_width = 0.2;          // of a box in whose middle an arc of solutions is looked for
constexpr double rounding = 1e-12;         // bounds what rounding adds to a residual and its derivatives (Lemma 4)

using Matrix = std::array<std::array<double, most>, most>;

double widest(const Box& box) {
    double out = 0.0;
    for (const Span& span : box) out = std::max(out, span.high - span.low);
    return out;
}

bool inside(const Box& box, const Box& other) {
    for (std::size_t j = 0; j < box.size(); ++j)
        if (box[j].low < other[j].low || box[j].high > other[j].high) return false;
    return true;
}

// Gauss-Jordan with the largest pivots; false if there is none.
bool invert(Matrix a, std::size_t size, Matrix& out) {
    for (std::size_t i = 0; i < size; ++i)
        for (std::size_t j = 0; j < size; ++j) out[i][j] = i == j ? 1.0 : 0.0;
    for (std::size_t k = 0; k < size; ++k) {
        std::size_t pivot = k;
        for (std::size_t i = k + 1; i < size; ++i)
            if (std::fabs(a[i][k]) > std::fabs(a[pivot][k])) pivot = i;
        if (!(std::fabs(a[pivot][k]) > 1e-13)) return false;
        std::swap(a[k], a[pivot]);
        std::swap(out[k], out[pivot]);
        const double scale = 1.0 / a[k][k];
        for (std::size_t j = 0; j < size; ++j) a[k][j] *= scale, out[k][j] *= scale;
        for (std::size_t i = 0; i < size; ++i) {
            const double factor = a[i][k];
            if (i == k || factor == 0.0) continue;
            for (std::size_t j = 0; j < size; ++j) a[i][j] -= factor * a[k][j], out[i][j] -= factor * out[k][j];
        }
    }
    return true;
}

// Six numbers, five or three that are 0 at the target, and their derivatives by q.
struct Residual {
    std::array<double, 6> value{};
    std::array<std::array<double, most>, 6> slope{};
    double agreement = 3.0;  // 1 + 2 cos(angle from the target's orientation or axis): some are 0 half a turn away, too
};

class Proof {
  public:
    Proof(const Loop& loop, const Target& target) : loop_(loop), target_(target) {
        rows_ = target.wanted == Wanted::POSE ? 6 : target.wanted == Wanted::AXIS ? 5 : 3;
        const double* R = target.rows;
        const Vector d = {R[0] * target.axis[0] + R[1] * target.axis[1] + R[2] * target.axis[2],
                          R[4] * target.axis[0] + R[5] * target.axis[1] + R[6] * target.axis[2],
                          R[8] * target.axis[0] + R[9] * target.axis[1] + R[10] * target.axis[2]};
        const Vector unit = std::fabs(d[0]) < 0.6 ? Vector{1.0, 0.0, 0.0} : Vector{0.0, 1.0, 0.0};
        side_ = cross(d, unit);
        const double size = std::sqrt(dot(side_, side_));
        for (double& x : side_) x = size > 0.0 ? x / size : 0.0;
        other_ = cross(d, side_);
        towards_ = d;
        // How far the end is from each axis at most; bounds on second derivatives, summed over the bodies that a joint moves.
        const std::size_t m = loop.joints.size();
        std::vector<double> reach(m);
        for (std::size_t k = m; k-- > 0;) {
            const Vector& next = k + 1 == m ? end_at_home() : loop.joints[k + 1].point;
            Vector step;
            for (std::size_t i = 0; i < 3; ++i) step[i] = next[i] - loop.joints[k].point[i];
            reach[k] = std::sqrt(dot(step, step)) + (k + 1 == m ? 0.0 : reach[k + 1] + loop.strokes[k + 1]);
        }
        for (std::size_t i = 0; i < m; ++i)
            for (std::size_t j = i; j < m; ++j) {
                const Joint &a = loop.joints[i], &b = loop.joints[j];
                const double scale = std::fabs(a.multiplier * b.multiplier);
                const double shift = a.slides ? 0.0 : scale * (b.slides ? 1.0 : reach[j]);
                const double turn = a.slides || b.slides ? 0.0 : scale;
                shift_[a.q][b.q] += shift, turn_[a.q][b.q] += turn;
                if (i != j) shift_[b.q][a.q] += shift, turn_[b.q][a.q] += turn;
            }
        for (const Joint& joint : loop.joints)
            (joint.slides ? slides_ : turns_)[joint.q] += std::fabs(joint.multiplier);
        const Vector end = end_at_home();
        const Vector arm = {end[0] - loop.tool[3], end[1] - loop.tool[7], end[2] - loop.tool[11]};
        arm_ = target.wanted == Wanted::POSE ? std::sqrt(dot(arm, arm)) : 0.0;
        const double swing = arm_ * target.turn_error;
        place_error_ = target.position_error + swing;
        for (std::size_t i = 0; i < 3; ++i) place_errors_[i] = std::min(target.position_error, target.position_errors[i]) + swing;
    }

    std::size_t rows() const { return rows_; }

    // The residuals in the middle of a box, with their slack, and their derivatives over all of it. False if the tool is turned
    // away from the target in all of the box.
    bool enclose(const double* middle, const double* half, Ball* values, std::array<Ball, most>* slopes) const {
        const Residual at = residual(std::vector<double>(middle, middle + loop_.n));
        const double slack = this->slack();
        double turned = at.agreement + 1e-9;
        for (std::size_t j = 0; j < loop_.n; ++j) turned += 2.0 * turns_[j] * half[j];
        if (turned < 1.0 + 2.0 * std::cos(std::min(target_.turn_error, pi))) return false;
        for (std::size_t e = 0; e < rows_; ++e) {
            values[e] = {at.value[e], (e < 3 ? place_errors_[e] : target_.turn_error) + slack};
            for (std::size_t j = 0; j < loop_.n; ++j) {
                double bend = slack;
                for (std::size_t i = 0; i < loop_.n; ++i) bend += (e < 3 ? shift_ : turn_)[i][j] * half[i];
                slopes[e][j] = {at.slope[e][j], bend};
            }
        }
        return true;
    }

    // The solution to which Newton's method leads from q, if there is a box that it is proven to be alone in.
    std::optional<Solution> from(std::vector<double> q, double most_move) const {
        const std::vector<double> start = q;
        Residual at;
        Matrix Y;  // row v: what moves joint v for each residual
        double last = 1e300;
        for (int step = 0; step < 12; ++step) {
            at = residual(q);
            if (!solve(at, Y)) return std::nullopt;
            double move = 0.0;
            for (std::size_t v = 0; v < loop_.n; ++v) {
                double x = 0.0;
                for (std::size_t e = 0; e < rows_; ++e) x += Y[v][e] * at.value[e];
                q[v] -= x;
                move = std::max(move, std::fabs(x));
                if (std::fabs(q[v] - start[v]) > (slides_[v] ? std::min(most_move, slide_room) : most_move)) return std::nullopt;
            }
            if (move < 1e-12 || (step > 3 && move > 0.5 * last)) break;
            last = move;
        }
        at = residual(q);
        if (at.agreement < 1.0 || !solve(at, Y)) return std::nullopt;
        return alone(q, at, Y);
    }

    // An arc of solutions through about q, of an arm with one joint more than equations (Lemma 6). It reaches as far as it can be
    // proven, up to ``reach``.
    std::optional<Arc> arc(std::vector<double> q, double reach) const {
        const std::size_t n = loop_.n;
        const std::vector<double> start = q;
        Residual at = residual(q);
        std::array<std::size_t, most> others{};
        const std::size_t joint = free_joint(at, others);
        if (joint == n) return std::nullopt;
        Matrix Y;
        double last = 1e300;
        for (int step = 0; step < 12; ++step) {
            if (step > 0) at = residual(q);
            if (!solve(at, others, Y)) return std::nullopt;
            double move = 0.0;
            for (std::size_t v = 0; v < rows_; ++v) {
                double x = 0.0;
                for (std::size_t e = 0; e < rows_; ++e) x += Y[v][e] * at.value[e];
                double& here = q[others[v]];
                here -= x;
                move = std::max(move, std::fabs(x));
                if (std::fabs(here - start[others[v]]) > (slides_[others[v]] > 0.0 ? slide_room : 0.5)) return std::nullopt;
            }
            if (move < 1e-12 || (step > 3 && move > 0.5 * last)) break;
            last = move;
        }
        at = residual(q);
        if (at.agreement < 1.0 || !solve(at, others, Y)) return std::nullopt;
        for (int tries = 0; tries < 6; ++tries, reach *= 0.5)
            if (std::optional<Arc> out = proven_arc(q, at, Y, joint, others, slides_[joint] > 0.0 ? std::min(reach, slide_room) : reach)) return out;
        return std::nullopt;
    }

    // A configuration of the domain to which damped steps from q lead, whose tool is at the target, within its errors. Only if the
    // orientation may be off, too, the tool may be farther off, by as much as that moves it.
    std::optional<std::vector<double>> towards(std::vector<double> q, const Box& domain, double damping = 1e-9, int steps = 20) const {
        const std::size_t n = loop_.n;
        std::optional<std::vector<double>> best;
        for (int step = 0; step < steps; ++step) {
            const Residual at = residual(q);
            double turned = 0.0, largest = 0.0, finest = target_.position_error;
            for (std::size_t e = 3; e < rows_; ++e) turned += at.value[e] * at.value[e];
            turned = std::sqrt(turned);
            for (std::size_t i = 0; i < 3; ++i) finest = std::min(finest, target_.position_errors[i]);
            bool within = turned <= 0.9 * target_.turn_error && at.agreement > 1.0, well = turned * arm_ <= 0.05 * finest;
            for (std::size_t e = 0; e < 3; ++e) {
                const double off = std::fabs(at.value[e]);
                within = within && off <= 0.9 * place_errors_[e];
                well = well && off <= 0.85 * std::min(target_.position_error, target_.position_errors[e]);
            }
            for (std::size_t e = 0; e < rows_; ++e) largest = std::max(largest, std::fabs(at.value[e]));
            if (within) best = q;
            if ((within && well) || step == steps - 1 || !(largest < 1.0)) break;
            // With joints at their limits held: J Jt y = f, so that -Jt y is the shortest step.
            std::array<bool, most> held{};
            for (int again = 0; again < 2; ++again) {
                Matrix A{}, inverse;
                for (std::size_t e = 0; e < rows_; ++e) {
                    for (std::size_t f = 0; f < rows_; ++f)
                        for (std::size_t j = 0; j < n; ++j)
                            if (!held[j]) A[e][f] += at.slope[e][j] * at.slope[f][j];
                    A[e][e] += damping + 1e-3 * largest * largest;
                }
                if (!invert(A, rows_, inverse)) return best;
                std::array<double, most> move{};
                for (std::size_t e = 0; e < rows_; ++e) {
                    double y = 0.0;
                    for (std::size_t f = 0; f < rows_; ++f) y += inverse[e][f] * at.value[f];
                    for (std::size_t j = 0; j < n; ++j)
                        if (!held[j]) move[j] -= at.slope[e][j] * y;
                }
                bool more = false;
                for (std::size_t j = 0; j < n && again == 0; ++j)
                    if ((move[j] > 0.0 && q[j] >= domain[j].high) || (move[j] < 0.0 && q[j] <= domain[j].low)) held[j] = more = true;
                if (more) continue;
                for (std::size_t j = 0; j < n; ++j) q[j] = std::max(domain[j].low, std::min(domain[j].high, q[j] + move[j]));
                break;
            }
        }
        return best;
    }

    // The direction in which the residuals change least at q, of length 1: of JtJ the least eigenvector, by inverse iteration.
    std::array<double, most> flattest(const std::vector<double>& q) const {
        const std::size_t n = loop_.n;
        const Residual at = residual(q);
        Matrix A{}, inverse;
        std::array<double, most> way{};
        for (std::size_t i = 0; i < n; ++i) {
            for (std::size_t j = 0; j < n; ++j)
                for (std::size_t e = 0; e < rows_; ++e) A[i][j] += at.slope[e][i] * at.slope[e][j];
            A[i][i] += 1e-9;
            way[i] = 1.0 + 0.1 * static_cast<double>(i);
        }
        if (!invert(A, n, inverse)) return way;
        for (int step = 0; step < 4; ++step) {
            std::array<double, most> next{};
            double size = 0.0;
            for (std::size_t i = 0; i < n; ++i) {
                for (std::size_t j = 0; j < n; ++j) next[i] += inverse[i][j] * way[j];
                size += next[i] * next[i];
            }
            for (std::size_t i = 0; i < n; ++i) way[i] = next[i] / std::sqrt(size);
        }
        return way;
    }

  private:
    const Loop& loop_;
    const Target& target_;
    std::size_t rows_;
    Vector side_{}, other_{}, towards_{};
    std::array<std::array<double, most>, most> shift_{}, turn_{};
    std::array<double, most> turns_{}, slides_{};  // by how much a joint turns and slides bodies
    double place_error_ = 0.0;  // metres by which the end may be off
    Vector place_errors_{};     // and along each axis of the base
    double arm_ = 0.0;          // metres from the end to the tool

    double slack() const { return rounding * (1.0 + loop_.longest) * loop_.steepest; }

    static double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
    static Vector cross(const Vector& a, const Vector& b) {
        return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    }

    // Where the loop's last point is at the target: the tool itself, or a point on the last axis.
    Vector end_at_home() const {
        const Joint& last = loop_.joints.back();
        const Vector home = {loop_.tool[3], loop_.tool[7], loop_.tool[11]};
        return target_.wanted == Wanted::POSE && !last.slides ? last.point : home;
    }

    Residual residual(const std::vector<double>& q) const {
        Residual out;
        const Vector end = end_at_home();
        const double *H = loop_.tool, *T = target_.rows;
        // The pose M_1 ... M_m H, by its columns, from the last joint to the first; joints then seen from the base.
        std::array<Vector, 4> X;
        for (std::size_t c = 0; c < 3; ++c) X[c] = {H[c], H[4 + c], H[8 + c]};
        X[3] = end;
        const std::size_t m = loop_.joints.size();
        double cosine[16], sine[16];
        for (std::size_t k = m; k-- > 0;) {
            const Joint& joint = loop_.joints[k];
            const double x = joint.multiplier * q[joint.q];
            if (joint.slides) {
                for (std::size_t i = 0; i < 3; ++i) X[3][i] += x * joint.axis[i];
                continue;
            }
            arithmetic::cosine_and_sine(x, cosine[k], sine[k]);
            for (std::size_t c = 0; c < 4; ++c) {
                if (c == 3)
                    for (std::size_t i = 0; i < 3; ++i) X[3][i] -= joint.point[i];
                X[c] = turn(joint.axis, cosine[k], sine[k], X[c]);
                if (c == 3)
                    for (std::size_t i = 0; i < 3; ++i) X[3][i] += joint.point[i];
            }
        }
        // The end's place at the target: T inv(H) end.
        Vector wanted;
        const Vector from_home = {end[0] - H[3], end[1] - H[7], end[2] - H[11]};
        Vector local;
        for (std::size_t c = 0; c < 3; ++c) local[c] = H[c] * from_home[0] + H[4 + c] * from_home[1] + H[8 + c] * from_home[2];
        for (std::size_t i = 0; i < 3; ++i) wanted[i] = T[4 * i + 3] + T[4 * i] * local[0] + T[4 * i + 1] * local[1] + T[4 * i + 2] * local[2];
        std::array<Vector, 3> goal;
        for (std::size_t c = 0; c < 3; ++c) goal[c] = {T[c], T[4 + c], T[8 + c]};
        Vector d{};
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t i = 0; i < 3; ++i) d[i] += X[c][i] * target_.axis[c];
        for (std::size_t i = 0; i < 3; ++i) out.value[i] = X[3][i] - wanted[i];
        if (rows_ == 6) {
            for (std::size_t i = 0; i < 3; ++i) {
                const std::size_t u = (i + 1) % 3, w = (i + 2) % 3;
                out.value[3 + i] = 0.5 * (dot(goal[w], X[u]) - dot(goal[u], X[w]));
            }
            out.agreement = dot(goal[0], X[0]) + dot(goal[1], X[1]) + dot(goal[2], X[2]);
        } else if (rows_ == 5) {
            out.value[3] = dot(side_, d), out.value[4] = dot(other_, d);
            out.agreement = 1.0 + 2.0 * dot(towards_, d);
        }
        // Axes where the joints before have brought them.
        std::array<Vector, 3> R = {Vector{1.0, 0.0, 0.0}, Vector{0.0, 1.0, 0.0}, Vector{0.0, 0.0, 1.0}};  // columns
        Vector p{};
        for (std::size_t k = 0; k < m; ++k) {
            const Joint& joint = loop_.joints[k];
            Vector a, o = p;
            for (std::size_t i = 0; i < 3; ++i) {
                a[i] = R[0][i] * joint.axis[0] + R[1][i] * joint.axis[1] + R[2][i] * joint.axis[2];
                o[i] += R[0][i] * joint.point[0] + R[1][i] * joint.point[1] + R[2][i] * joint.point[2];
            }
            const double by = joint.multiplier;
            if (joint.slides) {
                for (std::size_t i = 0; i < 3; ++i) out.slope[i][joint.q] += by * a[i], p[i] += by * q[joint.q] * a[i];
                continue;
            }
            const Vector moved = cross(a, {X[3][0] - o[0], X[3][1] - o[1], X[3][2] - o[2]});
            for (std::size_t i = 0; i < 3; ++i) out.slope[i][joint.q] += by * moved[i];
            if (rows_ == 6) {
                for (std::size_t i = 0; i < 3; ++i) {
                    const std::size_t u = (i + 1) % 3, w = (i + 2) % 3;
                    out.slope[3 + i][joint.q] += by * 0.5 * (dot(goal[w], cross(a, X[u])) - dot(goal[u], cross(a, X[w])));
                }
            } else if (rows_ == 5) {
                const Vector turned = cross(a, d);
                out.slope[3][joint.q] += by * dot(side_, turned), out.slope[4][joint.q] += by * dot(other_, turned);
            }
            for (Vector& column : R) column = turn(a, cosine[k], sine[k], column);
            Vector back = {p[0] - o[0], p[1] - o[1], p[2] - o[2]};
            back = turn(a, cosine[k], sine[k], back);
            for (std::size_t i = 0; i < 3; ++i) p[i] = o[i] + back[i];
        }
        return out;
    }

    static Vector turn(const Vector& a, double c, double s, const Vector& v) {
        const Vector across = cross(a, v);
        const double along = dot(a, v) * (1.0 - c);
        return {v[0] * c + across[0] * s + a[0] * along, v[1] * c + across[1] * s + a[1] * along, v[2] * c + across[2] * s + a[2] * along};
    }

    // The inverse of the derivative; of more rows than joints, that of least squares.
    bool solve(const Residual& at, Matrix& Y) const {
        const std::size_t n = loop_.n;
        Matrix A{}, inverse;
        if (n == rows_) {
            for (std::size_t e = 0; e < rows_; ++e) A[e] = at.slope[e];
            return invert(A, n, Y);
        }
        for (std::size_t i = 0; i < n; ++i)
            for (std::size_t j = 0; j < n; ++j)
                for (std::size_t e = 0; e < rows_; ++e) A[i][j] += at.slope[e][i] * at.slope[e][j];
        if (!invert(A, n, inverse)) return false;
        for (std::size_t i = 0; i < n; ++i)
            for (std::size_t e = 0; e < rows_; ++e) {
                Y[i][e] = 0.0;
                for (std::size_t j = 0; j < n; ++j) Y[i][e] += inverse[i][j] * at.slope[e][j];
            }
        return true;
    }

    // The joint that solutions move along most, and the others, by elimination with the largest pivots; n if there is none.
    std::size_t free_joint(const Residual& at, std::array<std::size_t, most>& others) const {
        const std::size_t n = loop_.n;
        auto rows = at.slope;
        unsigned used = 0, done = 0;
        for (std::size_t count = 0; count < rows_; ++count) {
            std::size_t row = 0, column = 0;
            double best = 1e-9;
            for (std::size_t e = 0; e < rows_; ++e)
                for (std::size_t j = 0; j < n; ++j)
                    if (((done >> e) & 1) == 0 && ((used >> j) & 1) == 0 && std::fabs(rows[e][j]) > best) best = std::fabs(rows[e][j]), row = e, column = j;
            if (best == 1e-9) return n;
            done |= 1U << row, used |= 1U << column;
            for (std::size_t e = 0; e < rows_; ++e) {
                const double factor = rows[e][column] / rows[row][column];
                if (((done >> e) & 1) == 0)
                    for (std::size_t j = 0; j < n; ++j) rows[e][j] -= factor * rows[row][j];
            }
        }
        std::size_t joint = n, count = 0;
        for (std::size_t j = 0; j < n; ++j)
            if (((used >> j) & 1) != 0) {
                others[count++] = j;
            } else {
                joint = j;
            }
        return joint;
    }

    // The inverse of the derivative by all joints but one.
    bool solve(const Residual& at, const std::array<std::size_t, most>& others, Matrix& Y) const {
        Matrix A{};
        for (std::size_t e = 0; e < rows_; ++e)
            for (std::size_t v = 0; v < rows_; ++v) A[e][v] = at.slope[e][others[v]];
        return invert(A, rows_, Y);
    }

    // For each value of the joint within ``reach``, x - Y f is a contraction of a box about the line q + s along (Lemma 6).
    std::optional<Arc> proven_arc(const std::vector<double>& q, const Residual& at, const Matrix& Y, std::size_t joint,
                                  const std::array<std::size_t, most>& others, double reach) const {
        const std::size_t n = loop_.n;
        const double slack = this->slack(), place_error = place_error_ + slack;
        std::array<double, most> shift{}, turn{}, defect{}, weight{}, drift{};
        std::vector<double> along(n, 0.0);
        along[joint] = 1.0;
        for (std::size_t v = 0; v < rows_; ++v)
            for (std::size_t e = 0; e < rows_; ++e) along[others[v]] -= Y[v][e] * at.slope[e][joint];
        double away[2] = {0.0, 0.0}, heaviest = 0.0, moved = 0.0;
        for (std::size_t e = 0; e < rows_; ++e) away[e < 3 ? 0 : 1] += at.value[e] * at.value[e];
        if (std::sqrt(away[0]) > place_error || std::sqrt(away[1]) > target_.turn_error + slack) return std::nullopt;
        for (std::size_t j = 0; j < n; ++j) moved += std::fabs(along[j]) * reach;
        const auto bend = [&](const std::array<std::array<double, most>, most>& curved, const std::array<double, most>& a, const std::array<double, most>& b) {
            double sum = 0.0;
            for (std::size_t i = 0; i < n; ++i)
                for (std::size_t j = 0; j < n; ++j) sum += curved[i][j] * a[i] * b[j];
            return sum;
        };
        for (std::size_t j = 0; j < n; ++j) drift[j] = std::fabs(along[j]) * reach;
        for (std::size_t v = 0; v < rows_; ++v) {
            double value = 0.0, stray = 0.0;
            for (std::size_t e = 0; e < rows_; ++e) {
                value += Y[v][e] * at.value[e];
                (e < 3 ? shift : turn)[v] += Y[v][e] * Y[v][e];
                double rate = 0.0;
                for (std::size_t j = 0; j < n; ++j) rate += at.slope[e][j] * along[j];
                stray += Y[v][e] * rate;
            }
            shift[v] = std::sqrt(shift[v]), turn[v] = std::sqrt(turn[v]);
            defect[v] = std::fabs(value) + (std::fabs(stray) + (shift[v] + turn[v]) * slack * static_cast<double>(n)) * (reach + moved) +
                        0.5 * (shift[v] * bend(shift_, drift, drift) + turn[v] * bend(turn_, drift, drift)) + shift[v] * place_error +
                        turn[v] * (target_.turn_error + slack);
            heaviest = std::max(heaviest, shift[v] * loop_.longest + turn[v]);
        }
        if (!(heaviest > 0.0)) return std::nullopt;
        std::array<double, most> sizes{};
        double sum = 0.0;
        for (std::size_t v = 0; v < rows_; ++v) {
            weight[v] = std::max((shift[v] * loop_.longest + turn[v]) / heaviest, 1e-3);
            sizes[others[v]] = weight[v];
            sum += weight[v];
        }
        const double drift_shift = bend(shift_, drift, sizes), drift_turn = bend(turn_, drift, sizes);
        const double size_shift = bend(shift_, sizes, sizes), size_turn = bend(turn_, sizes, sizes);
        double least = 0.0, greatest = 1e300;
        for (std::size_t v = 0; v < rows_; ++v) {
            double linear = (shift[v] + turn[v]) * slack * sum + shift[v] * drift_shift + turn[v] * drift_turn;
            for (std::size_t w = 0; w < rows_; ++w) {
                double x = v == w ? -1.0 : 0.0;
                for (std::size_t e = 0; e < rows_; ++e) x += Y[v][e] * at.slope[e][others[w]];
                linear += std::fabs(x) * weight[w];
            }
            const double square = shift[v] * size_shift + turn[v] * size_turn, b = weight[v] - linear;
            const double root = b * b - 4.0 * square * defect[v];
            if (!(b > 0.0) || !(root > 0.0)) return std::nullopt;
            const double high = (b + std::sqrt(root)) / (2.0 * std::max(square, 1e-300));
            greatest = std::min({greatest, 0.99 * high, (slides_[others[v]] > 0.0 ? slide_room : 1.0) / weight[v]});
            least = std::max(least, 1.01 * defect[v] / std::max(square * high, 1e-300));
        }
        least = std::max(least, 1e-14);
        // Half a turn away the residual is 0, too: not within the box.
        double turned = at.agreement - 1e-9;
        for (std::size_t j = 0; j < n; ++j) turned -= 2.0 * turns_[j] * (drift[j] + least * sizes[j]);
        if (!(least < greatest) || !(turned > -1.0)) return std::nullopt;
        Arc out{joint, reach, q, along, std::vector<double>(n, 0.0), std::vector<double>(n, 0.0)};
        for (std::size_t v = 0; v < rows_; ++v) {
            const std::size_t j = others[v];
            const double rounded = 1e-15 * (std::fabs(q[j]) + std::fabs(along[j]));
            out.box[j] = least * weight[v] + rounded;
            out.lone[j] = greatest * weight[v] - rounded;
        }
        return out;
    }

    // Two boxes around q in which q - Y f(q) is a contraction, for each pose within the errors of the target (Lemma 5).
    std::optional<Solution> alone(const std::vector<double>& q, const Residual& at, const Matrix& Y) const {
        const std::size_t n = loop_.n;
        std::array<double, most> shift{}, turn{}, defect{}, weight{};
        const double slack = this->slack(), place_error = place_error_ + slack;
        double away[2] = {0.0, 0.0}, heaviest = 0.0;
        for (std::size_t e = 0; e < rows_; ++e) away[e < 3 ? 0 : 1] += at.value[e] * at.value[e];
        // At q itself the tool is at the target, within its errors (plus rounding).
        if (std::sqrt(away[0]) > place_error || std::sqrt(away[1]) > target_.turn_error + slack) return std::nullopt;
        for (std::size_t v = 0; v < n; ++v) {
            double value = 0.0;
            for (std::size_t e = 0; e < rows_; ++e) {
                value += Y[v][e] * at.value[e];
                (e < 3 ? shift : turn)[v] += Y[v][e] * Y[v][e];
            }
            shift[v] = std::sqrt(shift[v]), turn[v] = std::sqrt(turn[v]);
            defect[v] = std::fabs(value) + shift[v] * place_error + turn[v] * (target_.turn_error + slack);
            weight[v] = shift[v] * loop_.longest + turn[v];
            heaviest = std::max(heaviest, weight[v]);
        }
        if (!(heaviest > 0.0)) return std::nullopt;
        for (std::size_t v = 0; v < n; ++v) weight[v] = std::max(weight[v] / heaviest, 1e-3);
        double curved_shift = 0.0, curved_turn = 0.0, sum = 0.0;  // for the box of size 1
        for (std::size_t i = 0; i < n; ++i) {
            sum += weight[i];
            for (std::size_t j = 0; j < n; ++j) {
                curved_shift += shift_[i][j] * weight[i] * weight[j];
                curved_turn += turn_[i][j] * weight[i] * weight[j];
            }
        }
        // For each joint, defect + linear size + square size² < weight size; two sizes between which it holds.
        double least = 0.0, greatest = 1e300;
        for (std::size_t v = 0; v < n; ++v) {
            double linear = (shift[v] + turn[v]) * slack * sum;
            for (std::size_t w = 0; w < n; ++w) {
                double x = v == w ? -1.0 : 0.0;
                for (std::size_t e = 0; e < rows_; ++e) x += Y[v][e] * at.slope[e][w];
                linear += std::fabs(x) * weight[w];
            }
            const double square = shift[v] * curved_shift + turn[v] * curved_turn, b = weight[v] - linear;
            const double root = b * b - 4.0 * square * defect[v];
            if (!(b > 0.0) || !(root > 0.0)) return std::nullopt;
            const double high = (b + std::sqrt(root)) / (2.0 * std::max(square, 1e-300));
            greatest = std::min({greatest, 0.99 * high, (slides_[v] > 0.0 ? slide_room : 1.0) / weight[v]});
            least = std::max(least, 1.01 * defect[v] / (square * high));
        }
        least = std::max(least, 1e-14);
        if (!(least < greatest)) return std::nullopt;
        Solution out{q, Box(n), Box(n)};
        for (std::size_t v = 0; v < n; ++v) {
            const double near = least * weight[v] + 1e-15 * std::fabs(q[v]), far = greatest * weight[v];
            out.box[v] = {q[v] - near, q[v] + near};
            out.lone[v] = {q[v] - far, q[v] + far};
        }
        return out;
    }
};

struct Gap {
    std::size_t joint = most;
    Span hole;
    std::size_t equation = 0, index = 0;  // that shows it, and the joint of the chain
};

class Search {
  public:
    Search(const Loop& loop, const Target& target, const Box& domain, Trail* trail)
        : loop_(loop), target_(target), domain_(domain), equations_(equations_of(loop, target)), proof_(loop, target), halved_(halved(target)), near_(loop, halved_), cosines_(loop.joints.size()), sines_(loop.joints.size()), trail_(trail) {
        if (trail_ == nullptr) return;
        for (const Equation& each : equations_) {
            const Origin& from = each.origin;
            for (const double x : {static_cast<double>(from.pair), static_cast<double>(from.cut), static_cast<double>(from.kind),
                                   from.along[0], from.along[1], from.along[2]})
                trail_->equations.push_back(x);
        }
        for (const Followed& each : followed_by(loop, target))
            for (const double x : {each.still ? 1.0 : 0.0, each.point ? 1.0 : 0.0, each.at[0], each.at[1], each.at[2]})
                trail_->followed.push_back(x);
    }

    Complete run(int most_boxes) {
        Complete out;
        std::vector<Box> stack{domain_};
        while (!stack.empty()) {
            Box box = std::move(stack.back());
            stack.pop_back();
            if (out.boxes >= most_boxes) {
                leave(box, out);
                continue;
            }
            ++out.boxes;
            Gap gap;
            if (!contract(box, gap) || !narrow(box, out)) continue;
            if (widest(box) < least_width || (out.boxes > few_boxes && widest(box) < tube_width && runs_on(box, out))) {
                leave(box, out);
                continue;
            }
            split(box, gap, stack);
        }
        for (const Box& box : out.unresolved) {
            if (box.size() > proof_.rows() || out.near.size() >= most_near) break;
            std::optional<std::vector<double>> found = reached_in(box);
            if (!found) found = near_.towards(middle_of(box), domain_, least_damping, most_steps);
            if (found) out.near.push_back(std::move(*found));
        }
        return out;
    }

    // A configuration of a box whose tool is at the target, if steps from its middle lead to one.
    std::optional<std::vector<double>> reached_in(const Box& box) const { return near_.towards(middle_of(box), box, least_damping, most_steps); }

    Cover cover(const std::vector<Box>& from, const Obstruction* obstruction, const CoverLimits& limits) {
        Cover out;
        std::vector<Box> stack = from;
        int seen = 0;
        while (!stack.empty()) {
            Box box = std::move(stack.back());
            stack.pop_back();
            Gap gap;
            ++seen;
            if (!contract(box, gap)) continue;
            bool left = true;
            for (int round = 0; left && round < 4; ++round) {
                const double before = widest(box);
                left = linearised(box);
                if (!left || widest(box) > 0.7 * before) break;
                gap = Gap{};
                left = contract(box, gap);
            }
            if (!left) continue;
            const double wide = widest(box);
            if (obstruction != nullptr && wide < blocked_width && obstruction->blocks(loop_, target_, box)) {
                out.obstructed = true;
            } else if (wide <= limits.width || stack.size() + out.boxes.size() >= limits.most || seen >= limits.most_seen) {
                out.boxes.push_back(std::move(box));
            } else {
                split(box, gap, stack);
            }
        }
        const std::size_t step = limits.most_near == 0 ? 1 : 1 + (out.boxes.size() - 1) / std::max<std::size_t>(limits.most_near, 1);
        for (std::size_t k = 0; limits.most_near > 0 && k < out.boxes.size(); k += step) {
            std::vector<double> q(loop_.n);
            for (std::size_t j = 0; j < loop_.n; ++j) q[j] = out.boxes[k][j].middle();
            if (std::optional<std::vector<double>> found = proof_.towards(std::move(q), domain_)) out.near.push_back(std::move(*found));
        }
        return out;
    }

  private:
    const Loop& loop_;
    const Target& target_;
    const Box& domain_;
    std::vector<Equation> equations_;
    Proof proof_;
    Target halved_;
    Proof near_;  // which looks for configurations at half the errors: those along three axes together are within them
    std::vector<Ball> cosines_, sines_;
    std::vector<std::array<Ball, most>> slopes_;
    Trail* trail_;

    static Target halved(Target target) {
        target.position_error *= 0.5, target.turn_error *= 0.5;
        for (double& x : target.position_errors) x *= 0.5;
        return target;
    }

    void note(Step step, double a, double b, Span span = {}, double c = 0.0) {
        if (trail_ == nullptr) return;
        for (const double x : {static_cast<double>(step), a, b, span.low, span.high, c}) trail_->steps.push_back(x);
    }

    // The number of a new sum.
    double sum_of(const std::size_t* rows, const double* factors, std::size_t count) {
        if (trail_ == nullptr) return 0.0;
        for (std::size_t i = 0; i < most; ++i) {
            trail_->sums.push_back(i < count ? static_cast<double>(rows[i]) : -1.0);
            trail_->sums.push_back(i < count ? factors[i] : 0.0);
        }
        return static_cast<double>(trail_->sums.size() / (2 * most) - 1);
    }

    static bool inside(const Box& box, const Arc& arc) {
        const Span& span = box[arc.joint];
        const double from = span.low - arc.q[arc.joint], to = span.high - arc.q[arc.joint];
        if (from < -arc.reach || to > arc.reach) return false;
        for (std::size_t j = 0; j < box.size(); ++j) {
            if (j == arc.joint) continue;
            const double a = arc.along[j] * from, b = arc.along[j] * to;
            if (box[j].low - arc.q[j] - std::max(a, b) < -arc.lone[j] || box[j].high - arc.q[j] - std::min(a, b) > arc.lone[j]) return false;
        }
        return true;
    }

    bool known(const Box& box, const Complete& out) {
        if (std::any_of(out.arcs.begin(), out.arcs.end(), [&](const Arc& arc) { return inside(box, arc); })) return true;
        for (std::size_t k = 0; k < out.solutions.size(); ++k)
            if (kinematics::inside(box, out.solutions[k].lone)) {
                note(Step::KNOWN, static_cast<double>(k), 0.0);
                return true;
            }
        return false;
    }

    static bool lone(const Box& box, const Complete& out) {
        return std::any_of(out.solutions.begin(), out.solutions.end(), [&](const Solution& s) { return kinematics::inside(box, s.lone); });
    }

    static std::vector<double> middle_of(const Box& box) {
        std::vector<double> q(box.size());
        for (std::size_t j = 0; j < box.size(); ++j) q[j] = box[j].middle();
        return q;
    }

    // Whether solutions run on through a box, as they do where the axes of a wrist are in line: there is one in it, and another
    // where no equation changes at first. This is no proof, and need not be one: such a box is left in doubt.
    bool runs_on(const Box& box, Complete& out) const {
        if (box.size() > proof_.rows()) return false;
        const std::optional<std::vector<double>> first = near_.towards(middle_of(box), domain_, least_damping, most_steps);
        if (!first) return false;
        for (std::size_t j = 0; j < box.size(); ++j)
            if ((*first)[j] < box[j].low || (*first)[j] > box[j].high) return false;
        const std::array<double, most> way = near_.flattest(*first);
        for (const double step : {0.25 * widest(box), -0.25 * widest(box)}) {
            std::vector<double> q = *first;
            for (std::size_t j = 0; j < box.size(); ++j) q[j] = std::max(domain_[j].low, std::min(domain_[j].high, q[j] + step * way[j]));
            const std::optional<std::vector<double>> second = near_.towards(std::move(q), domain_, least_damping, most_steps);
            double apart = 0.0;
            for (std::size_t j = 0; second && j < box.size(); ++j) apart = std::max(apart, std::fabs((*second)[j] - (*first)[j]));
            if (apart > 0.05 * widest(box)) {
                if (out.near.size() < most_near / 2) out.near.push_back(*first);
                return true;
            }
        }
        return false;
    }

    // Boxes in doubt that touch become one.
    static void leave(Box box, Complete& out) {
        for (std::size_t k = 0; k < out.unresolved.size();) {
            Box& other = out.unresolved[k];
            bool touching = true;
            for (std::size_t j = 0; j < box.size(); ++j)
                touching = touching && box[j].low <= other[j].high + 1e-3 && other[j].low <= box[j].high + 1e-3;
            if (!touching) {
                ++k;
                continue;
            }
            for (std::size_t j = 0; j < box.size(); ++j)
                box[j] = {std::min(box[j].low, other[j].low), std::max(box[j].high, other[j].high)};
            out.unresolved.erase(out.unresolved.begin() + static_cast<std::ptrdiff_t>(k));
            k = 0;
        }
        out.unresolved.push_back(std::move(box));
    }

    void place(std::size_t joint, const Box& box) {
        const Joint& moved = loop_.joints[joint];
        const Span& span = box[moved.q];
        const double a = moved.multiplier * span.low, b = moved.multiplier * span.high;
        const Span here{std::min(a, b), std::max(a, b)};
        if (moved.slides) {
            cosines_[joint] = {here.middle(), here.half() + rounding};
            sines_[joint] = {};
        } else if (here.high - here.low >= 2.0 * pi) {
            cosines_[joint] = sines_[joint] = {0.0, 1.0};
        } else {
            cosines_and_sines(here, cosines_[joint], sines_[joint]);
        }
    }

    using Parts = std::array<std::array<Ball, 3>, Polynomial::most_joints>;

    // The value of a polynomial over the box; ``parts``: for each of its joints what 1, cosine and sine are multiplied with.
    Ball parts_of(const Polynomial& polynomial, Parts& parts) const {
        const std::size_t count = polynomial.joints.size();
        const double* given = polynomial.coefficients.data();
        if (count == 0) return {given[0], 0.0};
        Ball rest[largest_side / 3];
        std::size_t size = 1;
        std::array<std::size_t, Polynomial::most_joints> begins{};
        Ball front[1 + 3 + 9 + 27];
        front[0] = {1.0, 0.0};
        for (std::size_t j = 0, begin = 0; j < count; ++j) {
            begins[j] = begin;
            if (j + 1 == count) break;
            const Ball c = cosines_[polynomial.joints[j]], s = sines_[polynomial.joints[j]];
            for (std::size_t k = 0; k < size; ++k) {
                Ball* to = front + begin + size + 3 * k;
                to[0] = front[begin + k], to[1] = front[begin + k] * c, to[2] = front[begin + k] * s;
            }
            begin += size;
            size *= 3;
        }
        for (std::size_t j = count; j-- > 0;) {
            const Ball c = cosines_[polynomial.joints[j]], s = sines_[polynomial.joints[j]];
            const Ball* before = front + begins[j];
            std::array<Ball, 3> sums{};
            for (std::size_t k = 0; k < size; ++k) {
                if (j + 1 == count) {
                    const double* x = given + 3 * k;
                    for (std::size_t i = 0; i < 3; ++i) sums[i] = sums[i] + before[k] * x[i];
                    rest[k] = Ball{x[0], 0.0} + c * x[1] + s * x[2];
                } else {
                    const Ball x[3] = {rest[3 * k], rest[3 * k + 1], rest[3 * k + 2]};
                    for (std::size_t i = 0; i < 3; ++i) sums[i] = sums[i] + before[k] * x[i];
                    rest[k] = x[0] + c * x[1] + s * x[2];
                }
            }
            parts[j] = sums;
            size /= 3;
        }
        return rest[0];
    }

    // Keeps the part of the box that one equation allows for one joint: a c + b s + rest = 0. False if that is nothing.
    static bool project(const Joint& joint, const std::array<Ball, 3>& part, Ball rest, Ball cosine, Ball sine, Span& span, Gap& gap) {
        const Ball a = part[1], b = part[2];
        if (joint.slides) {
            if (std::fabs(a.mid) <= a.rad * (1.0 + 1e-9)) return std::fabs(rest.mid) <= rest.rad + largest(a) * largest(cosine);
            const double half = (rest.rad + a.rad * largest(cosine)) / std::fabs(a.mid) + rounding;
            const double middle = -rest.mid / a.mid, by = joint.multiplier;
            const Span allowed{std::min((middle - half) / by, (middle + half) / by), std::max((middle - half) / by, (middle + half) / by)};
            span = {std::max(span.low, allowed.low), std::min(span.high, allowed.high)};
            return span.low <= span.high;
        }
        const double rho = std::sqrt(a.mid * a.mid + b.mid * b.mid);
        const double room = rest.rad + a.rad * largest(cosine) + b.rad * largest(sine);
        if (!(rho > 1e-9)) return std::fabs(rest.mid) <= room + 2.0 * rho;
        const double low = (-rest.mid - room) / rho - angle_error, high = (-rest.mid + room) / rho + angle_error;
        if (low > 1.0 || high < -1.0) return false;
        if (low <= -1.0 && high >= 1.0) return true;
        const double nearest = high >= 1.0 ? 0.0 : angle_with_cosine(high), farthest = low <= -1.0 ? pi : angle_with_cosine(low);
        const double middle = angle_of(b.mid, a.mid), by = joint.multiplier;
        // The joint's angle is in middle ± [nearest, farthest], up to whole turns.
        const double x = by * span.low, y = by * span.high;
        const Span angles{std::min(x, y), std::max(x, y)};
        const double error = 4.0 * angle_error;
        double first = 1e300, last = -1e300, hole = 0.0;
        Span found{};
        const double turns = std::ceil((angles.low - middle - farthest - error) / (2.0 * pi) - 1e-9);
        for (double k = turns; middle + 2.0 * pi * k - farthest - error <= angles.high; k += 1.0) {
            const double at = middle + 2.0 * pi * k;
            for (const Span arc : {Span{at - farthest - error, at - nearest + error}, Span{at + nearest - error, at + farthest + error}}) {
                const Span piece{std::max(arc.low, angles.low), std::min(arc.high, angles.high)};
                if (piece.low > piece.high) continue;
                if (last > -1e300 && piece.low - last > hole) hole = piece.low - last, found = {last, piece.low};
                first = std::min(first, piece.low), last = std::max(last, piece.high);
            }
        }
        if (first > last) return false;
        const Span now{std::min(first / by, last / by), std::max(first / by, last / by)};
        if (first > angles.low) (by > 0.0 ? span.low : span.high) = by > 0.0 ? now.low : now.high;
        if (last < angles.high) (by > 0.0 ? span.high : span.low) = by > 0.0 ? now.high : now.low;
        if (hole > 0.0) {
            const Span at{std::min(found.low / by, found.high / by), std::max(found.low / by, found.high / by)};
            if (at.high - at.low > gap.hole.high - gap.hole.low) gap = {joint.q, at};
        }
        return true;
    }

    // Asks each equation about each of its joints until little changes. False if the box holds no solution.
    bool contract(Box& box, Gap& gap) {
        unsigned changed = ~0U;
        for (std::size_t j = 0; j < loop_.joints.size(); ++j) place(j, box);
        for (int round = 0; round < 3 && changed != 0; ++round) {
            unsigned moved = 0;
            for (const Equation& equation : equations_) {
                if ((equation.joints & (changed | moved)) == 0) continue;
                Parts parts[2];
                const Ball values[2] = {parts_of(equation.sides[0], parts[0]), parts_of(equation.sides[1], parts[1])};
                const Ball total = values[0] + values[1];
                const std::size_t number = static_cast<std::size_t>(&equation - equations_.data());
                if (std::fabs(total.mid) > total.rad + equation.slack) {
                    note(Step::NONE, static_cast<double>(number), 0.0);
                    return false;
                }
                for (std::size_t side = 0; side < 2; ++side)
                    for (std::size_t j = 0; j < equation.sides[side].joints.size(); ++j) {
                        const std::size_t joint = equation.sides[side].joints[j];
                        Span& span = box[loop_.joints[joint].q];
                        const double before = span.high - span.low;
                        const Ball rest = parts[side][j][0] + values[1 - side] + Ball{0.0, equation.slack};
                        const Span old = span;
                        const Span hole = gap.hole;
                        if (!project(loop_.joints[joint], parts[side][j], rest, cosines_[joint], sines_[joint], span, gap)) {
                            span = old;
                            note(Step::NONE_OF, static_cast<double>(number), static_cast<double>(joint));
                            return false;
                        }
                        if (gap.hole.low != hole.low || gap.hole.high != hole.high) gap.equation = number, gap.index = joint;
                        if (span.low != old.low || span.high != old.high)
                            note(Step::CUT, static_cast<double>(number), static_cast<double>(joint), span);
                        const double now = span.high - span.low;
                        if (now < 0.99 * before)
                            for (std::size_t k = 0; k < loop_.joints.size(); ++k)
                                if (loop_.joints[k].q == loop_.joints[joint].q) place(k, box);
                        if (now < 0.6 * before && before > 1e-9) moved |= 1U << loop_.joints[joint].q;
                    }
            }
            changed = moved;
        }
        if (gap.joint < most) {  // what became of the hole
            Span& hole = gap.hole;
            const Span& span = box[gap.joint];
            if (hole.low <= span.low || hole.high >= span.high || hole.high - hole.low < 0.1 * (span.high - span.low)) gap.joint = most;
        }
        return true;
    }

    // Derivatives over the box, then Newton's method with them. False if all of the box is dealt with.
    bool narrow(Box& box, Complete& out) {
        const std::size_t n = box.size();
        for (int round = 0; round < 6; ++round) {
            if (known(box, out)) return false;
            const double before = widest(box);
            if (n == proof_.rows() + 1 && before < arc_width) {
                std::vector<double> q(n);
                for (std::size_t j = 0; j < n; ++j) q[j] = box[j].middle();
                std::optional<Arc> found = proof_.arc(q, std::max(2.0 * before, 0.05));
                if (found && inside(box, *found)) {
                    out.arcs.push_back(std::move(*found));
                    if (known(box, out)) return false;
                }
            }
            if (n <= proof_.rows() && before < lone_width) {
                std::vector<double> q(n);
                for (std::size_t j = 0; j < n; ++j) q[j] = box[j].middle();
                std::optional<Solution> found = proof_.from(q, std::max(2.0 * before, 0.05));
                if (found && !lone(found->box, out)) {
                    out.solutions.push_back(std::move(*found));
                    if (known(box, out)) return false;
                }
            }
            if (!linearised(box)) return false;
            if (widest(box) > 0.7 * before) return true;
        }
        return true;
    }

    static double value_at(const Polynomial& polynomial, const double* cosine, const double* sine) {
        const std::size_t count = polynomial.joints.size();
        std::size_t size = polynomial.coefficients.size() / 3;
        if (count == 0) return polynomial.coefficients[0];
        double rest[largest_side / 3];
        const double* from = polynomial.coefficients.data();
        for (std::size_t j = count; j-- > 0; size /= 3, from = rest) {
            const double c = cosine[polynomial.joints[j]], s = sine[polynomial.joints[j]];
            for (std::size_t k = 0; k < size; ++k) rest[k] = from[3 * k] + from[3 * k + 1] * c + from[3 * k + 2] * s;
        }
        return rest[0];
    }

    // The mean value theorem for n equations, multiplied with an inverse of the derivatives. False if no solution is left.
    bool linearised(Box& box) {
        const std::size_t n = box.size(), m = loop_.joints.size();
        double middle[most], half[most], cosine[16], sine[16];
        for (std::size_t j = 0; j < n; ++j) middle[j] = box[j].middle(), half[j] = 1.000001 * std::max(box[j].high - middle[j], middle[j] - box[j].low);
        for (std::size_t k = 0; k < m; ++k) {
            const double x = loop_.joints[k].multiplier * middle[loop_.joints[k].q];
            place(k, box);
            if (loop_.joints[k].slides) {
                cosine[k] = x, sine[k] = 0.0;
            } else {
                arithmetic::cosine_and_sine(x, cosine[k], sine[k]);
            }
        }
        const std::size_t rows = equations_.size() + proof_.rows();
        slopes_.assign(rows, {});
        values_.resize(rows);
        scaled_.resize(rows);
        note(Step::MARKED, 0.0, 0.0);
        if (!proof_.enclose(middle, half, values_.data() + equations_.size(), slopes_.data() + equations_.size())) {
            note(Step::TURNED, 0.0, 0.0);
            return false;
        }
        for (std::size_t e = 0; e < equations_.size(); ++e) {
            const Equation& equation = equations_[e];
            std::array<Ball, most>& slope = slopes_[e];
            double value = 0.0;
            for (const Polynomial& side : equation.sides) {
                Parts parts;
                parts_of(side, parts);
                value += value_at(side, cosine, sine);
                for (std::size_t j = 0; j < side.joints.size(); ++j) {
                    const std::size_t k = side.joints[j];
                    const Joint& joint = loop_.joints[k];
                    const Ball by = joint.slides ? parts[j][1] : parts[j][2] * cosines_[k] + parts[j][1] * sines_[k] * -1.0;
                    slope[joint.q] = slope[joint.q] + (by + Ball{0.0, equation.rounding}) * joint.multiplier;
                }
            }
            values_[e] = {value, equation.slack};
        }
        for (std::size_t e = 0; e < rows; ++e) {
            const std::array<Ball, most>& slope = slopes_[e];
            double curved = values_[e].rad, linear = 0.0;
            for (std::size_t j = 0; j < n; ++j) curved += slope[j].rad * half[j], linear += largest(slope[j]) * half[j];
            if (std::fabs(values_[e].mid) > linear + values_[e].rad) {
                const double one = 1.0;
                note(Step::SUM_NONE, sum_of(&e, &one, 1), -1.0);
                return false;
            }
            for (std::size_t j = 0; j < n; ++j) scaled_[e][j] = slope[j].mid * half[j] / curved;
        }
        // Equations that are steep for how much they curve, one for each joint that they still tell something about.
        std::array<std::size_t, most> chosen{}, columns{};
        unsigned used = 0;
        std::size_t count = 0;
        for (; count < n; ++count) {
            std::size_t row = 0, column = 0;
            double best = 1e-3;
            for (std::size_t e = 0; e < rows; ++e)
                for (std::size_t j = 0; j < n; ++j)
                    if (((used >> j) & 1) == 0 && std::fabs(scaled_[e][j]) > best) best = std::fabs(scaled_[e][j]), row = e, column = j;
            if (best == 1e-3) break;
            chosen[count] = row, columns[count] = column;
            used |= 1U << column;
            const std::array<double, most> pivot = scaled_[row];
            for (auto& other : scaled_) {
                const double factor = other[column] / pivot[column];
                if (factor != 0.0)
                    for (std::size_t j = 0; j < n; ++j) other[j] -= factor * pivot[j];
            }
        }
        Matrix A{}, Y;
        for (std::size_t i = 0; i < count; ++i)
            for (std::size_t j = 0; j < count; ++j) A[i][j] = slopes_[chosen[i]][columns[j]].mid;
        if (!invert(A, count, Y)) return true;
        for (std::size_t v = 0; v < count; ++v) {
            double move = 0.0, spread = 0.0;
            for (std::size_t i = 0; i < count; ++i) {
                const Ball value = values_[chosen[i]];
                move -= Y[v][i] * value.mid;
                spread += std::fabs(Y[v][i]) * (value.rad + rounding * std::fabs(value.mid));
            }
            for (std::size_t w = 0; w < n; ++w) {
                double mid = w == columns[v] ? -1.0 : 0.0, rad = 0.0, size = 1.0;
                for (std::size_t i = 0; i < count; ++i) {
                    const Ball slope = slopes_[chosen[i]][w];
                    mid += Y[v][i] * slope.mid, rad += std::fabs(Y[v][i]) * slope.rad, size += std::fabs(Y[v][i] * slope.mid);
                }
                spread += (std::fabs(mid) + rad + rounding * size) * half[w];
            }
            Span& span = box[columns[v]];
            const double end = middle[columns[v]] + move;
            spread += 1e-14 * (1.0 + std::fabs(end));
            const Span old = span;
            span = {std::max(span.low, end - spread), std::min(span.high, end + spread)};
            if (span.low > span.high) {
                note(Step::SUM_NONE, sum_of(chosen.data(), Y[v].data(), count), static_cast<double>(columns[v]));
                return false;
            }
            if (span.low != old.low || span.high != old.high)
                note(Step::SUM_CUT, sum_of(chosen.data(), Y[v].data(), count), static_cast<double>(columns[v]), span);
        }
        return true;
    }

    std::vector<Ball> values_;
    std::vector<std::array<double, most>> scaled_;

    // In a hole if there is one; else across the joint that bends the equations most (Trombettoni, Araya and others, 2011).
    void split(const Box& box, const Gap& gap, std::vector<Box>& stack) {
        const std::size_t n = box.size();
        std::size_t joint = 0;
        Span hole;
        double shown = -1.0;
        if (gap.joint < most && gap.hole.low > box[gap.joint].low && gap.hole.high < box[gap.joint].high) {
            joint = gap.joint;
            hole = gap.hole;
            shown = static_cast<double>(gap.equation);
        } else {
            std::array<double, most> share{};
            for (const auto& slope : slopes_) {
                double sum = 1e-300;
                for (std::size_t j = 0; j < n; ++j) sum += largest(slope[j]) * box[j].half();
                for (std::size_t j = 0; j < n; ++j) share[j] += largest(slope[j]) * box[j].half() / sum;
            }
            joint = static_cast<std::size_t>(std::max_element(share.begin(), share.begin() + static_cast<std::ptrdiff_t>(n)) - share.begin());
            hole = {box[joint].middle(), box[joint].middle()};
        }
        note(Step::SPLIT, shown, static_cast<double>(joint), hole, static_cast<double>(gap.index));
        Box lower = box, upper = box;
        lower[joint].high = hole.low;
        upper[joint].low = hole.high;
        stack.push_back(std::move(upper));
        stack.push_back(std::move(lower));
    }
};

}  // namespace

Complete solve_complete(const Loop& loop, const Target& target, const Box& domain, int most_boxes, Trail* trail) {
    return Search(loop, target, domain, trail).run(most_boxes);
}

std::optional<std::vector<double>> reached_in(const Loop& loop, const Target& target, const Box& domain, const Box& box) {
    return Search(loop, target, domain, nullptr).reached_in(box);
}

Cover cover(const Loop& loop, const Target& target, const Box& domain, const std::vector<Box>& from, const Obstruction* obstruction,
            const CoverLimits& limits) {
    return Search(loop, target, domain, nullptr).cover(from, obstruction, limits);
}

}  // namespace kinematics
