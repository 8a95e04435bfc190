// planner_service.certify.native._proof: the model built from the tables of motion_bounds.py, and what is asked of it.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>

#include "clearance.hpp"
#include "diagram.hpp"
#include "edge.hpp"
#include "tree.hpp"
#include "tubes.hpp"

namespace nb = nanobind;

namespace proof {

namespace {

using Rows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Anything = nb::ndarray<nb::ro, nb::device::cpu>;
using Numbers = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using WholeRows = nb::ndarray<const std::int64_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Directions = nb::ndarray<const double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Heights = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Wholes = nb::ndarray<const std::int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Path = std::tuple<Rows, Numbers, Rows, Numbers, Wholes, Wholes, Rows>;

constexpr int SIDES = 13;  // directions in which outermost corners are looked for, and their opposites

void require(bool condition, const char* what) {
    if (!condition) throw std::invalid_argument(what);
}

// What is no number is neither above nor below another: every proof relies on these.
void require_finite(const double* values, std::size_t count) {
    for (std::size_t k = 0; k < count; ++k) require(std::isfinite(values[k]), "finite numbers");
}

void require_finite(const Rows& rows) { require_finite(rows.data(), rows.shape(0) * rows.shape(1)); }

int whole(std::int64_t value, std::int64_t low, std::int64_t high, const char* what) {
    require(low <= value && value <= high, what);
    return static_cast<int>(value);
}

int whole(double value, std::int64_t low, std::int64_t high, const char* what) {
    require(std::fabs(value) < 1e9, what);
    return whole(static_cast<std::int64_t>(value), low, high, what);
}

std::vector<const Variant*> variants() {
    std::vector<const Variant*> out{&baseline};
#ifdef PROOF_X86
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2")) out.push_back(&avx2);
#endif
    return out;
}

// Calls back into Python, but once a millisecond at most: to wait for the interpreter takes longer than many bounds.
class PythonCharge final : public Charge {
  public:
    explicit PythonCharge(nb::handle callable) : callable_(callable) {}
    void bounds(std::int64_t count) override {
        if (callable_.is_none()) return;
        untold_ += count;
        const auto now = Clock::now();
        if (now < next_) return;
        next_ = now + std::chrono::milliseconds(1);
        nb::gil_scoped_acquire acquire;
        tell();
    }

    // Tells of what was not told yet. The caller holds the interpreter.
    void tell() {
        if (untold_ > 0) callable_(std::exchange(untold_, 0));
    }

  private:
    using Clock = std::chrono::steady_clock;
    nb::handle callable_;
    std::int64_t untold_ = 0;
    Clock::time_point next_ = Clock::now() + std::chrono::milliseconds(1);
};

std::vector<double> padded(const Rows& corners, const std::vector<std::size_t>& chosen) {
    const std::size_t each = (chosen.size() + LANES - 1) / LANES * LANES;
    std::vector<double> out;
    for (std::size_t k = 0; k < 3; ++k)
        for (std::size_t i = 0; i < each; ++i)
            out.push_back(corners.data()[3 * (i < chosen.size() ? chosen[i] : chosen[0]) + k]);
    return out;
}

std::vector<std::size_t> outermost(const Rows& corners) {
    std::set<std::size_t> found;
    for (int side = 0; side < SIDES; ++side) {  // the 13 lines through a cube's centre and a neighbour's
        const int code = side + 14;             // 14..26 in base three: the later half of all
        const double d[3] = {code / 9 - 1.0, code / 3 % 3 - 1.0, code % 3 - 1.0};
        std::size_t low = 0, high = 0;
        const auto at = [&](std::size_t i) {
            const double* p = corners.data() + 3 * i;
            return p[0] * d[0] + p[1] * d[1] + p[2] * d[2];
        };
        for (std::size_t i = 1; i < corners.shape(0); ++i) {
            if (at(i) < at(low)) low = i;
            if (at(i) > at(high)) high = i;
        }
        found.insert({low, high});
    }
    return {found.begin(), found.end()};
}

// The verdict on an edge, as ``Verdict`` numbers it; none if an end was not taken.
struct EdgeAnswer {
    bool taken = false;
    EdgeResult result;
};

// Rows of nine doubles: pair and numbers of each leaf.
nb::bytes bytes_of(const std::vector<Leaf>& trail) {
    std::vector<double> rows;
    rows.reserve(9 * trail.size());
    for (const Leaf& leaf : trail) {
        rows.push_back(leaf.pair);
        rows.insert(rows.end(), std::begin(leaf.numbers), std::end(leaf.numbers));
    }
    return nb::bytes(static_cast<const void*>(rows.data()), rows.size() * sizeof(double));
}

class Prover {
  public:
    Prover(const std::vector<double>& terms, std::int64_t dof, const Rows& bodies, const Rows& riders, const Rows& links,
           const std::vector<Rows>& hulls, const Rows& solids, const Wholes& solid_of, const Rows& turns,
           const Wholes& turn_of, const Rows& positions, const WholeRows& pairs, const WholeRows& trees,
           const WholeRows& children, const WholeRows& blocks, const Rows& limits,
           const std::string& variant) {
        for (const auto* found : variants())
            if (variant.empty() || variant == found->name) variant_ = found;
        require(variant_ != nullptr, "this processor has no such instruction set");
        model_.dof = whole(dof, 1, 1'000'000, "no robot has so many joints");
        add_terms(terms);
        add_bodies(bodies);
        add_hulls(hulls);
        add_solids(solids);
        add_riders(riders);
        add_links(links);
        add_standers(turns, turn_of, positions);
        add_solid_of(solid_of);
        add_pairs(pairs);
        add_trees(trees, children);
        add_blocks(blocks);
        add_crowds();
        require(limits.shape(0) == 2 && limits.shape(1) == static_cast<std::size_t>(model_.dof), "limits of another robot");
        limits_.assign(limits.data(), limits.data() + 2 * limits.shape(1));
    }

