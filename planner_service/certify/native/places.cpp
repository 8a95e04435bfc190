#include "places.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace proof {

namespace {

// Not inlined: made one of both, a sine and a cosine might have other bits.
[[gnu::noinline]] double cosine(double x) { return std::cos(x); }
[[gnu::noinline]] double sine(double x) { return std::sin(x); }

// A frame given in another one, in what that one is given in; 3 x 4 each.
void compose(const double* a, const double* b, double* out) {
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 4; ++j) out[4 * i + j] = a[4 * i] * b[j] + a[4 * i + 1] * b[4 + j] + a[4 * i + 2] * b[8 + j];
        out[4 * i + 3] += a[4 * i + 3];
    }
}

void place_body(const Body& body, const double* q, double* out) {
    std::copy(body.still, body.still + 12, out);
    if (body.column < 0) return;
    const double angle = q[body.column] * body.multiplier;
    if (body.slides) {
        for (int k = 0; k < 12; ++k) out[k] += body.with_q[k] * angle;
        return;
    }
    const double cos = cosine(angle), sin = sine(angle);
    for (int k = 0; k < 12; ++k) out[k] = out[k] + body.with_cos[k] * cos + body.with_sin[k] * sin;
}

}  // namespace

double* Shelf::take() {
    if (!free_.empty()) {
        double* out = free_.back();
        free_.pop_back();
        return out;
    }
    if (left_ == 0) {
        blocks_.emplace_back(new double[AT_ONCE * each_]);  // nothing is read before it is written
        left_ = AT_ONCE;
    }
    return blocks_.back().get() + each_ * (AT_ONCE - left_--);
}

Places::Places(const Model& model, const Variant& variant, bool plain, const double* room)
    : model_(model),
      variant_(variant),
      plain_(plain),
      per_bodies_(12 * model.bodies.size()),
      of_poses_(12),
      of_radii_(model.depth) {
    leave_room(room);
}

void Places::leave_room(const double* room) {
    room_ = room;
    slid_ = 0.0;
    for (const Body& body : model_.bodies)
        if (body.column >= 0 && body.slides) slid_ += this->room(body.column) * std::fabs(body.multiplier);
}

std::size_t Places::add(double s, const double* q, const double* travel) {
    const std::size_t node = s_.size(), count = model_.bodies.size();
    s_.push_back(s);
    q_.insert(q_.end(), q, q + model_.dof);
    travel_.insert(travel_.end(), travel, travel + model_.dof);
    bodies_.resize(bodies_.size() + per_bodies_);
    poses_.resize(poses_.size() + model_.riding, nullptr);
    radii_.resize(radii_.size() + model_.riding, nullptr);
    double* out = bodies_.data() + node * per_bodies_;
    for (std::size_t k = 0; k < count; ++k) {
        const Body& body = model_.bodies[k];
        if (k == 0) {
            place_body(body, q, out);
            continue;
        }
        double local[12];
        place_body(body, q, local);
        compose(out + 12 * body.parent, local, out + 12 * k);
    }
    return node;
}

void Places::clear() {
    keep({});
}

void Places::keep(const std::vector<std::size_t>& nodes) {
    const auto n = static_cast<std::size_t>(model_.dof);
    std::vector<bool> kept(count(), false);
    for (const std::size_t node : nodes) kept[node] = true;
    for (std::size_t at = 0; at < poses_.size(); ++at) {
        if (kept[at / model_.riding]) continue;
        if (poses_[at] != nullptr) of_poses_.give(poses_[at]);
        if (radii_[at] != nullptr) of_radii_.give(radii_[at]);
    }
    const auto moved = [](auto& values, std::size_t each, std::size_t from, std::size_t to) {
        const auto first = values.begin() + static_cast<std::ptrdiff_t>(from * each);
        std::copy(first, first + static_cast<std::ptrdiff_t>(each), values.begin() + static_cast<std::ptrdiff_t>(to * each));
    };
    for (std::size_t to = 0; to < nodes.size(); ++to) {  // in ascending order: nothing is overwritten too soon
        const std::size_t from = nodes[to];
        if (from == to) continue;
        moved(s_, 1, from, to);
        moved(q_, n, from, to);
        moved(travel_, n, from, to);
        moved(bodies_, per_bodies_, from, to);
        moved(poses_, model_.riding, from, to);
        moved(radii_, model_.riding, from, to);
    }
    s_.resize(nodes.size());
    q_.resize(nodes.size() * n);
    travel_.resize(nodes.size() * n);
    bodies_.resize(nodes.size() * per_bodies_);
    poses_.resize(nodes.size() * model_.riding);
    radii_.resize(nodes.size() * model_.riding);
}

