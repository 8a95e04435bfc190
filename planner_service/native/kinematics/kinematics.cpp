// Inverse kinematics as Python sees it (_core.pyi).
#include "kinematics.hpp"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "../arrays.hpp"
#include "descent.hpp"
#include "line.hpp"

namespace nb = nanobind;

namespace kinematics {

namespace {

using arrays::array_of;
using arrays::require;
using arrays::Row;
using arrays::Rows;

nb::object matrix_of(std::vector<double> values, std::size_t columns) {
    const std::size_t rows = values.size() / columns;
    return array_of<double>(std::move(values), {rows, columns});
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
}

}  // namespace kinematics