    const char* variant() const { return variant_->name; }

    nb::tuple prove(const Rows& waypoints, const Numbers& knots, const Rows& tangents, const Numbers& breaks,
                    const Wholes& lines, const Wholes& blends, const Rows& corners, const Rows& spans, const WholeRows& roots,
                    double enough, nb::handle charge, const std::optional<Path>& walked) const {
        const Curve curve = curve_of(waypoints, knots, tangents, breaks, lines, blends, corners);
        std::optional<Curve> travelled;  // of a proof that keeps its trail
        if (walked) travelled = std::apply([this](const auto&... tables) { return curve_of(tables...); }, *walked);
        require(spans.shape(1) == 2 && roots.shape(1) == 2, "two numbers for each span and root");
        require_finite(spans);
        require_finite(&enough, 1);
        std::vector<Span> stretches;
        for (std::size_t k = 0; k < spans.shape(0); ++k)
            stretches.push_back({spans.data()[2 * k], spans.data()[2 * k + 1]});
        std::vector<Root> rows;
        rows.reserve(roots.shape(0));
        const std::int64_t count = model_.count;
        for (std::size_t k = 0; k < roots.shape(0); ++k)
            rows.push_back({whole(roots.data()[2 * k], 0, count - 1, "no such pair"),
                            static_cast<std::size_t>(whole(roots.data()[2 * k + 1], 0,
                                                           static_cast<std::int64_t>(stretches.size()) - 1,
                                                           "no such span"))});
        PythonCharge told(charge);
        Outcome out;
        std::vector<Leaf> trail;
        {
            nb::gil_scoped_release release;
            out = Tree(model_, *variant_, curve, enough, told, travelled ? &*travelled : nullptr, travelled ? &trail : nullptr)
                      .run(stretches, std::move(rows));
        }
        told.tell();
        return nb::make_tuple(out.asked, out.most, out.proven, static_cast<int>(out.end), out.pair, out.span.start,
                              out.span.end, out.s, out.gap, bytes_of(trail));
    }

    // The verdict on the straight edge between two configurations; none if one is no array of n doubles within the limits.
    EdgeAnswer edge(nb::handle q1, nb::handle q2, double enough, double nearer, double slack) const {
        const auto n = static_cast<std::size_t>(model_.dof);
        std::vector<double> points(2 * n);
        if (!read(q1, slack, points.data()) || !read(q2, slack, points.data() + n)) return {};
        nb::gil_scoped_release release;
        const LineVerdict found = judge_line(model_, *variant_, points.data(), points.data() + n, enough, nearer, nullptr, roots_);
        return {found.taken, found.result};
    }

    // Straight edges between rows, with room for each joint, until one is not free: how many are, the bounds that were asked, and of
    // the next one pair, s and whether it collides.
    nb::tuple tubes(const Rows& starts, const Rows& ends, const Rows& room, double enough, double nearer, int parts,
                    int each) const {
        require_alike(starts, ends, room);
        const std::size_t count = starts.shape(0);
        Tubes tubes(model_, *variant_, count, starts.data(), ends.data(), room.data(), enough, nearer, parts, each);
        std::size_t free = 0;
        {
            nb::gil_scoped_release release;
            free = tubes.run(roots_);
        }
        const EdgeResult& found = tubes.found();
        return nb::make_tuple(free, tubes.asked(), free < count ? found.pair : -1, found.s, found.verdict == Verdict::colliding);
    }