const double* Places::pose(std::size_t rider, std::size_t node) {
    const Rider& found = model_.riders[rider];
    double*& out = poses_[node * model_.riding + rider];
    if (out == nullptr) {
        out = of_poses_.take();
        compose(bodies_.data() + node * per_bodies_ + 12 * found.body, found.frame, out);
    }
    return out;
}

const double* Places::pose_of(int piece, std::size_t node, double* room) {
    const auto k = static_cast<std::size_t>(piece);
    if (k < model_.riding) return pose(k, node);
    const Stander& found = model_.standers[k - model_.riding];
    const double* turn = model_.turns.data() + 9 * static_cast<std::size_t>(found.turn);
    for (int i = 0; i < 3; ++i) {
        std::copy(turn + 3 * i, turn + 3 * i + 3, room + 4 * i);
        room[4 * i + 3] = found.position[i];
    }
    return room;
}

Places::Sphere Places::sphere(int piece, std::size_t node) {
    const auto k = static_cast<std::size_t>(piece);
    const double radius = model_.solid(piece).radius;
    if (k >= model_.riding) {
        const double* at = model_.standers[k - model_.riding].position;
        return {{at[0], at[1], at[2]}, radius};
    }
    const double* P = pose(k, node);
    return {{P[3], P[7], P[11]}, radius};
}

const double* Places::radii(std::size_t piece, std::size_t node) {
    double*& out = radii_[node * model_.riding + piece];
    if (out == nullptr) {
        out = of_radii_.take();
        find_radii(piece, node, out);
    }
    return out;
}

void Places::find_radii(std::size_t piece, std::size_t node, double* out) {
    const Rider& found = model_.riders[piece];
    const Solid& solid = model_.solid(static_cast<int>(piece));
    const double *P = pose(piece, node), *bodies = bodies_.data() + node * per_bodies_;
    const double radius = solid.radius;
    for (std::size_t k = 0; k < found.count; ++k) {
        const Link& link = model_.links[found.first + k];
        const Body& body = model_.bodies[static_cast<std::size_t>(link.body)];
        if (body.column < 0 || body.slides) continue;  // no motion asks for it
        if (plain_) {
            out[k] = link.far;
            continue;
        }
        const double* B = bodies + 12 * link.body;
        double z[3], x[3], c[3];
        for (int i = 0; i < 3; ++i) {
            z[i] = B[4 * i] * body.axis[0] + B[4 * i + 1] * body.axis[1] + B[4 * i + 2] * body.axis[2];
            x[i] = P[4 * i + 3] - B[4 * i + 3];
        }
        const double along = x[0] * z[0] + x[1] * z[1] + x[2] * z[2];
        for (int i = 0; i < 3; ++i) c[i] = x[i] - along * z[i];
        const double u = c[0] * P[0] + c[1] * P[4] + c[2] * P[8];
        const double v = c[0] * P[1] + c[1] * P[5] + c[2] * P[9];
        const double w = c[0] * P[2] + c[1] * P[6] + c[2] * P[10];
        const double across = u * u + v * v, square = across + w * w;
        double support;
        const double* half = solid.hull != nullptr ? solid.hull->half : solid.half;
        support = std::fabs(u) * half[0] + std::fabs(v) * half[1] + std::fabs(w) * half[2];
        if (solid.hull == nullptr) {
            if (solid.disc > 0.0) support = support + solid.disc * std::sqrt(across);
            if (solid.ball > 0.0) support = support + solid.ball * std::sqrt(square);
        }
        out[k] = std::min(std::sqrt(square + 2.0 * support + radius * radius), link.far);
    }
}

Facing Places::facing(const Pair& pair, std::size_t node) {
    double room[12];
    const double *A = pose(static_cast<std::size_t>(pair.first), node), *B = pose_of(pair.second, node, room);
    Facing out;
    out.a = &model_.solid(pair.first);
    out.b = &model_.solid(pair.second);
    const double delta[3] = {A[3] - B[3], A[7] - B[7], A[11] - B[11]};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) out.R[3 * i + j] = B[i] * A[j] + B[4 + i] * A[4 + j] + B[8 + i] * A[8 + j];
        out.x[i] = B[i] * delta[0] + B[4 + i] * delta[1] + B[8 + i] * delta[2];
    }
    return out;
}

