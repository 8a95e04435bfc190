#include "loop.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace kinematics {

namespace {

constexpr std::size_t most_joints = 5, most_equations = 32;  // of an equation; of a loop

constexpr double negligible = 1e-14;  // a coefficient below this goes into the slack
constexpr double rounding = 1e-12;    // bounds what rounding adds, as a share of the sum of all coefficients (Lemma 3)

Vector operator+(const Vector& a, const Vector& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
Vector operator-(const Vector& a, const Vector& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Vector operator*(const Vector& a, double x) { return {a[0] * x, a[1] * x, a[2] * x}; }
double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
double norm(const Vector& a) { return std::sqrt(dot(a, a)); }
Vector cross(const Vector& a, const Vector& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

Vector perpendicular(const Vector& a) {
    const std::size_t k = static_cast<std::size_t>(
        std::min_element(a.begin(), a.end(), [](double x, double y) { return std::fabs(x) < std::fabs(y); }) - a.begin());
    Vector unit{};
    unit[k] = 1.0;
    const Vector out = cross(a, unit);
    return out * (1.0 / norm(out));
}

Vector turned(const double* rows, const Vector& v) {
    Vector out;
    for (std::size_t i = 0; i < 3; ++i) out[i] = rows[4 * i] * v[0] + rows[4 * i + 1] * v[1] + rows[4 * i + 2] * v[2];
    return out;
}

Vector turned_back(const double* rows, const Vector& v) {
    Vector out;
    for (std::size_t i = 0; i < 3; ++i) out[i] = rows[i] * v[0] + rows[4 + i] * v[1] + rows[8 + i] * v[2];
    return out;
}

Vector offset(const double* rows) { return {rows[3], rows[7], rows[11]}; }

// A vector, or a number, times one number of each joint; two bits of the key for each joint: 0, 1 or 2 for 1, cosine, sine.
template <class Value>
struct Term {
    std::uint64_t key;
    Value value;
};
using Vectors = std::vector<Term<Vector>>;
using Numbers = std::vector<Term<double>>;

std::size_t count_of(std::uint64_t used) {
    std::size_t count = 0;
    for (used = (used | (used >> 1)) & 0x5555555555555555U; used != 0; used &= used - 1) ++count;
    return count;
}

double size_of(double x) { return std::fabs(x); }
double size_of(const Vector& v) { return norm(v); }

// How many joints stand in terms that count.
template <class Value>
std::size_t joints_of(const std::vector<Term<Value>>& terms) {
    std::uint64_t used = 0;
    for (const auto& [key, value] : terms)
        if (size_of(value) > 100.0 * negligible) used |= key;
    return count_of(used);
}

// A point or direction as seen from a cut of the chain; for a point the sum begins with the term of key 0.
struct Seen {
    Vectors terms;
    bool point;
    double lost = 0.0;  // bounds the terms that were left out
    bool open = true;   // not yet through so many joints that no equation comes of it

    void move(const Joint& joint, std::size_t index, double sign) {
        open = open && joints_of(terms) <= Polynomial::most_joints;
        if (!open) return;
        Vectors out;
        const auto add = [&](std::uint64_t key, const Vector& v, bool keep) {
            const double size = norm(v);
            if (keep || size > negligible) {
                out.push_back({key, v});
            } else {
                lost += size;
            }
        };
        const std::uint64_t one = std::uint64_t{1} << (2 * index);
        if (joint.slides) {
            if (point) terms.push_back({one, joint.axis * sign});
            return;
        }
        if (point) terms[0].value = terms[0].value - joint.point;
        for (const auto& [key, v] : terms) {
            const Vector along = joint.axis * dot(joint.axis, v);
            add(key, along, key == 0);
            add(key + one, v - along, false);
            add(key + 2 * one, cross(joint.axis, v) * sign, false);
        }
        if (point) out[0].value = out[0].value + joint.point;
        terms = std::move(out);
    }

    Numbers along(const Vector& v, double factor = 1.0) const {
        Numbers out;
        for (const auto& [key, value] : terms) out.push_back({key, factor * dot(v, value)});
        return out;
    }
};

void append(Numbers& to, const Numbers& from) { to.insert(to.end(), from.begin(), from.end()); }

// What is known of the tool in the base frame, or of the base in the tool's: where it is, and how well.
struct Pair {
    Vector given, own;  // the left and the right side of the loop at its ends
    bool point;
    double error;
    bool still = false;  // whether it does not move with the tool
};

class Writer {
  public:
    explicit Writer(const Loop& loop) : loop_(loop) {}

    // left = right, up to ``slack``.
    void write(const Origin& origin, const Numbers& left, const Numbers& right, double slack) {
        if (joints_of(left) + joints_of(right) > most_joints) return;
        Equation out;
        out.origin = origin;
        out.slack = slack;
        std::size_t count = 0;
        double sum = 0.0, constant = 0.0;
        for (int side = 0; side < 2; ++side) {
            Numbers terms = side == 0 ? left : right;
            std::sort(terms.begin(), terms.end(), [](const auto& a, const auto& b) { return a.key < b.key; });
            std::size_t kept = 0;
            std::uint64_t used = 0;
            for (std::size_t k = 0; k < terms.size();) {
                Term<double> total{terms[k].key, 0.0};
                for (; k < terms.size() && terms[k].key == total.key; ++k) total.value += side == 0 ? terms[k].value : -terms[k].value;
                if (total.key == 0) {
                    constant += total.value;
                } else if (std::fabs(total.value) > 100.0 * negligible) {
                    sum += std::fabs(total.value);
                    used |= total.key | (total.key >> 1);
                    terms[kept++] = total;
                } else {
                    out.slack += std::fabs(total.value) * (1.0 + loop_.longest);
                }
            }
            terms.resize(kept);
            Polynomial& polynomial = out.sides[side];
            for (std::size_t j = 0; j < loop_.joints.size(); ++j)
                if (((used >> (2 * j)) & 1) != 0) polynomial.joints.push_back(j);
            count += polynomial.joints.size();
            if (polynomial.joints.size() > Polynomial::most_joints || count > most_joints) return;
            std::size_t size = 1;
            for (std::size_t j = 0; j < polynomial.joints.size(); ++j) size *= 3;
            polynomial.coefficients.assign(size, 0.0);
            for (const auto& [key, value] : terms) {
                std::size_t place = 0;
                for (const std::size_t j : polynomial.joints) place = 3 * place + ((key >> (2 * j)) & 3);
                polynomial.coefficients[place] = value;
            }
            for (const std::size_t j : polynomial.joints) out.joints |= 1U << loop_.joints[j].q;
        }
        if (count == 0 && std::fabs(constant) <= out.slack + rounding) return;
        out.sides[0].coefficients[0] = constant;
        out.rounding = rounding * (1.0 + sum + std::fabs(constant)) * (1.0 + loop_.longest);
        out.slack += out.rounding;
        for (const Equation& other : found_)
            if (same(other, out)) return;
        found_.push_back(std::move(out));
    }

    std::vector<Equation> fewest_joints_first() {
        std::stable_sort(found_.begin(), found_.end(), [](const Equation& a, const Equation& b) {
            return a.sides[0].joints.size() + a.sides[1].joints.size() < b.sides[0].joints.size() + b.sides[1].joints.size();
        });
        if (found_.size() > most_equations) found_.resize(most_equations);
        return std::move(found_);
    }

  private:
    const Loop& loop_;
    std::vector<Equation> found_;

    // Whether one is a multiple of the other, and says no more.
    static bool same(const Equation& a, const Equation& b) {
        if (a.sides[0].joints != b.sides[0].joints || a.sides[1].joints != b.sides[1].joints) return false;
        double ab = 0.0, aa = 0.0, bb = 0.0;
        for (int side = 0; side < 2; ++side)
            for (std::size_t k = 0; k < a.sides[side].coefficients.size(); ++k) {
                const double x = a.sides[side].coefficients[k], y = b.sides[side].coefficients[k];
                ab += x * y, aa += x * x, bb += y * y;
            }
        return ab * ab > (1.0 - 1e-14) * aa * bb && a.slack * std::sqrt(bb) <= 1.01 * b.slack * std::sqrt(aa);
    }
};

std::vector<Pair> pairs_of(const Loop& loop, const Target& target) {
    const Joint &first = loop.joints.front(), &last = loop.joints.back();
    const Vector home = offset(loop.tool), there = offset(target.rows);
    const auto moved = [&](const Vector& v) { return turned(target.rows, turned_back(loop.tool, v)); };
    const auto moved_back = [&](const Vector& v) { return turned(loop.tool, turned_back(target.rows, v)); };
    const auto point = [&](const Vector& x) {
        return Pair{there + moved(x - home), x, true, target.position_error + norm(x - home) * target.turn_error};
    };
    const auto direction = [&](const Vector& d) { return Pair{moved(d), d, false, target.turn_error}; };
    if (target.wanted == Wanted::POSITION) return {point(home)};
    if (target.wanted == Wanted::AXIS) {
        return {{there, home, true, target.position_error},
                {turned(target.rows, target.axis), turned(loop.tool, target.axis), false, target.turn_error}};
    }
    const auto point_back = [&](const Vector& x) {
        return Pair{x, home + moved_back(x - there), true, target.position_error + norm(x - there) * target.turn_error, true};
    };
    const auto direction_back = [&](const Vector& d) { return Pair{d, moved_back(d), false, target.turn_error, true}; };
    const Vector end = last.slides ? home : last.point;
    return {point(end), direction(last.axis), direction(perpendicular(last.axis)),
            point_back(first.point), direction_back(first.axis), direction_back(perpendicular(first.axis))};
}

// Components and, of arms that only turn, products of a pair's point and direction, at each cut.
void write_pair(const Loop& loop, std::size_t index, const Pair& at, const Pair* towards, Writer& writer) {
    const std::size_t m = loop.joints.size();
    const bool turns = std::none_of(loop.joints.begin(), loop.joints.end(), [](const Joint& j) { return j.slides; });
    const auto seen = [&](const Pair& pair) {
        std::array<std::vector<Seen>, 2> out;
        out[0].push_back({{{0, pair.given}}, pair.point});
        for (std::size_t k = 0; k < m; ++k) {
            out[0].push_back(out[0].back());
            out[0].back().move(loop.joints[k], k, -1.0);
        }
        out[1].push_back({{{0, pair.own}}, pair.point});
        for (std::size_t k = m; k-- > 0;) {
            out[1].push_back(out[1].back());
            out[1].back().move(loop.joints[k], k, 1.0);
        }
        std::reverse(out[1].begin(), out[1].end());
        return out;
    };
    const auto points = seen(at);
    for (std::size_t k = 0; k <= m; ++k) {
        const Seen &left = points[0][k], &right = points[1][k];
        const double slack = at.error + left.lost + right.lost;
        const Vector axis = loop.joints[k == 0 ? 0 : k - 1].axis, next = loop.joints[k == m ? m - 1 : k].axis;
        Vector across = next - axis * dot(axis, next);
        const double size = norm(across);
        across = size > 1e-6 ? across * (1.0 / size) : perpendicular(axis);
        std::vector<Vector> along{axis, across, cross(axis, across)};
        if (size > 1e-6 && size < 1.0 - 1e-12) along.push_back(next);
        if (!left.open || !right.open) continue;
        for (const Vector& v : along) writer.write({index, k, Kind::COMPONENT, v}, left.along(v), right.along(v), slack);
    }
    if (towards == nullptr || !turns) return;
    const auto directions = seen(*towards);
    const auto apart = [&](std::size_t k) { return loop.joints[k].point - loop.joints[k + 1].point; };
    // Square of the distance from a point on the axis of joint k + 1, and the product of direction and distance.
    const auto square = [&](const Vector& p, const Vector& o) { return Numbers{{0, dot(p - o, p - o)}}; };
    const auto product = [&](const Vector& p, const Vector& d, const Vector& o) { return Numbers{{0, dot(p - o, d)}}; };
    std::vector<Numbers> squares(m), products(m);
    squares[m - 1] = square(at.own, loop.joints[m - 1].point);
    products[m - 1] = product(at.own, towards->own, loop.joints[m - 1].point);
    std::size_t first = m - 1;  // cut whose right side is known
    for (; first > 0 && points[1][first].open && directions[1][first].open; --first) {
        const std::size_t k = first - 1;
        const Vector step = apart(k) * -1.0;
        squares[k] = squares[k + 1];
        append(squares[k], points[1][k + 1].along(step, 2.0));
        append(squares[k], {{0, dot(step, step) - 2.0 * dot(step, loop.joints[k + 1].point)}});
        products[k] = products[k + 1];
        append(products[k], directions[1][k + 1].along(step));
    }
    Numbers left_square = square(at.given, loop.joints[0].point);
    Numbers left_product = product(at.given, towards->given, loop.joints[0].point);
    const double far = norm(at.given - loop.joints[0].point) + at.error;
    double square_slack = (2.0 * far + at.error) * at.error;
    double product_slack = at.error * (1.0 + towards->error) + far * towards->error;
    for (std::size_t k = 0;; ++k) {
        const double lost = 2.0 * loop.longest;
        if (k >= first) {
            writer.write({index, k, Kind::SQUARE, {}}, left_square, squares[k], square_slack + lost * (points[0][k].lost + points[1][k].lost));
            writer.write({index, k, Kind::PRODUCT, {}}, left_product, products[k], product_slack + lost * (directions[0][k].lost + directions[1][k].lost));
        }
        if (k + 1 == m || !points[0][k + 1].open || !directions[0][k + 1].open) return;
        const Vector step = apart(k);
        append(left_square, points[0][k + 1].along(step, 2.0));
        append(left_square, {{0, dot(step, step) - 2.0 * dot(step, loop.joints[k].point)}});
        append(left_product, directions[0][k + 1].along(step));
        square_slack += 2.0 * norm(step) * at.error;
        product_slack += norm(step) * towards->error;
    }
}

}  // namespace

std::vector<Equation> equations_of(const Loop& loop, const Target& target) {
    Writer writer(loop);
    const std::vector<Pair> pairs = pairs_of(loop, target);
    for (std::size_t k = 0; k < pairs.size(); ++k)
        write_pair(loop, k, pairs[k], pairs[k].point && k + 1 < pairs.size() ? &pairs[k + 1] : nullptr, writer);
    return writer.fewest_joints_first();
}

std::vector<Followed> followed_by(const Loop& loop, const Target& target) {
    std::vector<Followed> out;
    for (const Pair& pair : pairs_of(loop, target)) out.push_back({pair.still, pair.point, pair.still ? pair.given : pair.own});
    return out;
}

}  // namespace kinematics