    // What is proven of two motions, each of some joints, on clocks of their own.
    Diagram diagram(const Rows& q1, const Rows& travel1, const Wholes& columns1, const Rows& q2, const Rows& travel2,
                    const Wholes& columns2, const Numbers& durations, const Numbers& still, double enough) const {
        require(still.shape(0) == static_cast<std::size_t>(model_.dof), "configurations of another robot");
        require(durations.shape(0) == 2, "two durations");
        require_finite(still.data(), still.shape(0));
        require_finite(durations.data(), 2);
        require_finite(&enough, 1);
        std::vector<bool> moves(still.shape(0), false);
        Motion first = motion_of(q1, travel1, columns1, durations.data()[0], moves);
        Motion second = motion_of(q2, travel2, columns2, durations.data()[1], moves);
        return Diagram(model_, *variant_, std::move(first), std::move(second), {still.data(), still.data() + still.shape(0)}, enough,
                       roots_);
    }

    // Boxes that pieces do not leave on straight edges with room, six numbers each, into ``out``.
    void boxes(const Rows& starts, const Rows& ends, const Rows& room,
               const nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>& out) const {
        require_alike(starts, ends, room);
        require(starts.shape(0) > 0 && out.shape(0) <= model_.riding && out.shape(1) == 6, "a box for each piece");
        nb::gil_scoped_release release;
        Tubes tubes(model_, *variant_, starts.shape(0), starts.data(), ends.data(), room.data(), 0.0, 0.0, 0, 0);
        tubes.boxes(out.shape(0), out.data());
    }

    Motion motion_of(const Rows& q, const Rows& travel, const Wholes& columns, double duration, std::vector<bool>& moves) const {
        const std::size_t rows = (std::size_t{1} << Diagram::LAST) + 1, n = columns.shape(0);
        require(q.shape(0) == rows && travel.shape(0) == rows && q.shape(1) == n && travel.shape(1) == n, "a motion's rows");
        require_finite(q);
        require_finite(travel);
        require(duration >= 0.0, "a duration below 0");
        Motion out{{}, {q.data(), q.data() + rows * n}, {travel.data(), travel.data() + rows * n}, duration};
        for (std::size_t k = 0; k < n; ++k) {
            const int column = whole(columns.data()[k], 0, model_.dof - 1, "no such joint");
            require(!moves[static_cast<std::size_t>(column)], "a joint of both motions");
            moves[static_cast<std::size_t>(column)] = true;
            out.columns.push_back(column);
        }
        for (std::size_t k = n; k < out.travel.size(); ++k) require(out.travel[k] >= out.travel[k - n], "travel that turns back");
        return out;
    }

    // Lower bounds of the smallest gap at each row of Q, into ``out``.
    void clearances(const Rows& Q, const nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>& out) const {
        const auto n = static_cast<std::size_t>(model_.dof);
        require(Q.shape(1) == n && out.shape(0) == Q.shape(0), "configurations of another robot");
        const std::size_t count = Q.shape(0);
        const double* q = Q.data();
        double* found = out.data();
        nb::gil_scoped_release release;
        Clearance clearance(model_, *variant_);
        for (std::size_t k = 0; k < count; ++k) found[k] = clearance.at(q + n * k, roots_);
    }

    // Pairs nearer than ``within`` at each row of Q, six doubles each.
    nb::bytes near(const Rows& Q, const Wholes& pairs, double within) const {
        const auto n = static_cast<std::size_t>(model_.dof);
        require(Q.shape(1) == n, "configurations of another robot");
        require_finite(Q);
        std::vector<int> asked;
        for (std::size_t k = 0; k < pairs.shape(0); ++k)
            asked.push_back(whole(pairs.data()[k], 0, std::int64_t{model_.count} - 1, "no such pair"));
        std::vector<double> out;
        {
            nb::gil_scoped_release release;
            Clearance clearance(model_, *variant_);
            for (std::size_t k = 0; k < Q.shape(0); ++k)
                clearance.near(Q.data() + n * k, static_cast<double>(k), asked, within, out);
        }
        return nb::bytes(static_cast<const void*>(out.data()), out.size() * sizeof(double));
    }

    // Of plain pairs between two places of a curve, three doubles each: how far their pieces move against each other at most;
    // how far their points leave their straight lines, seen from the last body that carries both (infinite: not known); and
    // a bound of their gap all along, by a direction given in the axes of the second piece at the first place.
    nb::bytes stretch(const Rows& waypoints, const Numbers& knots, const Rows& tangents, const Numbers& breaks,
                      const Wholes& lines, const Wholes& blends, const Rows& corners, double start, double end,
                      const Wholes& pairs, const Rows& directions) const {
        const Curve curve = curve_of(waypoints, knots, tangents, breaks, lines, blends, corners);
        require(directions.shape(0) == pairs.shape(0) && directions.shape(1) == 3, "a direction for each pair");
        const auto n = static_cast<std::size_t>(model_.dof);
        std::vector<double> q(n), travel(n), strays(n), out;
        Places places(model_, *variant_);
        for (const double s : {start, end}) {
            curve.at(s, q.data(), travel.data());
            places.add(s, q.data(), travel.data());
        }
        places.begin_stretches(1);
        const bool even = curve.strays(start, end, strays.data());
        for (std::size_t k = 0; k < pairs.shape(0); ++k) {
            const auto last = static_cast<std::int64_t>(model_.pairs.size()) - 1;
            const Pair pair = model_.pair(whole(pairs.data()[k], 0, last, "no such plain pair"));
            const double bend = even ? places.pair_bend(pair, 0, 0, 1, strays.data()) : std::numeric_limits<double>::infinity();
            Bound here{};
            variant_->along(model_.terms, places.facing(pair, 0), directions.data() + 3 * k, here);
            out.insert(out.end(), {places.pair_motion(pair, 0, 0, 1), bend, places.steady(pair, 0, 1, here, bend)});
        }
        return nb::bytes(static_cast<const void*>(out.data()), out.size() * sizeof(double));
    }