double Places::spheres_apart(const Pair& pair, std::size_t node) {
    const Sphere a = sphere(pair.first, node), b = sphere(pair.second, node);
    const double x = a.centre[0] - b.centre[0], y = a.centre[1] - b.centre[1], z = a.centre[2] - b.centre[2];
    return std::sqrt(x * x + y * y + z * z) * (1.0 - model_.terms.rounding) - (a.radius + b.radius);
}

Bound Places::sphere_apart(const Pair& pair, std::size_t node) {
    double room[12];
    const double *A = pose(static_cast<std::size_t>(pair.first), node), *B = pose_of(pair.second, node, room);
    const Solid& b = model_.solid(pair.second);
    const double delta[3] = {A[3] - B[3], A[7] - B[7], A[11] - B[11]};
    double x[3];
    for (int i = 0; i < 3; ++i) x[i] = B[i] * delta[0] + B[4 + i] * delta[1] + B[8 + i] * delta[2];
    double around = b.radius;
    if (b.hull == nullptr) {  // from the point of its core nearest to the sphere's centre
        around = b.ball;
        for (int i = 0; i < 3; ++i) x[i] -= std::min(std::max(x[i], -b.half[i]), b.half[i]);
        if (b.disc > 0.0) {
            const double across = std::sqrt(x[0] * x[0] + x[1] * x[1]);
            const double share = across > b.disc ? 1.0 - b.disc / across : 0.0;
            x[0] *= share;
            x[1] *= share;
        }
    }
    const double length = std::sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
    const double radii = model_.solid(pair.first).radius + around;
    if (!(length > 0.0)) return {-std::numeric_limits<double>::infinity(), {}};
    return {length * (1.0 - model_.terms.rounding) - radii, {x[0] / length, x[1] / length, x[2] / length}};
}

bool Places::spheres_clear(const Pair& pair, double enough) {
    const Sphere a = sphere(pair.first, about_node_), b = sphere(pair.second, about_node_);
    const double x = a.centre[0] - b.centre[0], y = a.centre[1] - b.centre[1], z = a.centre[2] - b.centre[2];
    const double within = a.radius + b.radius + (motion_about(pair) + enough);
    return (x * x + y * y + z * z) * (1.0 - model_.terms.rounding) > within * within;
}

void Places::begin_about(std::size_t node, const double* travel) {
    about_node_ = node;
    about_travel_ = travel;
    about_.resize(model_.riding * (model_.depth + 1));
    abouts_.assign(model_.riding, 0);
}

const double* Places::motions_about(std::size_t piece) {
    double* out = about_.data() + piece * (model_.depth + 1);
    if (abouts_[piece] != 0) return out;
    abouts_[piece] = 1;
    add_motions(piece, about_node_, about_travel_, out);
    return out;
}

// Of a piece against the parents of the joints that carry it while these travel so far (nullptr: not at all), and their room.
void Places::add_motions(std::size_t piece, std::size_t node, const double* travel, double* out) {
    const Rider& found = model_.riders[piece];
    const double* here = radii(piece, node);
    out[0] = 0.0;
    for (std::size_t k = 0; k < found.count; ++k) {
        const Link& link = model_.links[found.first + k];
        const Body& body = model_.bodies[static_cast<std::size_t>(link.body)];
        out[k + 1] = out[k];
        if (body.column < 0) continue;
        const double radius = body.slides ? 1.0 : std::min(here[k] + out[k], link.far + slid_);
        const double moved = (travel == nullptr ? 0.0 : travel[body.column]) + room(body.column);
        out[k + 1] = out[k] + radius * (moved * std::fabs(body.multiplier));
    }
}

double Places::room_motion(const Pair& pair, std::size_t node) {
    beside_.resize(model_.depth + 1);
    add_motions(static_cast<std::size_t>(pair.first), node, nullptr, beside_.data());
    double out = beside_[pair.own];
    if (pair.other > 0) {
        add_motions(static_cast<std::size_t>(pair.second), node, nullptr, beside_.data());
        out += beside_[pair.other];
    }
    return out;
}

