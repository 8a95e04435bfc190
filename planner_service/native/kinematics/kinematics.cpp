// Inverse kinematics as Python sees it (_core.pyi).
#include "kinematics.hpp"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <thread>

#include "../arrays.hpp"
#include "complete.hpp"
#include "descent.hpp"
#include "line.hpp"

namespace nb = nanobind;

namespace kinematics {

namespace {

using arrays::array_of;
using arrays::NumberRows;
using arrays::Numbers;
using arrays::require;
using arrays::Row;
using arrays::Rows;

nb::object matrix_of(std::vector<double> values, std::size_t columns) {
    const std::size_t rows = values.size() / columns;
    return array_of<double>(std::move(values), {rows, columns});
}

// That of each of ``count`` the rows from one offset to the next are among ``rows``.
void require_offsets(const Numbers& offsets, std::size_t count, std::size_t rows) {
    require(offsets.shape(0) == count + 1 && offsets.data()[0] == 0, "offsets from 0");
    for (std::size_t k = 0; k < count; ++k) require(offsets.data()[k] <= offsets.data()[k + 1], "offsets in order");
    require(offsets.data()[count] == static_cast<std::int64_t>(rows), "offsets up to the last row");
}

Pose pose_of(const std::vector<double>& numbers) {
    require(numbers.size() == 7, "a position and a quaternion");
    Pose out;
    std::copy_n(numbers.begin(), 3, out.position);
    std::copy_n(numbers.begin() + 3, 4, out.quaternion);
    return out;
}

// The bodies of a robot, from BodyTree.table.
Arm bodies_of(const Rows& table, std::size_t joints) {
    require(table.shape(1) == Arm::width, "a table of bodies");
    Arm out;
    out.joints = joints;
    out.bodies = table.shape(0);
    for (std::size_t k = 0; k < out.bodies; ++k) {
        const double* row = table.data() + k * Arm::width;
        require(row[0] >= 0.0 && row[0] <= static_cast<double>(k), "parents before children");
        require(row[1] >= 0.0 && row[1] < static_cast<double>(joints), "no such joint");
    }
    out.table.assign(table.data(), table.data() + table.size());
    return out;
}

nb::object body_poses(const Rows& table, const Row& q) {
    const Arm arm = bodies_of(table, q.shape(0));
    for (std::size_t k = 0; k < arm.joints; ++k) require(std::isfinite(q.data()[k]), "finite joint values");
    std::vector<Frame> frames(arm.bodies + 1);
    place(arm, q.data(), frames);
    std::vector<double> out;
    for (const Frame& frame : frames) {
        out.insert(out.end(), frame.R, frame.R + 9);
        out.insert(out.end(), frame.p, frame.p + 3);
    }
    return matrix_of(std::move(out), 12);
}

nb::object body_poses_batch(const Rows& table, const Rows& q, bool portable) {
    const Arm arm = bodies_of(table, q.shape(1));
    const std::size_t rows = q.shape(0);
    for (std::size_t k = 0; k < q.size(); ++k) require(!std::isinf(q.data()[k]), "finite joint values");
    std::vector<double> out((arm.bodies + 1) * 12 * rows);
    {
        nb::gil_scoped_release released;
        std::vector<Frame> frames(arm.bodies + 1);
        for (std::size_t m = 0; m < rows; ++m) {
            place(arm, q.data() + m * arm.joints, frames, portable ? Sines::PORTABLE : Sines::LIBRARY);
            for (std::size_t body = 0; body <= arm.bodies; ++body)
                for (std::size_t k = 0; k < 12; ++k) {  // of four columns: the three of the rotation, and the position
                    const std::size_t column = k / 3, row = k % 3;
                    const Frame& frame = frames[body];
                    out[(body * 12 + k) * rows + m] = column < 3 ? frame.R[3 * row + column] : frame.p[row];
                }
        }
    }
    return array_of<double>(std::move(out), {arm.bodies + 1, 4, 3, rows});
}

class ToolArm {
  public:
    ToolArm(const Rows& table, std::size_t tool_body, const Rows& chain, const Row& tool, double scale, const Row& lower,
            const Row& upper, const std::vector<double>& closed_form, nb::callable hypot)
        : hypot_(std::move(hypot)) {
        arm_ = bodies_of(table, lower.shape(0));
        require(tool_body <= arm_.bodies && tool.shape(0) == 12 && chain.shape(1) == 7 && upper.shape(0) == arm_.joints,
                "tables of an arm");
        arm_.tool_body = tool_body;
        for (std::size_t k = 0; k < chain.shape(0); ++k) {
            const double* row = chain.data() + 7 * k;
            require(row[0] >= 0.0 && row[0] <= static_cast<double>(arm_.bodies), "no such body");
            require(row[1] >= 0.0 && row[1] < static_cast<double>(arm_.joints), "no such joint");
            arm_.chain.push_back({static_cast<std::size_t>(row[0]), static_cast<std::size_t>(row[1]), row[2] != 0.0, {row[3], row[4], row[5]}, row[6]});
        }
        std::copy_n(tool.data(), 12, arm_.tool);
        arm_.scale = scale;
        arm_.lower.assign(lower.data(), lower.data() + arm_.joints);
        arm_.upper.assign(upper.data(), upper.data() + arm_.joints);
        if (!closed_form.empty()) {
            require(closed_form.size() == ClosedForm::numbers && arm_.joints == 6, "numbers of a closed form");
            closed_form_.emplace(closed_form.data());
        }
    }