  private:
    Model model_;
    const Variant* variant_ = nullptr;
    static constexpr std::int64_t MOST_PAIRS = 2'000'000'000;
    std::vector<int> roots_;
    std::vector<std::vector<int>> tops_;  // of each tree the members that are in no bundle
    std::vector<double> limits_;  // the lower ones, then the upper ones

    void require_alike(const Rows& starts, const Rows& ends, const Rows& room) const {
        for (const auto* rows : {&starts, &ends, &room}) {
            require(rows->shape(0) == starts.shape(0) && rows->shape(1) == static_cast<std::size_t>(model_.dof),
                    "configurations of another robot");
            require_finite(*rows);
        }
    }

    bool read(nb::handle q, double slack, double* out) const {
        const auto n = static_cast<std::size_t>(model_.dof);
        Anything array;
        if (!nb::try_cast(q, array, false)) return false;  // no numbers of this machine, or not evenly spaced
        if (array.ndim() != 1 || array.shape(0) != n || array.dtype() != nb::dtype<double>()) return false;
        const auto* values = static_cast<const double*>(array.data());
        for (std::size_t k = 0; k < n; ++k) {
            out[k] = values[static_cast<std::int64_t>(k) * array.stride(0)];
            if (!(out[k] >= limits_[k] - slack && out[k] <= limits_[n + k] + slack)) return false;
        }
        return true;
    }

    void add_terms(const std::vector<double>& terms) {
        require(terms.size() == sizeof(Terms) / sizeof(double), "other terms");
        double* out = &model_.terms.rounding;
        std::copy(terms.begin(), terms.end(), out);
        require(model_.terms.batch >= 1.0, "a batch has a row");
    }

    // Rows: parent, entry of q, whether it slides, axis (3), still, with_cos, with_sin, with_q (12 each), multiplier.
    void add_bodies(const Rows& rows) {
        require(rows.shape(1) == 55 && rows.shape(0) > 0, "55 numbers for each body");
        require_finite(rows);
        const auto count = static_cast<std::int64_t>(rows.shape(0));
        for (std::int64_t k = 0; k < count; ++k) {
            const double* row = rows.data() + 55 * k;
            Body body{};
            body.parent = whole(row[0], k == 0 ? -1 : 0, std::max<std::int64_t>(k - 1, -1), "a parent comes first");
            body.column = whole(row[1], -1, model_.dof - 1, "no such entry of q");
            body.slides = row[2] != 0.0;
            std::copy(row + 3, row + 6, body.axis);
            std::copy(row + 6, row + 18, body.still);
            std::copy(row + 18, row + 30, body.with_cos);
            std::copy(row + 30, row + 42, body.with_sin);
            std::copy(row + 42, row + 54, body.with_q);
            body.multiplier = row[54];
            model_.bodies.push_back(body);
        }
    }

    void add_hulls(const std::vector<Rows>& hulls) {
        for (const auto& corners : hulls) {
            require(corners.shape(1) == 3 && corners.shape(0) > 0, "corners of shape (v, 3)");
            require_finite(corners);
            std::vector<std::size_t> all(corners.shape(0));
            for (std::size_t k = 0; k < all.size(); ++k) all[k] = k;
            model_.corners.push_back(padded(corners, all));
            model_.corners.push_back(padded(corners, outermost(corners)));
        }
        for (std::size_t k = 0; k < hulls.size(); ++k) {
            const auto &every = model_.corners[2 * k], &outer = model_.corners[2 * k + 1];
            Hull hull{every.size() / 3, outer.size() / 3, every.data(), outer.data(), {}};
            for (std::size_t i = 0; i < 3; ++i)
                for (std::size_t j = 0; j < hull.padded; ++j)
                    hull.half[i] = std::max(hull.half[i], std::fabs(every[i * hull.padded + j]));
            model_.shapes.push_back(hull);
        }
    }