Places::Approach Places::approach(const Pair& pair, std::size_t node, const double* n, const double* travel, bool bent) {
    double room[12], along[3], apart = 0.0;
    const double *A = pose(static_cast<std::size_t>(pair.first), node), *B = pose_of(pair.second, node, room);
    for (std::size_t i = 0; i < 3; ++i) along[i] = B[4 * i] * n[0] + B[4 * i + 1] * n[1] + B[4 * i + 2] * n[2];
    for (std::size_t i = 0; i < 3; ++i) apart += (A[4 * i + 3] - B[4 * i + 3]) * along[i];
    if (apart < 0.0)  // from the second piece to the first
        for (double& value : along) value = -value;
    Approach out = approach_of(static_cast<std::size_t>(pair.first), pair.own, node, along, travel, bent);
    for (double& value : along) value = -value;
    if (pair.other > 0) {
        const Approach second = approach_of(static_cast<std::size_t>(pair.second), pair.other, node, along, travel, bent);
        out.slope += second.slope;
        out.rest += second.rest;
    }
    return out;
}

// Of one piece, against the parent of the last of so many joints that carry it; n in the axes of the world, away from the other one.
// A point p of it gets as close as ``n p - sum d_k |m_k (p - o_k)|`` to first order, m_k being n across the axis of joint k: that is
// concave in p, and so least at a corner, and so it is with the second order's terms. A disc around it adds what it moves by itself.
// A ball around it adds nothing, for the ball around a moved core is that around the core, moved.
Places::Approach Places::approach_of(std::size_t piece, std::size_t count, std::size_t node, const double* n, const double* travel,
                                     bool bent) {
    const Rider& found = model_.riders[piece];
    const Solid& solid = model_.solid(static_cast<int>(piece));
    const double *P = pose(piece, node), *here = radii(piece, node), *bodies = bodies_.data() + node * per_bodies_;
    Approach out;
    double swept = 0.0, second = 0.0, third = 0.0;
    turns_.clear();
    joints_.clear();
    for (std::size_t k = 0; k < count; ++k) {
        const Link& link = model_.links[found.first + k];
        const Body& body = model_.bodies[static_cast<std::size_t>(link.body)];
        if (body.column < 0) continue;
        const double* B = bodies + 12 * link.body;
        Turn turn{};
        turn.moved = ((travel == nullptr ? 0.0 : travel[body.column]) + room(body.column)) * std::fabs(body.multiplier);
        turn.slides = body.slides;
        for (int i = 0; i < 3; ++i) {
            turn.z[i] = B[4 * i] * body.axis[0] + B[4 * i + 1] * body.axis[1] + B[4 * i + 2] * body.axis[2];
            turn.o[i] = B[4 * i + 3];
        }
        const double *z = turn.z, moved = turn.moved;
        turn.along = n[0] * z[0] + n[1] * z[1] + n[2] * z[2];
        const double radius = body.slides ? 1.0 : std::min(here[k] + swept, link.far + slid_);
        if (body.slides) {
            out.slope += moved * std::fabs(turn.along);
        } else {
            const double m[3] = {n[1] * z[2] - n[2] * z[1], n[2] * z[0] - n[0] * z[2], n[0] * z[1] - n[1] * z[0]};
            turn_by(moved, m, turn.o, P);
        }
        if (bent) bend_by(turn, n, P, out);
        third += moved * (moved * (radius * moved / 6.0 + 0.5 * swept) + second);
        second += moved * (0.5 * radius * moved + swept);
        swept += radius * moved;
    }
    if (solid.hull == nullptr && solid.disc > 0.0)
        for (const Affine& turn : turns_) out.slope += solid.disc * std::sqrt(turn.x * turn.x + turn.y * turn.y);
    double local[3];
    for (int j = 0; j < 3; ++j) local[j] = n[0] * P[j] + n[1] * P[4 + j] + n[2] * P[8 + j];
    out.slope = (out.slope + nearest_corner(solid, local)) * (1.0 + model_.terms.rounding);
    out.rest = (bent ? third : second) * (1.0 + model_.terms.rounding);
    return out;
}

void Places::turn_by(double share, const double* v, const double* o, const double* P) {
    const double x = share * v[0], y = share * v[1], z = share * v[2];
    turns_.push_back({x * P[0] + y * P[4] + z * P[8], x * P[1] + y * P[5] + z * P[9], x * P[2] + y * P[6] + z * P[10],
                      x * (P[3] - o[0]) + y * (P[7] - o[1]) + z * (P[11] - o[2])});
}