    std::pair<nb::object, std::vector<bool>> descend(const Row& target, const Rows& starts, const Row& lower, const Row& upper,
                                                    int steps) const {
        const auto fits = [this](std::size_t size) { return size == arm_.joints; };
        require(target.shape(0) == 12 && fits(starts.shape(1)) && fits(lower.shape(0)) && fits(upper.shape(0)),
                "a pose, and configurations and bounds of this arm");
        std::vector<double> out(starts.data(), starts.data() + starts.size());
        std::vector<bool> arrived;
        {
            nb::gil_scoped_release released;
            std::vector<Frame> frames(arm_.bodies + 1);
            for (std::size_t k = 0; k < starts.shape(0); ++k)
                arrived.push_back(kinematics::descend(arm_, target.data(), lower.data(), upper.data(), steps,
                                                      out.data() + k * arm_.joints, frames));
        }
        return {matrix_of(std::move(out), arm_.joints), std::move(arrived)};
    }

    std::vector<std::vector<double>> solve(const std::vector<double>& pose, const std::vector<std::vector<double>>& near) const {
        require(closed_form_.has_value(), "an arm with a closed form");
        for (const auto& q : near) require(q.size() == arm_.joints, "configurations of this arm");
        return kinematics::solve(arm_, *closed_form_, pose_of(pose), near, hypot());
    }

    bool determined(const std::vector<double>& pose) const {
        require(closed_form_.has_value(), "an arm with a closed form");
        return kinematics::determined(arm_, *closed_form_, pose_of(pose), hypot());
    }

    std::tuple<nb::object, std::vector<double>, std::optional<double>, std::vector<double>> walk(
        const std::vector<double>& begin, const std::vector<double>& end, const Row& start, int points) const {
        require(start.shape(0) == arm_.joints && points >= 2, "a configuration of this arm, and at least two points");
        Walked found = kinematics::walk(arm_, closed_form_ ? &*closed_form_ : nullptr, pose_of(begin), pose_of(end),
                                        start.data(), points, hypot());
        return {matrix_of(std::move(found.waypoints), arm_.joints), found.fractions, found.stop, found.beyond};
    }

    std::vector<int> thinned(const Rows& waypoints, const std::vector<int>& stops) const {
        const int rows = static_cast<int>(waypoints.shape(0));
        require(waypoints.shape(1) == arm_.joints, "configurations of this arm");
        for (const int stop : stops) require(0 <= stop && stop < rows, "no such row");
        return kinematics::thinned(arm_, waypoints.data(), rows, stops, hypot());
    }

  private:
    Arm arm_;
    std::optional<ClosedForm> closed_form_;
    nb::callable hypot_;