    // Rows: half lengths (3), disc, ball, radius, hull (-1: none).
    void add_solids(const Rows& rows) {
        require(rows.shape(1) == 7, "7 numbers for each solid");
        require_finite(rows);
        model_.solids.reserve(rows.shape(0));
        for (std::size_t k = 0; k < rows.shape(0); ++k) {
            const double* row = rows.data() + 7 * k;
            Solid solid{};
            std::copy(row, row + 3, solid.half);
            solid.disc = row[3];
            solid.ball = row[4];
            solid.radius = row[5];
            const int hull = whole(row[6], -1, static_cast<std::int64_t>(model_.shapes.size()) - 1, "no such hull");
            solid.hull = hull < 0 ? nullptr : &model_.shapes[static_cast<std::size_t>(hull)];
            model_.solids.push_back(solid);
        }
    }

    // Rows: body, frame (12).
    void add_riders(const Rows& rows) {
        require(rows.shape(1) == 13, "13 numbers for each piece that rides");
        require_finite(rows);
        model_.riding = rows.shape(0);
        for (std::size_t k = 0; k < rows.shape(0); ++k) {
            const double* row = rows.data() + 13 * k;
            Rider rider{};
            rider.body = whole(row[0], 0, static_cast<std::int64_t>(model_.bodies.size()) - 1, "no such body");
            std::copy(row + 1, row + 13, rider.frame);
            model_.riders.push_back(rider);
        }
    }

    // Rotations (9 each); of each piece that stands the number of its own, and where it is.
    void add_standers(const Rows& turns, const Wholes& turn_of, const Rows& positions) {
        require(turns.shape(1) == 9 && positions.shape(1) == 3, "9 numbers for each rotation, 3 for each position");
        require(turn_of.shape(0) == positions.shape(0), "a position for each piece that stands");
        require_finite(turns);
        require_finite(positions);
        model_.turns.assign(turns.data(), turns.data() + 9 * turns.shape(0));
        model_.standers.reserve(positions.shape(0));
        for (std::size_t k = 0; k < positions.shape(0); ++k) {
            const double* at = positions.data() + 3 * k;
            const int turn = whole(turn_of.data()[k], 0, static_cast<std::int64_t>(turns.shape(0)) - 1, "no such rotation");
            model_.standers.push_back({turn, {at[0], at[1], at[2]}});
        }
    }

    // Of each piece the number of its solid, those that ride first.
    void add_solid_of(const Wholes& numbers) {
        require(numbers.shape(0) == model_.riding + model_.standers.size(), "a solid for each piece");
        model_.solid_of.reserve(numbers.shape(0));
        for (std::size_t k = 0; k < numbers.shape(0); ++k)
            model_.solid_of.push_back(whole(numbers.data()[k], 0, static_cast<std::int64_t>(model_.solids.size()) - 1, "no such solid"));
    }

    // Rows: the piece, by ascending number; a body that carries it, its own first; how far it is from that body's axis.
    void add_links(const Rows& rows) {
        require(rows.shape(1) == 3, "3 numbers for each link");
        const auto bodies = static_cast<std::int64_t>(model_.bodies.size());
        std::size_t before = 0;
        for (std::size_t k = 0; k < rows.shape(0); ++k) {
            const double* row = rows.data() + 3 * k;
            const auto number = static_cast<std::size_t>(
                whole(row[0], static_cast<std::int64_t>(before), static_cast<std::int64_t>(model_.riding) - 1, "no such piece"));
            before = number;
            Rider& rider = model_.riders[number];
            if (rider.count == 0) rider.first = k;
            ++rider.count;
            model_.depth = std::max(model_.depth, rider.count);
            model_.links.push_back({whole(row[1], 0, bodies - 1, "no such body"), row[2]});
        }
    }

    // Rows: two pieces, joints that move only the one and only the other.
    void add_pairs(const WholeRows& rows) {
        require(rows.shape(1) == 4, "4 numbers for each pair");
        require(static_cast<std::int64_t>(rows.shape(0)) < MOST_PAIRS, "too many pairs");
        const auto pieces = static_cast<std::int64_t>(model_.solid_of.size()), riding = static_cast<std::int64_t>(model_.riding);
        model_.pairs.reserve(rows.shape(0));
        for (std::size_t k = 0; k < rows.shape(0); ++k) {
            const std::int64_t* row = rows.data() + 4 * k;
            Pair pair{};
            pair.first = whole(row[0], 0, riding - 1, "the first of a pair rides");
            pair.second = whole(row[1], 0, pieces - 1, "no such piece");
            pair.own = steps(row[2], pair.first);
            pair.other = row[1] < riding ? steps(row[3], pair.second) : std::uint16_t{0};
            model_.pairs.push_back(pair);
            roots_.push_back(static_cast<int>(k));
        }
        model_.count = static_cast<int>(model_.pairs.size());
        model_.judged = model_.pairs.size();
    }