// What the second derivatives are along n by a joint and each outer one, and by itself, and adds it to the outer ones. By joints j and
// k, of which k is the outer one, it is ``z_j x (z_k x (p - o_k))``, which is ``z_k (z_j (p - o_k)) - (p - o_k) (z_j z_k)``; where k
// slides ``z_j x z_k``, and none where j does.
void Places::bend_by(const Turn& turn, const double* n, const double* P, Approach& out) {
    joints_.push_back(turn);
    if (turn.slides) return;
    const double* z = turn.z;
    for (const Turn& outer : joints_) {
        const double* w = outer.z;
        const bool same = &outer == &joints_.back();
        const double share = (same ? 0.5 : 1.0) * turn.moved * outer.moved;
        if (outer.slides) {
            const double across = n[0] * (z[1] * w[2] - z[2] * w[1]) + n[1] * (z[2] * w[0] - z[0] * w[2]) + n[2] * (z[0] * w[1] - z[1] * w[0]);
            out.slope += share * std::fabs(across);
            continue;
        }
        const double both = z[0] * w[0] + z[1] * w[1] + z[2] * w[2];
        const double v[3] = {outer.along * z[0] - both * n[0], outer.along * z[1] - both * n[1], outer.along * z[2] - both * n[2]};
        turn_by(share, v, outer.o, P);
    }
}

// How much lower than its lowest corner any gets by what is in ``turns_``, ``local`` being upwards.
double Places::nearest_corner(const Solid& solid, const double* local) {
    if (solid.hull != nullptr)
        return variant_.lowered(solid.hull->corners, solid.hull->padded, local, turns_.data(), turns_.size());
    double around[3 * LANES];
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t side = 0; side < LANES; ++side) around[LANES * i + side] = (side >> i) & 1 ? solid.half[i] : -solid.half[i];
    return variant_.lowered(around, LANES, local, turns_.data(), turns_.size());
}

double Places::motion_about(const Pair& pair) {
    double out = motions_about(static_cast<std::size_t>(pair.first))[pair.own];
    if (pair.other > 0) out += motions_about(static_cast<std::size_t>(pair.second))[pair.other];
    return out;
}

void Places::box_about(std::size_t piece, double* out) {
    const Solid& solid = model_.solid(static_cast<int>(piece));
    const double *P = pose(piece, about_node_), moved = motions_about(piece)[model_.riders[piece].count];
    for (std::size_t i = 0; i < 3; ++i) {
        const double u = P[4 * i], v = P[4 * i + 1], w = P[4 * i + 2];
        double low, high;
        if (solid.hull != nullptr) {
            low = variant_.height(*solid.hull, -u, -v, -w);
            high = variant_.height(*solid.hull, u, v, w);
        } else {
            low = high = std::fabs(u) * solid.half[0] + std::fabs(v) * solid.half[1] + std::fabs(w) * solid.half[2] +
                         solid.disc * std::sqrt(u * u + v * v) + solid.ball;
        }
        out[i] = P[4 * i + 3] - low - moved;
        out[3 + i] = P[4 * i + 3] + high + moved;
    }
}

void Places::begin_stretches(std::size_t count) {
    moved_.assign(count * model_.riding, -1);
    motions_.clear();
    bent_.assign(count * model_.riding, -1);
    bends_.clear();
}

const double* Places::motions(std::size_t piece, std::size_t stretch, std::size_t a, std::size_t b) {
    std::int32_t& at = moved_[stretch * model_.riding + piece];
    const std::size_t each = model_.depth + 1;
    if (at >= 0) return motions_.data() + static_cast<std::size_t>(at) * each;
    at = static_cast<std::int32_t>(motions_.size() / each);
    motions_.resize(motions_.size() + each);
    double* out = motions_.data() + motions_.size() - each;
    const double *one = radii(piece, a), *two = radii(piece, b);
    const auto n = static_cast<std::size_t>(model_.dof);
    const double *start = travel_.data() + a * n, *end = travel_.data() + b * n;
    const Rider& found = model_.riders[piece];
    out[0] = 0.0;
    for (std::size_t k = 0; k < found.count; ++k) {
        const Link& link = model_.links[found.first + k];
        const Body& body = model_.bodies[static_cast<std::size_t>(link.body)];
        out[k + 1] = out[k];
        if (body.column < 0) continue;
        const double travel = (end[body.column] - start[body.column] + 2.0 * room(body.column)) * std::fabs(body.multiplier);
        const double radius = body.slides ? 1.0 : std::min(0.5 * (one[k] + two[k]) + 0.5 * out[k], link.far + slid_);
        out[k + 1] = out[k] + radius * travel;
    }
    return out;
}