    Hypot hypot() const {
        return [this](const double* v, int count) {
            return nb::cast<double>(count == 2 ? hypot_(v[0], v[1]) : hypot_(v[0], v[1], v[2]));
        };
    }
};

// Solids that collide: of each the link, kind, size (3), frame (12), and the ball around it (4); balls and planes from offset to
// offset, (4) each; and pairs.
class Obstructed {
  public:
    Obstructed(const Rows& solids, const Numbers& ball_offsets, const Rows& balls, const Numbers& plane_offsets, const Rows& planes,
               const NumberRows& pairs)
        : obstruction_(solids_of(solids, ball_offsets, balls, plane_offsets, planes), pairs_of(pairs, solids.shape(0))) {}

    const Obstruction& operator*() const { return obstruction_; }

  private:
    Obstruction obstruction_;

    static std::vector<Solid> solids_of(const Rows& solids, const Numbers& ball_offsets, const Rows& balls, const Numbers& plane_offsets,
                                        const Rows& planes) {
        const std::size_t count = solids.shape(0);
        require(solids.shape(1) == 21 && balls.shape(1) == 4 && planes.shape(1) == 4, "rows of solids, balls and planes");
        require_offsets(ball_offsets, count, balls.shape(0));
        require_offsets(plane_offsets, count, planes.shape(0));
        std::vector<Solid> out(count);
        for (std::size_t k = 0; k < count; ++k) {
            const double* row = solids.data() + 21 * k;
            require(row[0] >= 0.0 && row[0] <= 16.0 && row[1] >= 0.0 && row[1] <= 4.0, "a link and a kind");
            Solid& solid = out[k];
            solid.link = static_cast<std::size_t>(row[0]);
            solid.kind = static_cast<Solid::Kind>(static_cast<int>(row[1]));
            std::copy_n(row + 2, 3, solid.size);
            std::copy_n(row + 5, 12, solid.rows);
            solid.middle = {row[17], row[18], row[19]};
            solid.radius = row[20];
            for (std::int64_t i = ball_offsets.data()[k]; i < ball_offsets.data()[k + 1]; ++i) {
                const double* ball = balls.data() + 4 * i;
                solid.balls.push_back({{ball[0], ball[1], ball[2]}, ball[3]});
            }
            for (std::int64_t i = plane_offsets.data()[k]; i < plane_offsets.data()[k + 1]; ++i) {
                const double* plane = planes.data() + 4 * i;
                solid.planes.push_back({{plane[0], plane[1], plane[2]}, plane[3]});
            }
            require((solid.kind == Solid::Kind::PLANES) == !solid.planes.empty(), "planes of what has planes");
        }
        return out;
    }

    static std::vector<std::pair<std::size_t, std::size_t>> pairs_of(const NumberRows& pairs, std::size_t count) {
        require(pairs.shape(1) == 2, "pairs");
        std::vector<std::pair<std::size_t, std::size_t>> out;
        for (std::size_t k = 0; k < pairs.shape(0); ++k) {
            const std::int64_t a = pairs.data()[2 * k], b = pairs.data()[2 * k + 1];
            require(a >= 0 && b >= 0 && a < static_cast<std::int64_t>(count) && b < static_cast<std::int64_t>(count), "no such solid");
            out.emplace_back(a, b);
        }
        return out;
    }
};

// An arm whose configurations for a pose are found completely: of each joint from the base to the tool whether it slides, its
// entry of q, its multiplier, and its axis and a point on it at q = 0, where the tool has rows ``tool``.
class ClosedLoop {
  public:
    ClosedLoop(const Rows& joints, const Row& tool, const Row& lower, const Row& upper) {
        const std::size_t m = joints.shape(0);
        loop_.n = lower.shape(0);
        require(joints.shape(1) == 9 && m >= 1 && m <= 16 && tool.shape(0) == 12, "a table of up to 16 joints and a tool");
        require(loop_.n >= 1 && loop_.n <= 7 && upper.shape(0) == loop_.n, "bounds of up to seven joints");
        for (std::size_t j = 0; j < loop_.n; ++j) domain_.push_back({lower.data()[j], upper.data()[j]});
        std::copy_n(tool.data(), 12, loop_.tool);
        Vector last{};
        const auto reached = [&](const Vector& p) {
            loop_.longest += std::sqrt((p[0] - last[0]) * (p[0] - last[0]) + (p[1] - last[1]) * (p[1] - last[1]) +
                                       (p[2] - last[2]) * (p[2] - last[2]));
            last = p;
        };
        for (std::size_t k = 0; k < m; ++k) {
            const double* row = joints.data() + 9 * k;
            require(row[1] >= 0.0 && row[1] < static_cast<double>(loop_.n), "no such joint");
            const Joint joint{row[0] != 0.0, static_cast<std::size_t>(row[1]), row[2], {row[3], row[4], row[5]}, {row[6], row[7], row[8]}};
            const Span& span = domain_[joint.q];
            const double far = std::fabs(joint.multiplier) * std::max(std::fabs(span.low), std::fabs(span.high));
            require(far <= 1000.0, "joint values within 1000");
            loop_.strokes.push_back(joint.slides ? far + 2.0 * slide_room * std::fabs(joint.multiplier) : 0.0);
            loop_.steepest = std::max(loop_.steepest, std::fabs(joint.multiplier));
            loop_.longest += loop_.strokes.back();
            loop_.joints.push_back(joint);
            reached(joint.point);
        }
        reached({loop_.tool[3], loop_.tool[7], loop_.tool[11]});
    }