    // Rows: the first piece and how many, then the first bundle and how many. Of the bundles of all trees, one after the
    // other: the first member of the tree in it, and how many follow each other. A bundle comes after what is in it.
    void add_trees(const WholeRows& rows, const WholeRows& children) {
        require(rows.shape(1) == 4 && children.shape(1) == 2, "4 numbers for each tree, 2 for each bundle");
        const auto pieces = static_cast<std::int64_t>(model_.solid_of.size()), riding = static_cast<std::int64_t>(model_.riding);
        for (std::size_t k = 0; k < rows.shape(0); ++k) {
            const std::int64_t* row = rows.data() + 4 * k;
            BundleTree tree{};
            tree.leaf = whole(row[0], riding, pieces, "no such piece");
            tree.leaves = whole(row[1], 1, pieces - tree.leaf, "no such piece");
            tree.bundle = whole(row[2], riding, pieces, "no such bundle");
            tree.bundles = whole(row[3], 0, pieces - tree.bundle, "no such bundle");
            tree.children = model_.children.size();
            require(tree.children + static_cast<std::size_t>(tree.bundles) <= children.shape(0), "children of each bundle");
            std::vector<bool> held(static_cast<std::size_t>(tree.size()), false);
            for (int i = 0; i < tree.bundles; ++i) {
                const std::int64_t* own = children.data() + 2 * model_.children.size();
                const int first = whole(own[0], 0, tree.leaves + i - 1, "a bundle comes after what is in it");
                const int count = whole(own[1], 1, tree.leaves + i - first, "a bundle comes after what is in it");
                model_.children.push_back({first, count});
                std::fill_n(held.begin() + first, count, true);
            }
            model_.trees.push_back(tree);
            std::vector<int>& tops = tops_.emplace_back();
            for (int i = 0; i < tree.size(); ++i)
                if (!held[static_cast<std::size_t>(i)]) tops.push_back(i);
        }
        require(model_.children.size() == children.shape(0), "bundles of no tree");
    }

    // Rows: a piece that rides, the tree with whose members it makes pairs, and how many joints move the piece.
    void add_blocks(const WholeRows& rows) {
        require(rows.shape(1) == 3, "3 numbers for each block of pairs");
        auto count = static_cast<std::int64_t>(model_.count);
        for (std::size_t k = 0; k < rows.shape(0); ++k) {
            const std::int64_t* row = rows.data() + 3 * k;
            const int rider = whole(row[0], 0, static_cast<std::int64_t>(model_.riding) - 1, "the first of a pair rides");
            const int tree = whole(row[1], 0, static_cast<std::int64_t>(model_.trees.size()) - 1, "no such tree");
            const auto which = static_cast<std::size_t>(tree);
            const int begin = static_cast<int>(count);
            model_.blocks.push_back({begin, rider, tree, steps(row[2], rider)});
            for (const int top : tops_[which]) roots_.push_back(begin + top);
            model_.judged += static_cast<std::size_t>(model_.trees[which].leaves);
            count += model_.trees[which].size();
            require(count < MOST_PAIRS, "too many pairs");
        }
        model_.count = static_cast<int>(count);
    }

    // Spheres around what rides on each body with more than one piece, and pairs of these that stand for several roots.
    void add_crowds() {
        std::map<int, std::vector<std::size_t>> riders;
        for (std::size_t k = 0; k < model_.riding; ++k) riders[model_.riders[k].body].push_back(k);
        std::map<int, int> sphere;
        std::vector<Rider> spheres;
        std::vector<int> solids;
        for (const auto& [body, pieces] : riders) {
            if (pieces.size() < 2 || body == 0) continue;
            sphere[body] = static_cast<int>(model_.riding + spheres.size());
            solids.push_back(static_cast<int>(model_.solids.size()));
            spheres.push_back(around(pieces));
        }
        const auto more = static_cast<int>(spheres.size()), riding = static_cast<int>(model_.riding);
        model_.riders.insert(model_.riders.end(), spheres.begin(), spheres.end());
        model_.solid_of.insert(model_.solid_of.begin() + riding, solids.begin(), solids.end());
        model_.riding += spheres.size();
        model_.crowd_of.assign(model_.pairs.size(), -1);
        std::map<std::pair<int, int>, std::vector<int>> together;
        for (Pair& pair : model_.pairs)
            if (pair.second >= riding) pair.second += more;
        for (BundleTree& tree : model_.trees) {
            tree.leaf += more;
            tree.bundle += more;
        }
        for (const int k : roots_) {
            const Pair pair = model_.pair(k);
            const auto standing_for = [&](int piece) {
                if (piece >= riding + more) return piece;
                const auto found = sphere.find(model_.riders[static_cast<std::size_t>(piece)].body);
                return found == sphere.end() ? piece : found->second;
            };
            const std::pair<int, int> of{standing_for(pair.first), standing_for(pair.second)};
            if (pair.own + pair.other > 0) together[of].push_back(k);
        }
        for (const auto& [pieces, pairs] : together) {
            if (pairs.size() < 2) continue;
            for (const int k : pairs) {
                const auto plain = static_cast<std::size_t>(k);
                (plain < model_.pairs.size() ? model_.crowd_of[plain] : model_.crowd_of_tree[k]) = static_cast<int>(model_.crowds.size());
            }
            Pair crowd = model_.pair(pairs[0]);
            crowd.first = pieces.first;
            crowd.second = pieces.second;
            crowd.child = crowd.children = 0;
            model_.crowds.push_back(crowd);
        }
    }

