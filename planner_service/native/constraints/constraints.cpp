// Constraints as Python sees them (_core.pyi).
#include "constraints.hpp"

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <utility>

#include "../arrays.hpp"
#include "projector.hpp"

namespace nb = nanobind;

namespace constraints {

namespace {

using arrays::require;
using arrays::Row;
using arrays::Rows;

constexpr std::size_t region_numbers = 37;  // and the reach of each joint

std::size_t body_of(double number, std::size_t bodies) {
    require(number >= 0.0 && number <= static_cast<double>(bodies), "no such body");
    return static_cast<std::size_t>(number);
}

kinematics::Frame frame_of(const double* numbers) {
    kinematics::Frame out;
    std::copy_n(numbers, 9, out.R);
    std::copy_n(numbers + 9, 3, out.p);
    return out;
}

Region region_of(const double* row, std::size_t bodies, std::size_t joints) {
    Region out;
    out.body = body_of(row[0], bodies);
    out.base = body_of(row[1], bodies);
    out.at = frame_of(row + 2);
    out.frame = frame_of(row + 14);
    std::copy_n(row + 26, 3, out.lower);
    std::copy_n(row + 29, 3, out.upper);
    std::copy_n(row + 32, 3, out.room);
    out.chord = row[35];
    out.sine = row[36];
    out.reach.assign(row + region_numbers, row + region_numbers + joints);
    out.turns.assign(row + region_numbers + joints, row + region_numbers + 2 * joints);
    return out;
}

void make(Projector* self, const Rows& table, const Rows& bodies, const Row& lower, const Row& upper, const Rows& regions) {
    kinematics::Arm arm;
    arm.joints = lower.shape(0);
    arm.bodies = table.shape(0);
    require(table.shape(1) == kinematics::Arm::width && bodies.shape(0) == arm.bodies && bodies.shape(1) == 7 &&
                upper.shape(0) == arm.joints && regions.shape(1) == region_numbers + 2 * arm.joints,
            "tables of an arm and its regions");
    Joints joints;
    joints.parent.push_back(-1);
    joints.index.push_back(0);
    joints.slides.push_back(false);
    joints.axis.push_back({0.0, 0.0, 0.0});
    joints.multiplier.push_back(1.0);
    for (std::size_t k = 0; k < arm.bodies; ++k) {
        const double *placed = table.data() + k * kinematics::Arm::width, *row = bodies.data() + 7 * k;
        require(row[0] == placed[0] && row[0] >= 0.0 && row[0] <= static_cast<double>(k), "parents before children");
        require(row[1] == placed[1] && row[1] >= 0.0 && row[1] < static_cast<double>(arm.joints), "no such joint");
        joints.parent.push_back(static_cast<int>(row[0]));
        joints.index.push_back(static_cast<std::size_t>(row[1]));
        joints.slides.push_back(row[2] != 0.0);
        joints.axis.push_back({row[3], row[4], row[5]});
        joints.multiplier.push_back(row[6]);
    }
    arm.table.assign(table.data(), table.data() + table.size());
    arm.lower.assign(lower.data(), lower.data() + arm.joints);
    arm.upper.assign(upper.data(), upper.data() + arm.joints);
    std::vector<Region> placed;
    for (std::size_t k = 0; k < regions.shape(0); ++k)
        placed.push_back(region_of(regions.data() + k * regions.shape(1), arm.bodies, arm.joints));
    new (self) Projector(std::move(arm), std::move(joints), std::move(placed));
}

void require_fit(const Projector& projector, const Configuration& q) {
    require(q.size() == projector.dof(), "a configuration of this arm");
}

}  // namespace

void bind(nb::module_& m) {
    nb::class_<Projector>(m, "Projector")
        .def("__init__", &make)
        .def("share",
             [](Projector& self, const Configuration& q) {
                 require_fit(self, q);
                 return self.share(q.data());
             })
        .def("project",
             [](Projector& self, Configuration q) -> nb::object {
                 require_fit(self, q);
                 return self.project(q) ? nb::object(nb::tuple(nb::cast(q))) : nb::none();
             })
        .def("keeps",
             [](Projector& self, const Configuration& a, const Configuration& b) {
                 require_fit(self, a);
                 require_fit(self, b);
                 return self.keeps(a, b);
             })
        .def("step",
             [](Projector& self, const Configuration& start, Configuration end, const Configuration& target, double distance,
                double step, bool fixed) -> nb::object {
                 for (const Configuration* q : {&start, &std::as_const(end), &target}) require_fit(self, *q);
                 return self.step(start, end, target, distance, step, fixed) ? nb::object(nb::tuple(nb::cast(end))) : nb::none();
             })
        .def("take", &Projector::take);
}

}  // namespace constraints