    // Of an arm with one joint more than equations: arcs (k, 2 + 4 n) of joint, reach, q, direction and half widths of both boxes;
    // boxes in doubt (u, 2, n); boxes seen.
    std::tuple<nb::object, nb::object, int> arcs(const Row& rows, const std::vector<double>& axis, int wanted, double position_error,
                                                 double turn_error, int most_boxes) const {
        std::vector<Arc> found;
        auto [none, left, boxes, near] = solve_with(rows, axis, wanted, position_error, turn_error, most_boxes, nullptr, &found);
        std::vector<double> table;
        for (const Arc& arc : found) {
            table.push_back(static_cast<double>(arc.joint));
            table.push_back(arc.reach);
            for (const auto* row : {&arc.q, &arc.along, &arc.box, &arc.lone}) table.insert(table.end(), row->begin(), row->end());
        }
        return {array_of<double>(std::move(table), {found.size(), 2 + 4 * loop_.n}), left, boxes};
    }

    // ``solve``, and what shows it: steps (s, 6), sums (t, 14), equations (e, 6) and what they follow (f, 5); see ``Trail``.
    std::tuple<nb::object, nb::object, int, nb::object, nb::object, nb::object, nb::object, nb::object> shown(
        const Row& rows, const std::vector<double>& axis, int wanted, double position_error, double turn_error, int most_boxes) const {
        Trail trail;
        auto [found, left, boxes, near] = solve_with(rows, axis, wanted, position_error, turn_error, most_boxes, &trail);
        const auto table = [](std::vector<double>& from, std::size_t width) {
            const std::size_t count = from.size() / width;
            return array_of<double>(std::move(from), {count, width});
        };
        return {found, left, boxes, near, table(trail.steps, 6), table(trail.sums, 14), table(trail.equations, 6), table(trail.followed, 5)};
    }

    // Solutions (k, 5, n): q, the box, and the box in which it is alone, lows before highs; boxes in doubt (u, 2, n); boxes seen;
    // configurations in boxes in doubt whose tool is at the target (w, n).
    std::tuple<nb::object, nb::object, int, nb::object> solve(const Row& rows, const std::vector<double>& axis, int wanted, double position_error,
                                                  double turn_error, int most_boxes) const {
        return solve_with(rows, axis, wanted, position_error, turn_error, most_boxes, nullptr);
    }

    // A configuration (1, n) of a box of joint ranges (2, n) whose tool is at the target, or none (0, n).
    nb::object reached_in(const Row& rows, const std::vector<double>& axis, int wanted, double position_error, double turn_error,
                          const Rows& box) const {
        require(box.shape(0) == 2 && box.shape(1) == loop_.n, "a box of the joints");
        Box room(loop_.n);
        for (std::size_t j = 0; j < loop_.n; ++j) room[j] = {box.data()[j], box.data()[loop_.n + j]};
        const Target target = target_of(rows, axis, wanted, position_error, turn_error);
        std::optional<std::vector<double>> found = kinematics::reached_in(loop_, target, domain_, room);
        const std::size_t count = found ? 1 : 0;
        return array_of<double>(found ? std::move(*found) : std::vector<double>{}, {count, loop_.n});
    }