    // A sphere around pieces of one body, as a piece.
    Rider around(const std::vector<std::size_t>& pieces) {
        Rider out = model_.riders[pieces[0]];
        const auto radius = [this](std::size_t k) { return model_.solid(static_cast<int>(k)).radius; };
        double low[3], high[3];
        for (int i = 0; i < 3; ++i) {
            low[i] = std::numeric_limits<double>::infinity();
            high[i] = -low[i];
            for (const std::size_t k : pieces) {
                const Rider& piece = model_.riders[k];
                low[i] = std::min(low[i], piece.frame[4 * i + 3] - radius(k));
                high[i] = std::max(high[i], piece.frame[4 * i + 3] + radius(k));
            }
        }
        Solid solid{};
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) out.frame[4 * i + j] = i == j ? 1.0 : 0.0;
            out.frame[4 * i + 3] = 0.5 * (low[i] + high[i]);
        }
        for (const std::size_t k : pieces) {
            const Rider& piece = model_.riders[k];
            double square = 0.0;
            for (int i = 0; i < 3; ++i) {
                const double step = piece.frame[4 * i + 3] - out.frame[4 * i + 3];
                square += step * step;
            }
            solid.radius = std::max(solid.radius, (std::sqrt(square) + radius(k)) * (1.0 + model_.terms.rounding));
        }
        solid.ball = solid.radius;
        model_.solids.push_back(solid);
        out.first = model_.links.size();
        for (std::size_t row = 0; row < out.count; ++row) {
            Link link = model_.links[model_.riders[pieces[0]].first + row];
            for (const std::size_t k : pieces) link.far = std::max(link.far, model_.links[model_.riders[k].first + row].far);
            model_.links.push_back(link);
        }
        return out;
    }

    std::uint16_t steps(std::int64_t value, int rider) const {
        const auto most = static_cast<std::int64_t>(model_.riders[static_cast<std::size_t>(rider)].count);
        return static_cast<std::uint16_t>(whole(value, 0, std::min<std::int64_t>(most, 65535), "no such joint"));
    }

    Curve curve_of(const Rows& waypoints, const Numbers& knots, const Rows& tangents, const Numbers& breaks,
                   const Wholes& lines, const Wholes& blends, const Rows& corners) const {
        const std::size_t n = waypoints.shape(1), count = waypoints.shape(0), pieces = lines.shape(0);
        require(n == static_cast<std::size_t>(model_.dof) && count > 0, "a path of another robot");
        require(knots.shape(0) == count && tangents.shape(0) + 1 == count && tangents.shape(1) == n, "knots of another path");
        require(breaks.shape(0) == pieces + 1 && blends.shape(0) == pieces, "pieces of another path");
        require(corners.shape(1) == 2 + 3 * n, "blends of another path");
        for (const auto* rows : {&waypoints, &tangents, &corners}) require_finite(*rows);
        for (const auto* numbers : {&knots, &breaks}) require_finite(numbers->data(), numbers->shape(0));
        for (std::size_t k = 0; k < pieces; ++k) {
            whole(lines.data()[k], 0, static_cast<std::int64_t>(count) - 2, "no such line");
            whole(blends.data()[k], -1, static_cast<std::int64_t>(corners.shape(0)) - 1, "no such blend");
        }
        return Curve(n, {count, pieces, waypoints.data(), knots.data(), tangents.data(), breaks.data(),
                         lines.data(), blends.data(), corners.data()});
    }
};

// Hulls by themselves: how far they extend along many directions.
class Hulls {
  public:
    explicit Hulls(const std::vector<Rows>& hulls) {
        variant_ = variants().back();
        for (const auto& rows : hulls) {
            require(rows.shape(1) == 3 && rows.shape(0) > 0, "corners of a hull, (v, 3)");
            require_finite(rows);
            std::vector<std::size_t> all(rows.shape(0));
            for (std::size_t i = 0; i < all.size(); ++i) all[i] = i;
            corners_.push_back(padded(rows, all));
        }
    }

