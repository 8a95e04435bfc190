#include "distance.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace collision {

namespace {

using Point = std::array<double, 3>;

double dot(const Point& a, const Point& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Point minus(const Point& a, const Point& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Point plus(const Point& a, double s, const Point& b) { return {a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]}; }
Point cross(const Point& a, const Point& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

struct Pose {
    double R[9];  // row by row
    Point t;
};

Point turned(const double* R, const Point& x) {
    return {R[0] * x[0] + R[1] * x[1] + R[2] * x[2], R[3] * x[0] + R[4] * x[1] + R[5] * x[2],
            R[6] * x[0] + R[7] * x[1] + R[8] * x[2]};
}

void product(const double* a, const double* b, double* out) {
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) out[3 * i + k] = a[3 * i] * b[k] + a[3 * i + 1] * b[3 + k] + a[3 * i + 2] * b[6 + k];
}

Point point_of(const double* x) { return {x[0], x[1], x[2]}; }

// Sine and cosine in the steps of check.inc: the library's have other last bits on processors without fused multiply-adds.
void sine_and_cosine(double x, double& sine, double& cosine) {
    const double quarters = std::floor(x * 0.63661977236758134308 + 0.5);
    const double r = (x - quarters * 1.57079632673412561417) - quarters * 6.07710050650619224932e-11, u = r * r;
    static constexpr double odd[] = {-1307674368000.0, 6227020800.0, -39916800.0, 362880.0, -5040.0, 120.0, -6.0};
    static constexpr double even[] = {20922789888000.0, -87178291200.0, 479001600.0, -3628800.0,
                                      40320.0,          -720.0,         24.0,        -2.0};
    double s = 0.0, c = 0.0;
    for (const double factorial : odd) s = s * u + 1.0 / factorial;
    for (const double factorial : even) c = c * u + 1.0 / factorial;
    s = r + r * u * s;
    c = c * u + 1.0;
    const auto turns = static_cast<std::int64_t>(quarters) & 3;
    sine = (turns & 1) != 0 ? c : s;
    cosine = (turns & 1) != 0 ? s : c;
    if ((turns & 2) != 0) sine = -sine;
    if (((turns + 1) & 2) != 0) cosine = -cosine;
}

// Rodrigues' formula.
void rotation(const double* axis, double angle, double* out) {
    double s, c;
    sine_and_cosine(angle, s, c);
    const double rest = 1.0 - c, x = axis[0], y = axis[1], z = axis[2];
    const double R[9] = {rest * (x * x) + c,     rest * (x * y) - s * z, rest * (x * z) + s * y,
                         rest * (x * y) + s * z, rest * (y * y) + c,     rest * (y * z) - s * x,
                         rest * (x * z) - s * y, rest * (y * z) + s * x, rest * (z * z) + c};
    std::copy(R, R + 9, out);
}

void place_bodies(const Model& model, const double* q, std::vector<Pose>& bodies) {
    bodies[0] = Pose{{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}};
    for (std::size_t k = 0; k < model.joints.size(); ++k) {
        const Joint& joint = model.joints[k];
        const Pose& parent = bodies[static_cast<std::size_t>(joint.parent)];
        Pose& here = bodies[k + 1];
        const double way = q[joint.q_index] * joint.multiplier;
        double fixed[9], turn[9];
        product(parent.R, joint.rotation, fixed);
        here.t = plus(parent.t, 1.0, turned(parent.R, point_of(joint.offset)));
        if (joint.motion == Motion::slide) {
            std::copy(fixed, fixed + 9, here.R);
            here.t = plus(here.t, way, turned(fixed, point_of(joint.axis)));
        } else {
            rotation(joint.axis, way, turn);
            product(fixed, turn, here.R);
        }
    }
}

// A convex piece in the world.
struct Placed {
    const Solid* solid;
    const double* corners;  // of a hull
    std::size_t count;
    Pose pose;
    Point low, high;  // the box around it along the world's axes

    // A point of it without its ball, farthest along d.
    Point farthest(const Point& d) const {
        const double* R = pose.R;
        const Point l = {R[0] * d[0] + R[3] * d[1] + R[6] * d[2], R[1] * d[0] + R[4] * d[1] + R[7] * d[2],
                         R[2] * d[0] + R[5] * d[1] + R[8] * d[2]};
        Point c;
        if (corners != nullptr) {
            std::size_t best = 0;
            double height = -1e300;
            for (std::size_t i = 0; i < count; ++i) {
                const double h = corners[i] * l[0] + corners[count + i] * l[1] + corners[2 * count + i] * l[2];
                if (h > height) {
                    height = h;
                    best = i;
                }
            }
            c = {corners[best], corners[count + best], corners[2 * count + best]};
        } else {
            for (std::size_t k = 0; k < 3; ++k) c[k] = l[k] < 0.0 ? -solid->half[k] : solid->half[k];
            if (solid->disc > 0.0) {
                const double across = std::sqrt(l[0] * l[0] + l[1] * l[1]);
                if (across > 1e-150) {
                    c[0] += solid->disc * l[0] / across;
                    c[1] += solid->disc * l[1] / across;
                }
            }
        }
        return plus(pose.t, 1.0, turned(R, c));
    }

    void find_box() {
        for (std::size_t k = 0; k < 3; ++k) {
            const double* row = pose.R + 3 * k;
            double reach = solid->ball + solid->disc * std::sqrt(row[0] * row[0] + row[1] * row[1]);
            for (std::size_t j = 0; j < 3; ++j) reach += std::fabs(row[j]) * solid->half[j];
            low[k] = pose.t[k] - reach;
            high[k] = pose.t[k] + reach;
        }
    }
};

// A point w = b - a of the difference of two pieces, and what it comes from.
struct Vertex {
    Point w, a, b;
};

Vertex nearest_along(const Placed& a, const Placed& b, const Point& v) {  // the least v.w
    const Point on_a = a.farthest(v), on_b = b.farthest({-v[0], -v[1], -v[2]});
    return {minus(on_b, on_a), on_a, on_b};
}

// What is found of a pair: unit direction from a to b, distance, and the points between which it is measured.
struct Gap {
    double distance;
    Point n, on_a, on_b;
};

struct Simplex {
    Vertex p[4];
    double share[4];  // of the point nearest to the origin
    int n = 0;
};

// The point of a segment nearest to the origin; shares of its ends.
Point on_segment(const Point& a, const Point& b, double* share) {
    const Point ab = minus(b, a);
    const double length = dot(ab, ab), along = -dot(a, ab);
    const double s = along <= 0.0 || length <= 0.0 ? 0.0 : (along >= length ? 1.0 : along / length);
    share[0] = 1.0 - s;
    share[1] = s;
    return plus(a, s, ab);
}

// Of a triangle, by the regions of its corners, edges and face (Ericson, Real-Time Collision Detection, 2005, 5.1.5).
Point on_triangle(const Point& a, const Point& b, const Point& c, double* share) {
    const Point n = cross(minus(b, a), minus(c, a));
    const double area = dot(n, n);
    const double u = dot(cross(b, c), n), v = dot(cross(c, a), n), w = dot(cross(a, b), n);
    if (area > 0.0 && u >= 0.0 && v >= 0.0 && w >= 0.0) {
        const double sum = u + v + w;
        share[0] = u / sum;
        share[1] = v / sum;
        share[2] = w / sum;
        const double height = dot(a, n) / area;
        return {height * n[0], height * n[1], height * n[2]};
    }
    const Point* corner[3] = {&a, &b, &c};
    Point best{};
    double least = 1e300;
    for (int k = 0; k < 3; ++k) {
        double ends[2];
        const int next = (k + 1) % 3;
        const Point x = on_segment(*corner[k], *corner[next], ends);
        if (dot(x, x) < least) {
            least = dot(x, x);
            best = x;
            share[0] = share[1] = share[2] = 0.0;
            share[k] = ends[0];
            share[next] = ends[1];
        }
    }
    return best;
}

// The point of a tetrahedron nearest to the origin; false if that is inside.
bool on_tetrahedron(const Simplex& s, Point& v, double* share) {
    static constexpr int face[4][4] = {{0, 1, 2, 3}, {0, 1, 3, 2}, {0, 2, 3, 1}, {1, 2, 3, 0}};
    double least = 1e300;
    for (const auto& f : face) {
        const Point &a = s.p[f[0]].w, &b = s.p[f[1]].w, &c = s.p[f[2]].w;
        const Point n = cross(minus(b, a), minus(c, a)), ad = minus(s.p[f[3]].w, a);
        const double of_origin = -dot(a, n), of_corner = dot(ad, n);
        const bool flat = of_corner * of_corner <= 1e-24 * dot(n, n) * dot(ad, ad);
        if (of_origin * of_corner > 0.0 && !flat) continue;
        double part[3];
        const Point x = on_triangle(a, b, c, part);
        if (dot(x, x) < least) {
            least = dot(x, x);
            v = x;
            std::fill(share, share + 4, 0.0);
            for (int k = 0; k < 3; ++k) share[f[k]] = part[k];
        }
    }
    return least < 1e300;
}

// Keeps what the point of the simplex nearest to the origin needs; false if the origin is inside.
bool reduce(Simplex& s, Point& v) {
    double share[4] = {1.0, 0.0, 0.0, 0.0};
    if (s.n == 1)
        v = s.p[0].w;
    else if (s.n == 2)
        v = on_segment(s.p[0].w, s.p[1].w, share);
    else if (s.n == 3)
        v = on_triangle(s.p[0].w, s.p[1].w, s.p[2].w, share);
    else if (!on_tetrahedron(s, v, share))
        return false;
    int kept = 0;
    for (int i = 0; i < s.n; ++i) {
        if (share[i] <= 0.0) continue;
        s.p[kept] = s.p[i];
        s.share[kept++] = share[i];
    }
    s.n = kept;
    return true;
}

Gap measured(const Placed& a, const Placed& b, double distance, const Point& n, const Point& on_a, const Point& on_b) {
    return {distance - a.solid->ball - b.solid->ball, n, plus(on_a, a.solid->ball, n), plus(on_b, -b.solid->ball, n)};
}

Gap along(const Placed& a, const Placed& b, const Point& n) {
    const Vertex found = nearest_along(a, b, n);
    return measured(a, b, dot(found.w, n), n, found.a, found.b);
}

bool unit(Point& v) {
    const double length = std::sqrt(dot(v, v));
    if (!(length > 1e-12)) return false;
    for (auto& x : v) x /= length;
    return true;
}

// The largest separation along the axes of both pieces, their crosses and the line of centres: for two boxes that
// overlap the distance itself.
Gap along_axes(const Placed& a, const Placed& b) {
    std::vector<Point> axes{minus(b.pose.t, a.pose.t)};
    for (int i = 0; i < 3; ++i) {
        const double *A = a.pose.R, *B = b.pose.R;
        const Point u = {A[i], A[3 + i], A[6 + i]};
        axes.push_back(u);
        axes.push_back({B[i], B[3 + i], B[6 + i]});
        for (int k = 0; k < 3; ++k) axes.push_back(cross(u, {B[k], B[3 + k], B[6 + k]}));
    }
    Gap best{-1e300, {1, 0, 0}, a.pose.t, b.pose.t};
    for (Point& axis : axes) {
        if (!unit(axis)) continue;
        for (const double sign : {1.0, -1.0}) {
            const Gap gap = along(a, b, {sign * axis[0], sign * axis[1], sign * axis[2]});
            if (gap.distance > best.distance) best = gap;
        }
    }
    return best;
}

struct Face {
    int i, j, k;
    Point n;
    double height;
};

constexpr double CONVERGED = 1e-8;  // metres between a bound and the distance
constexpr double COPLANAR = 1e-9;
constexpr int STEPS = 64, GROWN = 96;

// The least way out of an overlap: from the tetrahedron that holds the origin the hull is grown where it is nearest
// (van den Bergen, Proximity Queries and Penetration Depth Computation on 3D Game Objects, GDC 2001).
class Expanding {
  public:
    Expanding(const Placed& a, const Placed& b, const Simplex& s) : a_(a), b_(b), vertices_(s.p, s.p + 4) {
        static constexpr int face[4][3] = {{0, 1, 2}, {0, 1, 3}, {0, 2, 3}, {1, 2, 3}};
        for (const auto& f : face) add(f[0], f[1], f[2]);
    }

    // False if rounding got the better of it.
    bool find(Gap& gap) {
        for (int step = 0; step < GROWN && sound_; ++step) {
            const Face nearest = *std::min_element(
                faces_.begin(), faces_.end(), [](const Face& x, const Face& y) { return x.height < y.height; });
            if (nearest.height >= 1e300) return false;
            const Vertex w = nearest_along(a_, b_, {-nearest.n[0], -nearest.n[1], -nearest.n[2]});
            if (dot(w.w, nearest.n) - nearest.height <= CONVERGED || step == GROWN - 1) {
                gap = told(nearest, dot(w.w, nearest.n));
                return true;
            }
            grow(w);
        }
        return false;
    }

  private:
    const Placed &a_, &b_;
    std::vector<Vertex> vertices_;
    std::vector<Face> faces_;
    bool sound_ = true;

    const Point& at(int m) const { return vertices_[static_cast<std::size_t>(m)].w; }

    void add(int i, int j, int k) {
        Face face{i, j, k, cross(minus(at(j), at(i)), minus(at(k), at(i))), 0.0};
        if (!unit(face.n)) {  // a sliver: never the nearest, nor seen from a new corner
            face.n = {0.0, 0.0, 0.0};
            face.height = 1e300;
            faces_.push_back(face);
            return;
        }
        face.height = dot(face.n, at(i));
        if (face.height < 0.0) {
            face.height = -face.height;
            for (auto& x : face.n) x = -x;
        }
        faces_.push_back(face);
    }

    void grow(const Vertex& w) {
        vertices_.push_back(w);
        const int number = static_cast<int>(vertices_.size()) - 1;
        std::vector<std::pair<int, int>> rim;
        const auto edge = [&rim](int i, int j) {
            const auto found = std::find_if(rim.begin(), rim.end(), [i, j](const auto& e) {
                return (e.first == i && e.second == j) || (e.first == j && e.second == i);
            });
            if (found == rim.end())
                rim.emplace_back(i, j);
            else
                rim.erase(found);
        };
        std::vector<Face> left;
        for (const Face& face : faces_) {
            if (dot(face.n, w.w) - face.height <= 0.0) {
                left.push_back(face);
                continue;
            }
            edge(face.i, face.j);
            edge(face.j, face.k);
            edge(face.k, face.i);
        }
        faces_.swap(left);
        if (rim.empty()) sound_ = false;
        for (const auto& [i, j] : rim) add(i, j, number);
    }

    // Of the triangles in one plane with that face the one that the origin is nearest to: the others miss the points
    // between which the depth is measured.
    Gap told(const Face& face, double depth) const {
        double share[3], nearest[3];
        const Face* chosen = nullptr;
        double least = 1e300;
        for (const Face& other : faces_) {
            if (other.height > face.height + COPLANAR || dot(other.n, face.n) < 1.0 - COPLANAR) continue;
            const Point x = on_triangle(at(other.i), at(other.j), at(other.k), nearest);
            if (dot(x, x) < least) {
                least = dot(x, x);
                chosen = &other;
                std::copy(nearest, nearest + 3, share);
            }
        }
        const int corner[3] = {chosen->i, chosen->j, chosen->k};
        Point on_a{}, on_b{};
        bool one_of_a = true, one_of_b = true;  // whether a single point of it touches the plane
        for (int m = 0; m < 3; ++m) {
            const Vertex& vertex = vertices_[static_cast<std::size_t>(corner[m])];
            on_a = plus(on_a, share[m], vertex.a);
            on_b = plus(on_b, share[m], vertex.b);
            one_of_a = one_of_a && vertex.a == vertices_[static_cast<std::size_t>(corner[0])].a;
            one_of_b = one_of_b && vertex.b == vertices_[static_cast<std::size_t>(corner[0])].b;
        }
        if (one_of_b)  // the other touches with a face, of a round one of which not all is known
            on_a = plus(on_b, -depth, face.n);
        else if (one_of_a)
            on_b = plus(on_a, depth, face.n);
        return measured(a_, b_, -depth, {-face.n[0], -face.n[1], -face.n[2]}, on_a, on_b);
    }
};

// Signed distance and nearest points; if it is above ``within`` only a bound that is above it, too. The bound is the
// separation along the direction found: no search that went wrong can make it too large.
Gap gap_of(const Placed& a, const Placed& b, double within) {
    const double limit = within + a.solid->ball + b.solid->ball;
    Simplex s;
    Point v = minus(b.pose.t, a.pose.t), direction = v;
    if (!unit(direction)) direction = v = {1.0, 0.0, 0.0};
    double best = -1e300;
    for (int step = 0; step < STEPS; ++step) {
        const double length = std::sqrt(dot(v, v));
        if (!(length > 1e-9)) break;  // they touch
        const Vertex w = nearest_along(a, b, v);
        const double bound = dot(v, w.w) / length;
        if (bound > best) {
            best = bound;
            direction = {v[0] / length, v[1] / length, v[2] / length};
        }
        if (best > limit) return measured(a, b, best, direction, w.a, w.b);
        if (s.n > 0 && length - best <= CONVERGED * 1e-2) break;
        s.p[s.n++] = w;
        if (!reduce(s, v)) {
            Gap gap;
            return Expanding(a, b, s).find(gap) ? gap : along_axes(a, b);
        }
    }
    if (!(best > 1e-9)) return along_axes(a, b);
    Point on_a{}, on_b{};
    for (int i = 0; i < s.n; ++i) {
        on_a = plus(on_a, s.share[i], s.p[i].a);
        on_b = plus(on_b, s.share[i], s.p[i].b);
    }
    return measured(a, b, best, direction, on_a, on_b);
}

class Looking {
  public:
    Looking(const Model& model, double within)
        : model_(model), within_(within), bodies_(model.joints.size() + 1), riders_(model.riders.size()) {
        for (std::size_t k = 0; k < riders_.size(); ++k) riders_[k] = of(model.riders[k].solid);
    }

    void look(const double* q, std::int64_t row, Near& out) {
        place_bodies(model_, q, bodies_);
        for (std::size_t k = 0; k < riders_.size(); ++k) {
            const Rider& rider = model_.riders[k];
            const Pose& body = bodies_[static_cast<std::size_t>(rider.body)];
            product(body.R, rider.rotation, riders_[k].pose.R);
            riders_[k].pose.t = plus(body.t, 1.0, turned(body.R, point_of(rider.position)));
            riders_[k].find_box();
        }
        auto own = model_.own_pairs.begin();
        for (std::size_t k = 0; k < riders_.size(); ++k) {
            if (model_.riders[k].meets_world && !model_.nodes.empty()) descend(0, k, row, out);
            for (; own != model_.own_pairs.end() && own->first == static_cast<int>(k); ++own) {
                const auto other = static_cast<std::size_t>(own->second);
                if (close(riders_[k], riders_[other].low.data(), riders_[other].high.data()))
                    measure({row, own->number}, k, riders_[other], model_.riders[other].body, out);
            }
        }
    }

  private:
    const Model& model_;
    const double within_;
    std::vector<Pose> bodies_;
    std::vector<Placed> riders_;

    Placed of(const Solid& solid) const {
        Placed placed{};
        placed.solid = &solid;
        if (solid.hull >= 0) {
            const Hull& hull = model_.hulls[static_cast<std::size_t>(solid.hull)];
            placed.corners = model_.corners.data() + hull.start;
            placed.count = hull.padded;
        }
        return placed;
    }

    Placed of(const Stander& stander) const {
        Placed placed = of(model_.solid_of(stander));
        const double* rotation = model_.turn_of(stander).rotation;
        std::copy(rotation, rotation + 9, placed.pose.R);
        placed.pose.t = point_of(stander.position);
        return placed;
    }

    template <class Number>
    bool close(const Placed& a, const Number* low, const Number* high) const {
        for (std::size_t k = 0; k < 3; ++k)
            if (a.low[k] - within_ > high[k] || a.high[k] + within_ < low[k]) return false;
        return true;
    }

    void descend(std::size_t index, std::size_t k, std::int64_t row, Near& out) {
        const Node& node = model_.nodes[index];
        if (!close(riders_[k], node.bounds.low, node.bounds.high)) return;
        if (node.other >= 0) {
            descend(index + 1, k, row, out);
            descend(static_cast<std::size_t>(node.other), k, row, out);
            return;
        }
        for (int i = node.first; i < node.first + node.count; ++i) {
            const Stander& stander = model_.standers[static_cast<std::size_t>(i)];
            const int pair = model_.pair_number(k, stander);
            if (pair < 0 || !close(riders_[k], stander.bounds.low, stander.bounds.high)) continue;
            double low[3], high[3];  // as what is measured is counted, not rounded
            box_around(model_, stander, low, high);
            if (close(riders_[k], low, high)) measure({row, pair}, k, of(stander), 0, out);
        }
    }

    void measure(std::pair<std::int64_t, int> where, std::size_t k, const Placed& b, int body, Near& out) {
        ++out.measured;
        const Gap gap = gap_of(riders_[k], b, within_);
        if (gap.distance > within_) return;
        out.rows.push_back(where.first);
        out.pairs.push_back(where.second);
        out.distances.push_back(gap.distance);
        out.points.insert(out.points.end(), gap.on_a.begin(), gap.on_a.end());
        out.points.insert(out.points.end(), gap.on_b.begin(), gap.on_b.end());
        const std::size_t start = out.gradients.size();
        out.gradients.resize(start + static_cast<std::size_t>(model_.dof), 0.0);
        add_motion(model_.riders[k].body, gap.on_a, gap.n, -1.0, out.gradients.data() + start);
        add_motion(body, gap.on_b, gap.n, 1.0, out.gradients.data() + start);
    }

    // What moving each joint moves a point of a body along n, times sign.
    void add_motion(int body, const Point& x, const Point& n, double sign, double* out) const {
        for (; body > 0; body = model_.joints[static_cast<std::size_t>(body - 1)].parent) {
            const Joint& joint = model_.joints[static_cast<std::size_t>(body - 1)];
            const Pose& pose = bodies_[static_cast<std::size_t>(body)];
            const Point axis = turned(pose.R, point_of(joint.axis));
            const Point speed = joint.motion == Motion::slide ? axis : cross(axis, minus(x, pose.t));
            out[joint.q_index] += sign * joint.multiplier * dot(speed, n);
        }
    }
};

}  // namespace

Near near(const Model& model, const double* Q, int m, double within) {
    Near out;
    Looking looking(model, within);
    for (int row = 0; row < m; ++row) looking.look(Q + static_cast<std::ptrdiff_t>(row) * model.dof, row, out);
    return out;
}

}  // namespace collision