    // ``cover`` for many boxes of tool positions: their centres (k, 3), half their sides, rows of the orientation that is wanted;
    // of each the boxes of joint ranges (b, 2, n) that its configurations are in, ``from`` offset to offset. By how many threads
    // that is done changes nothing.
    //
    // Returns for each whether some of the boxes were dropped because they collide; offsets and boxes that are left; offsets and
    // configurations whose tool is in it.
    std::tuple<nb::object, nb::object, nb::object, nb::object, nb::object> cover(
        const Rows& centres, const Row& half, const Row& rows, const std::vector<double>& axis, int wanted, std::pair<double, double> errors,
        const Numbers& offsets, const arrays::Array<double, 3>& from, const Obstructed* obstructed, double width, std::pair<int, int> most,
        int most_near, int threads) const;

  private:
    static Target target_of(const Row& rows, const std::vector<double>& axis, int wanted, double position_error, double turn_error) {
        require(rows.shape(0) == 12 && axis.size() == 3 && wanted >= 0 && wanted <= 2, "a target");
        Target target;
        target.wanted = static_cast<Wanted>(wanted);
        std::copy_n(rows.data(), 12, target.rows);
        target.axis = {axis[0], axis[1], axis[2]};
        target.position_error = position_error;
        target.turn_error = turn_error;
        return target;
    }

    std::tuple<nb::object, nb::object, int, nb::object> solve_with(const Row& rows, const std::vector<double>& axis, int wanted, double position_error,
                                                       double turn_error, int most_boxes, Trail* trail,
                                                       std::vector<Arc>* arcs = nullptr) const {
        const Target target = target_of(rows, axis, wanted, position_error, turn_error);
        std::vector<double> solutions, unresolved;
        Complete found;
        {
            nb::gil_scoped_release released;
            found = solve_complete(loop_, target, domain_, most_boxes, trail);
        }
        if (arcs != nullptr) *arcs = std::move(found.arcs);
        const auto append = [](std::vector<double>& to, const Box& box) {
            for (const Span& span : box) to.push_back(span.low);
            for (const Span& span : box) to.push_back(span.high);
        };
        for (const Solution& one : found.solutions) {
            solutions.insert(solutions.end(), one.q.begin(), one.q.end());
            append(solutions, one.box);
            append(solutions, one.lone);
        }
        for (const Box& box : found.unresolved) append(unresolved, box);
        std::vector<double> near;
        for (const std::vector<double>& q : found.near) near.insert(near.end(), q.begin(), q.end());
        return {array_of<double>(std::move(solutions), {found.solutions.size(), 5, loop_.n}),
                array_of<double>(std::move(unresolved), {found.unresolved.size(), 2, loop_.n}), found.boxes,
                array_of<double>(std::move(near), {found.near.size(), loop_.n})};
    }