    // Directions (k, 3, p), the hull of each column or -1, (p,), and where the heights go, (k, p).
    void extend(const Directions& directions, const Wholes& hulls, const Heights& heights) const {
        const std::size_t count = directions.shape(0), p = directions.shape(2);
        require(directions.shape(1) == 3 && hulls.shape(0) == p, "directions (k, 3, p) and hulls (p,)");
        require(heights.shape(0) == count && heights.shape(1) == p, "room for heights (k, p)");
        for (std::size_t column = 0; column < p; ++column) {
            const int which = whole(hulls.data()[column], -1, static_cast<std::int64_t>(corners_.size()) - 1, "no such hull");
            if (which < 0) continue;
            const auto& corners = corners_[static_cast<std::size_t>(which)];
            const Hull hull{corners.size() / 3, 0, corners.data(), nullptr, {}};
            for (std::size_t k = 0; k < count; ++k) {
                const double* n = directions.data() + 3 * p * k + column;
                heights.data()[p * k + column] = variant_->height(hull, n[0], n[p], n[2 * p]);
            }
        }
    }

  private:
    const Variant* variant_;
    std::vector<std::vector<double>> corners_;
};

}  // namespace

NB_MODULE(_proof, m) {
    nb::set_leak_warnings(false);  // a certifier that lives as long as the process is no leak
    m.def("instruction_sets", [] {
        std::vector<std::string> names;
        for (const auto* found : variants()) names.emplace_back(found->name);
        return names;
    });
    nb::class_<EdgeAnswer>(m, "EdgeAnswer")
        .def_ro("taken", &EdgeAnswer::taken)
        .def_prop_ro("free", [](const EdgeAnswer& answer) { return answer.result.verdict == Verdict::free; })
        .def_prop_ro("verdict", [](const EdgeAnswer& answer) { return static_cast<int>(answer.result.verdict); })
        .def_prop_ro("pair", [](const EdgeAnswer& answer) { return answer.result.pair; })
        .def_prop_ro("s", [](const EdgeAnswer& answer) { return answer.result.s; });
    nb::class_<Hulls>(m, "Hulls")
        .def(nb::init<const std::vector<Rows>&>(), nb::arg("corners"))
        .def("extend", &Hulls::extend, nb::arg("directions"), nb::arg("hulls"), nb::arg("heights"),
             nb::call_guard<nb::gil_scoped_release>());
    nb::class_<Diagram>(m, "Diagram")
        .def("blocked",
             [](Diagram& diagram, double lead, double delay, int finest) {
                 require(std::isfinite(lead) && delay >= 0.0, "seconds");
                 require(0 <= finest && finest <= Diagram::LAST, "as many halvings as there are");
                 std::vector<double> out;
                 {
                     nb::gil_scoped_release release;
                     out = diagram.blocked(lead, delay, finest);
                 }
                 return nb::bytes(static_cast<const void*>(out.data()), out.size() * sizeof(double));
             })
        .def("proven",
             [](Diagram& diagram, int level, const nb::ndarray<bool, nb::ndim<2>, nb::c_contig, nb::device::cpu>& out) {
                 require(0 <= level && level <= Diagram::LAST, "as many halvings as there are");
                 const auto size = std::size_t{1} << level;
                 require(out.shape(0) == size && out.shape(1) == size, "a verdict for each rectangle");
                 nb::gil_scoped_release release;
                 diagram.proven(level, out.data());
             })
        .def_prop_ro("asked", &Diagram::asked)
        .def_prop_ro("rectangles", &Diagram::rectangles);
    nb::class_<Prover>(m, "Prover")
        .def(nb::init<const std::vector<double>&, std::int64_t, const Rows&, const Rows&, const Rows&, const std::vector<Rows>&,
                      const Rows&, const Wholes&, const Rows&, const Wholes&, const Rows&, const WholeRows&, const WholeRows&,
                      const WholeRows&, const WholeRows&, const Rows&, const std::string&>(),
             nb::arg("terms"), nb::arg("dof"), nb::arg("bodies"), nb::arg("riders"), nb::arg("links"), nb::arg("hulls"),
             nb::arg("solids"), nb::arg("solid_of"), nb::arg("turns"), nb::arg("turn_of"), nb::arg("positions"),
             nb::arg("pairs"), nb::arg("trees"), nb::arg("children"), nb::arg("blocks"), nb::arg("limits"),
             nb::arg("variant") = "")
        .def_prop_ro("variant", &Prover::variant)
        .def("prove", &Prover::prove, nb::arg("waypoints"), nb::arg("knots"), nb::arg("tangents"), nb::arg("breaks"),
             nb::arg("lines"), nb::arg("blends"), nb::arg("corners"), nb::arg("spans"),
             nb::arg("roots"), nb::arg("enough"), nb::arg("charge").none(),
             nb::arg("walked").none())
        .def("edge", &Prover::edge)
        .def("tubes", &Prover::tubes)
        .def("diagram", &Prover::diagram, nb::keep_alive<0, 1>())
        .def("boxes", &Prover::boxes)
        .def("clearances", &Prover::clearances)
        .def("near", &Prover::near)
        .def("stretch", &Prover::stretch);
}

}  // namespace proof