double Places::pair_motion(const Pair& pair, std::size_t stretch, std::size_t a, std::size_t b) {
    double out = motions(static_cast<std::size_t>(pair.first), stretch, a, b)[pair.own];
    if (pair.other > 0) out += motions(static_cast<std::size_t>(pair.second), stretch, a, b)[pair.other];
    return out;
}

const double* Places::bends(std::size_t piece, std::size_t stretch, std::size_t a, std::size_t b, const double* strays) {
    std::int32_t& at = bent_[stretch * model_.riding + piece];
    const std::size_t each = model_.depth + 1;
    if (at >= 0) return bends_.data() + static_cast<std::size_t>(at) * each;
    const double *moved = motions(piece, stretch, a, b), *one = radii(piece, a), *two = radii(piece, b);
    at = static_cast<std::int32_t>(bends_.size() / each);
    bends_.resize(bends_.size() + each);
    double* out = bends_.data() + bends_.size() - each;
    const auto n = static_cast<std::size_t>(model_.dof);
    const double *start = q_.data() + a * n, *end = q_.data() + b * n;
    const Rider& found = model_.riders[piece];
    double swept = 0.0, strayed = 0.0;
    out[0] = 0.0;
    for (std::size_t k = 0; k < found.count; ++k) {
        const Link& link = model_.links[found.first + k];
        const Body& body = model_.bodies[static_cast<std::size_t>(link.body)];
        out[k + 1] = out[k];
        if (body.column < 0) continue;
        const double many = std::fabs(body.multiplier), turn = std::fabs(end[body.column] - start[body.column]) * many;
        const double radius = body.slides ? 1.0 : std::min(0.5 * (one[k] + two[k]) + 0.5 * moved[k], link.far);
        const double aside = (body.slides ? 1.0 : std::min(radius + strayed, link.far)) * (strays[body.column] * many);
        out[k + 1] = out[k] + (0.125 * turn * (radius * turn + 2.0 * swept) + aside);
        swept += radius * turn;
        strayed += aside;
    }
    return out;
}

double Places::pair_bend(const Pair& pair, std::size_t stretch, std::size_t a, std::size_t b, const double* strays) {
    double out = bends(static_cast<std::size_t>(pair.first), stretch, a, b, strays)[pair.own];
    if (pair.other > 0) out += bends(static_cast<std::size_t>(pair.second), stretch, a, b, strays)[pair.other];
    return out;
}

double Places::steady(const Pair& pair, std::size_t from, std::size_t to, const Bound& known, double bend) {
    double n[3];
    Bound found{};
    turned(pair, from, to, known.n, n);
    variant_.along(model_.terms, facing(pair, to), n, found);
    return std::min(known.gap, found.gap) - bend;
}

void Places::turned(const Pair& pair, std::size_t from, std::size_t to, const double* n, double* out) {
    std::copy(n, n + 3, out);
    if (static_cast<std::size_t>(pair.second) >= model_.riding) return;
    const Rider& first = model_.riders[static_cast<std::size_t>(pair.first)];
    const std::size_t carrier = pair.own < first.count ? static_cast<std::size_t>(model_.links[first.first + pair.own].body) : 0;
    const auto out_of = [&](const double* frame) {
        const double x = out[0], y = out[1], z = out[2];
        for (std::size_t i = 0; i < 3; ++i) out[i] = frame[4 * i] * x + frame[4 * i + 1] * y + frame[4 * i + 2] * z;
    };
    const auto into = [&](const double* frame) {
        const double x = out[0], y = out[1], z = out[2];
        for (std::size_t i = 0; i < 3; ++i) out[i] = frame[i] * x + frame[4 + i] * y + frame[8 + i] * z;
    };
    out_of(pose(static_cast<std::size_t>(pair.second), from));
    into(bodies_.data() + from * per_bodies_ + 12 * carrier);
    out_of(bodies_.data() + to * per_bodies_ + 12 * carrier);
    into(pose(static_cast<std::size_t>(pair.second), to));
}

}  // namespace proof