    Loop loop_;
    Box domain_;
};

std::tuple<nb::object, nb::object, nb::object, nb::object, nb::object> ClosedLoop::cover(
    const Rows& centres, const Row& half, const Row& rows, const std::vector<double>& axis, int wanted, std::pair<double, double> errors,
    const Numbers& offsets, const arrays::Array<double, 3>& from, const Obstructed* obstructed, double width, std::pair<int, int> most,
    int most_near, int threads) const {
    const std::size_t count = centres.shape(0), n = loop_.n;
    require(centres.shape(1) == 3 && half.shape(0) == 3 && rows.shape(0) == 12 && axis.size() == 3, "boxes of positions");
    require(wanted >= 0 && wanted <= 2 && most.first >= 1 && most.second >= 1 && most_near >= 0 && threads >= 1, "limits of a cover");
    require(from.shape(1) == 2 && from.shape(2) == n, "boxes of the joints");
    require_offsets(offsets, count, from.shape(0));
    std::vector<Cover> found(count);
    {
        nb::gil_scoped_release released;
        std::atomic<std::size_t> next{0};
        const auto work = [&] {
            for (std::size_t k = next++; k < count; k = next++) {
                Target target;
                target.wanted = static_cast<Wanted>(wanted);
                std::copy_n(rows.data(), 12, target.rows);
                target.axis = {axis[0], axis[1], axis[2]};
                target.turn_error = errors.second;
                double square = 0.0;
                for (std::size_t i = 0; i < 3; ++i) {
                    target.rows[4 * i + 3] = centres.data()[3 * k + i];
                    target.position_errors[i] = half.data()[i] + errors.first;
                    square += target.position_errors[i] * target.position_errors[i];
                }
                target.position_error = std::sqrt(square) * (1.0 + 1e-15);
                std::vector<Box> boxes;
                for (std::int64_t b = offsets.data()[k]; b < offsets.data()[k + 1]; ++b) {
                    Box box(n);
                    for (std::size_t j = 0; j < n; ++j) box[j] = {from.data()[2 * n * b + j], from.data()[2 * n * b + n + j]};
                    boxes.push_back(std::move(box));
                }
                const CoverLimits limits{width, static_cast<std::size_t>(most.first), most.second, static_cast<std::size_t>(most_near)};
                found[k] = kinematics::cover(loop_, target, domain_, boxes, obstructed == nullptr ? nullptr : &**obstructed, limits);
            }
        };
        std::vector<std::thread> others;
        for (int t = 1; t < threads; ++t) others.emplace_back(work);
        work();
        for (std::thread& other : others) other.join();
    }
    std::vector<std::uint8_t> dropped;
    std::vector<std::int64_t> box_offsets{0}, near_offsets{0};
    std::vector<double> boxes, near;
    for (const Cover& one : found) {
        dropped.push_back(one.obstructed ? 1 : 0);
        for (const Box& box : one.boxes) {
            for (const Span& span : box) boxes.push_back(span.low);
            for (const Span& span : box) boxes.push_back(span.high);
        }
        for (const std::vector<double>& q : one.near) near.insert(near.end(), q.begin(), q.end());
        box_offsets.push_back(static_cast<std::int64_t>(boxes.size() / (2 * n)));
        near_offsets.push_back(static_cast<std::int64_t>(near.size() / n));
    }
    const std::size_t left = boxes.size() / (2 * n), reached = near.size() / n;
    return {array_of<std::uint8_t>(std::move(dropped), {count}), array_of<std::int64_t>(std::move(box_offsets), {count + 1}),
            array_of<double>(std::move(boxes), {left, 2, n}), array_of<std::int64_t>(std::move(near_offsets), {count + 1}),
            array_of<double>(std::move(near), {reached, n})};
}

}  // namespace

void bind(nb::module_& m) {
    m.def("body_poses", &body_poses);
    m.def("body_poses_batch", &body_poses_batch);
    nb::class_<ToolArm>(m, "ToolArm")
        .def(nb::init<const Rows&, std::size_t, const Rows&, const Row&, double, const Row&, const Row&,
                      const std::vector<double>&, nb::callable>())
        .def("descend", &ToolArm::descend)
        .def("solve", &ToolArm::solve)
        .def("determined", &ToolArm::determined)
        .def("walk", &ToolArm::walk)
        .def("thinned", &ToolArm::thinned);
    nb::class_<ClosedLoop>(m, "ClosedLoop")
        .def(nb::init<const Rows&, const Row&, const Row&, const Row&>())
        .def("solve", &ClosedLoop::solve)
        .def("arcs", &ClosedLoop::arcs)
        .def("shown", &ClosedLoop::shown)
        .def("reached_in", &ClosedLoop::reached_in)
        .def("cover", &ClosedLoop::cover, nb::arg("centres"), nb::arg("half"), nb::arg("rows"), nb::arg("axis"), nb::arg("wanted"), nb::arg("errors"),
             nb::arg("offsets"), nb::arg("boxes"), nb::arg("obstructed").none(), nb::arg("width"), nb::arg("most"), nb::arg("most_near"),
             nb::arg("threads"));
    nb::class_<Obstructed>(m, "Obstructed")
        .def(nb::init<const Rows&, const Numbers&, const Rows&, const Numbers&, const Rows&, const NumberRows&>());
}

}  // namespace kinematics
