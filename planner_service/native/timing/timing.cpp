// Timing as Python sees it (_core.pyi).
#include "timing.hpp"

#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <tuple>

#include "../arrays.hpp"
#include "inverse_dynamics.hpp"
#include "law.hpp"
#include "setpoint.hpp"
#include "tool_speed.hpp"
#include "two_passes.hpp"
#include "underway.hpp"

namespace nb = nanobind;

namespace timing {

namespace {

using arrays::array_of;
using arrays::Numbers;
using arrays::require;
using Column = arrays::Row;
using arrays::Rows;

nb::object passes(const Rows& first, const Rows& second, const Rows& constant, const Column& limit, const Column& squares, const Column& points,
                  double entry) {
    const std::size_t count = points.shape(0), columns = limit.shape(0);
    require(count >= 2 && squares.shape(0) == count, "a square for each of at least two points");
    for (const Rows* rows : {&first, &second, &constant})
        require(rows->shape(0) == count && rows->shape(1) == columns, "a row for each point, a column for each limit");
    const Grid grid{columns, count, first.data(), second.data(), constant.data(), limit.data(), squares.data(), points.data()};
    nb::gil_scoped_release released;
    std::vector<double> speeds = two_passes(grid, entry);
    nb::gil_scoped_acquire acquired;
    return array_of<double>(std::move(speeds), {speeds.size()});
}

// The tables of a path, checked, so that no index leads outside them. They live as long as the arrays they are of.
Path path_of(const Rows& waypoints, const Column& knots, const Rows& tangents, const Column& breaks, const Numbers& lines,
             const Numbers& rows, const Rows& blends) {
    const std::size_t n = waypoints.shape(1), points = waypoints.shape(0), pieces = lines.shape(0);
    require(points >= 1 && knots.shape(0) == points && tangents.shape(0) + 1 == points && tangents.shape(1) == n,
            "a knot for each waypoint, a tangent for each line");
    require(breaks.shape(0) == pieces + 1 && rows.shape(0) == pieces && blends.shape(1) == 2 + 3 * n, "tables of a path");
    for (std::size_t k = 0; k < pieces; ++k) {
        require(lines.data()[k] >= 0 && lines.data()[k] + 1 < static_cast<std::int64_t>(points), "no such line");
        require(rows.data()[k] < static_cast<std::int64_t>(blends.shape(0)), "no such blend");
    }
    return {n, points, pieces, waypoints.data(), knots.data(), tangents.data(), breaks.data(), lines.data(), rows.data(), blends.data()};
}

Limits limits_of(const Path& path, const Column& velocity, const Column& acceleration, const Column& jerk) {
    for (const Column* row : {&velocity, &acceleration, &jerk}) require(row->shape(0) == path.joints, "a limit for each joint");
    return {velocity.data(), acceleration.data(), jerk.data()};
}

// Waypoints between the first and the last, in order.
std::vector<std::size_t> inner_waypoints(const Path& path, const std::vector<std::size_t>& given) {
    for (std::size_t k = 0; k < given.size(); ++k)
        require((k == 0 ? 0 : given[k - 1]) < given[k] && given[k] + 1 < path.waypoint_count, "inner waypoints in order");
    return given;
}

// The tables of a path and of a motion along it.
struct Trajectory {
    Path path;
    Motion motion;
    std::vector<Rows> kept_rows;  // the tables live as long as this
    std::vector<Column> kept_columns;
    std::vector<Numbers> kept_numbers;

    Trajectory(const Rows& waypoints, const Column& knots, const Rows& tangents, const Column& breaks, const Numbers& lines,
               const Numbers& rows, const Rows& blends, const Column& durations, const Rows& coefficients, const Column& times,
               const Column& ends, const Numbers& geometry)
        : path(path_of(waypoints, knots, tangents, breaks, lines, rows, blends)) {
        const std::size_t count = durations.shape(0);
        require(coefficients.shape(0) == count && coefficients.shape(1) == 4 && times.shape(0) == count + 1 &&
                    ends.shape(0) == count && geometry.shape(0) == count,
                "tables of a motion");
        for (std::size_t k = 0; k < count; ++k)
            require(geometry.data()[k] >= 0 && geometry.data()[k] < static_cast<std::int64_t>(path.pieces), "no such piece");
        for (const auto* table : {&waypoints, &tangents, &blends, &coefficients}) kept_rows.push_back(*table);
        for (const auto* table : {&knots, &breaks, &durations, &times, &ends}) kept_columns.push_back(*table);
        for (const auto* table : {&lines, &rows, &geometry}) kept_numbers.push_back(*table);
        motion = {count, durations.data(), coefficients.data(), times.data(), ends.data(), geometry.data()};
    }
};

Arm arm_of(const Rows& table, std::size_t tool_body, const std::array<double, 3>& tool, std::size_t joints) {
    require(table.shape(1) == Arm::width && tool_body <= table.shape(0), "a robot's table of bodies");
    for (std::size_t k = 0; k < table.shape(0); ++k) {
        const double* row = table.data() + k * Arm::width;
        require(row[0] >= 0.0 && row[0] <= static_cast<double>(k), "parents before children");
        require(row[1] >= 0.0 && row[1] < static_cast<double>(joints), "no such joint");
    }
    return {table.shape(0), table.data(), tool_body, {tool[0], tool[1], tool[2]}};
}

nb::object torques(const Rows& table, const Rows& masses, const Rows& q, const Rows& qd, const Rows& qdd, const Column& gravity) {
    const std::size_t n = q.shape(1), count = q.shape(0), cases = gravity.shape(0), bodies = table.shape(0) + 1;
    arm_of(table, 0, {}, n);  // checks the table
    require(masses.shape(0) == bodies && masses.shape(1) == 13, "a mass, a centre and a tensor for each body and the base");
    for (const Rows* rows : {&qd, &qdd}) require(rows->shape(0) == cases * count && rows->shape(1) == n, "rates in each case");
    kinematics::Arm arm;
    arm.joints = n, arm.bodies = table.shape(0);
    arm.table.assign(table.data(), table.data() + table.shape(0) * table.shape(1));
    std::vector<BodyInertia> inertias(bodies);
    for (std::size_t k = 0; k < bodies; ++k) {
        const double* row = masses.data() + 13 * k;
        inertias[k].mass = row[0];
        std::copy(row + 1, row + 4, inertias[k].centre);
        std::copy(row + 4, row + 13, inertias[k].tensor);
    }
    nb::gil_scoped_release released;
    std::vector<double> out = inverse_dynamics(arm, inertias, count, cases, q.data(), qd.data(), qdd.data(), gravity.data());
    nb::gil_scoped_acquire acquired;
    return array_of<double>(std::move(out), {cases, count, n});
}

// What ``tell`` says of what is made without the interpreter: None for what is left to Python, words where a law fails.
template <class Make, class Tell>
nb::object unless_unusual(Make make, Tell tell) {
    std::optional<decltype(make())> made;
    std::string failed;
    {
        const nb::gil_scoped_release released;
        try {
            made.emplace(make());
        } catch (const Unusual&) {
        } catch (const Failed& failure) {
            failed = failure.what();
        }
    }
    if (made) return tell(*made);
    return failed.empty() ? nb::object(nb::none()) : nb::cast(failed);
}

// Rows of five numbers.
nb::object table_of(const std::vector<Row>& rows) {
    std::vector<double> out;
    out.reserve(5 * rows.size());
    for (const Row& row : rows) out.insert(out.end(), {row.seconds, row.c0, row.c1, row.c2, row.c3});
    return array_of<double>(std::move(out), {rows.size(), 5});
}

// The arrays of a motion, but not of its path.
nb::object motion_of(TimedPath& timed) {
    const std::size_t count = timed.durations.size();
    return nb::make_tuple(array_of<const double>(std::move(timed.durations), {count}),
                          array_of<const double>(std::move(timed.coefficients), {count, 4}),
                          array_of<const double>(std::move(timed.knots), {count + 1}),
                          array_of<const double>(std::move(timed.ends), {count}),
                          array_of<const std::int64_t>(std::move(timed.geometry), {count}), timed.dilation);
}

// ``Underway`` with the arrays that it is of.
struct KeptUnderway {
    Underway motion;
    std::vector<Rows> kept_rows;
    std::vector<Column> kept_columns;
    std::vector<Numbers> kept_numbers;

    KeptUnderway(const Rows& waypoints, const Column& knots, const Rows& tangents, const Column& breaks, const Numbers& lines,
                 const Numbers& rows, const Rows& blends, const Column& durations, const Rows& coefficients, const Column& times,
                 const Column& ends, double begin, double end, double splice) {
        const std::size_t count = durations.shape(0);
        require(coefficients.shape(0) == count && coefficients.shape(1) == 4 && times.shape(0) == count + 1 &&
                    ends.shape(0) == count,
                "tables of a motion");
        for (const auto* table : {&waypoints, &tangents, &blends, &coefficients}) kept_rows.push_back(*table);
        for (const auto* table : {&knots, &breaks, &durations, &times, &ends}) kept_columns.push_back(*table);
        for (const auto* table : {&lines, &rows}) kept_numbers.push_back(*table);
        motion = {path_of(waypoints, knots, tangents, breaks, lines, rows, blends),
                  {count, durations.data(), coefficients.data(), times.data(), ends.data(), nullptr}, begin, end, splice};
    }
};

std::tuple<double, std::size_t, double> as_tuple(const Peak& peak) { return {peak.ratio, peak.joint, peak.time}; }

}  // namespace

void bind(nb::module_& m) {
    m.def("two_passes", &passes);
    m.def("inverse_dynamics", &torques);
    nb::class_<Trajectory>(m, "TrajectoryTables")
        .def(nb::init<const Rows&, const Column&, const Rows&, const Column&, const Numbers&, const Numbers&, const Rows&, const Column&,
                      const Rows&, const Column&, const Column&, const Numbers&>())
        .def("peaks",
             [](const Trajectory& self, const Column& velocity, const Column& acceleration, const Column& jerk) {
                 const Limits limits = limits_of(self.path, velocity, acceleration, jerk);
                 std::array<Peak, 3> peaks;
                 {
                     nb::gil_scoped_release released;
                     peaks = trajectory_peaks(self.path, self.motion, limits);
                 }
                 return std::make_tuple(as_tuple(peaks[0]), as_tuple(peaks[1]), as_tuple(peaks[2]));
             })
        .def("peak_tool_speed", [](const Trajectory& self, const Rows& table, std::size_t tool_body, const std::array<double, 3>& tool) {
            const Arm arm = arm_of(table, tool_body, tool, self.path.joints);
            nb::gil_scoped_release released;
            return peak_tool_speed(arm, self.path, self.motion);
        });
    m.def("time_path", [](const Rows& waypoints, const Column& knots, const Rows& tangents, const Column& breaks, const Numbers& lines,
                          const Numbers& rows, const Rows& blends, const std::vector<std::size_t>& corners, const Column& velocity,
                          const Column& acceleration, const Column& jerk, int gridpoints) {
        const Path path = path_of(waypoints, knots, tangents, breaks, lines, rows, blends);
        const Limits limits = limits_of(path, velocity, acceleration, jerk);
        const auto stops = inner_waypoints(path, corners);
        return unless_unusual([&] { return time_path({gridpoints}, path, limits, stops); }, [](TimedPath& timed) -> nb::object {
            const auto& peaks = timed.peaks;
            return nb::make_tuple(motion_of(timed), nb::make_tuple(as_tuple(peaks[0]), as_tuple(peaks[1]), as_tuple(peaks[2])));
        });
    });
    m.def("continue_to_rest", [](const Rows& waypoints, const Column& knots, const Rows& tangents, const Column& breaks,
                                 const Numbers& lines, const Numbers& rows, const Rows& blends,
                                 const std::vector<std::size_t>& corners, const Column& velocity, const Column& acceleration,
                                 const Column& jerk, int gridpoints, double s_start, double speed, double blend_share) {
        const Path path = path_of(waypoints, knots, tangents, breaks, lines, rows, blends);
        const Limits limits = limits_of(path, velocity, acceleration, jerk);
        const auto stops = inner_waypoints(path, corners);
        require(s_start >= 0.0, "a place on the path");
        return unless_unusual([&] { return continue_to_rest({gridpoints}, path, limits, stops, s_start, speed, blend_share); },
                              [](const std::vector<Phase>& phases) {
                                  std::vector<Row> out;  // without jerk
                                  for (const Phase& p : phases) out.push_back({p.duration, p.position, p.speed, p.acceleration, 0.0});
                                  return table_of(out);
                              });
    });
    m.def("lawful_motion", [](const Rows& waypoints, const Column& knots, const Rows& tangents, const Column& breaks,
                              const Numbers& lines, const Numbers& rows, const Rows& blends, const std::vector<std::size_t>& corners,
                              const Column& durations, const Rows& coefficients, double begin, double end, bool from_rest) {
        const Path path = path_of(waypoints, knots, tangents, breaks, lines, rows, blends);
        const auto stops = inner_waypoints(path, corners);
        const std::size_t count = durations.shape(0);
        require(coefficients.shape(0) == count && coefficients.shape(1) == 4, "four coefficients for each duration");
        const std::vector<double> seconds(durations.data(), durations.data() + count);
        const std::vector<double> cubics(coefficients.data(), coefficients.data() + 4 * count);
        return unless_unusual([&] { return lawful_motion(path, stops, seconds, cubics, {begin, end, from_rest}); },
                              [](TimedPath& timed) { return motion_of(timed); });
    });
    m.def("path_at", [](const Rows& waypoints, const Column& knots, const Rows& tangents, const Column& breaks, const Numbers& lines,
                        const Numbers& rows, const Rows& blends, const Column& places, int order) {
        const Path path = path_of(waypoints, knots, tangents, breaks, lines, rows, blends);
        const std::size_t n = path.joints, count = places.shape(0);
        require(path.pieces > 0 && (order == 0 || order == 1), "positions or tangents of a path with a length");
        const double* ends[] = {path.waypoints, path.waypoints + (path.waypoint_count - 1) * n};
        const bool exact = path.blended(0) || path.blended(path.pieces - 1);
        std::vector<double> out(count * n);
        for (std::size_t k = 0; k < count; ++k) {
            const double s = places.data()[k];
            require(s >= 0.0 && s <= path.length(), "places on the path");
            double* at = out.data() + k * n;
            if (order == 1)
                path.tangent(path.piece_at(s), s, at);
            else if (exact && (s == 0.0 || s == path.length()))  // bit for bit, even if a blend reaches an end
                std::copy(ends[s != 0.0], ends[s != 0.0] + n, at);
            else
                path.position(s, at);
        }
        return array_of<double>(std::move(out), {count, n});
    });
    nb::class_<KeptUnderway>(m, "Underway")
        .def(nb::init<const Rows&, const Column&, const Rows&, const Column&, const Numbers&, const Numbers&, const Rows&,
                      const Column&, const Rows&, const Column&, const Column&, double, double, double>())
        .def("moved", [](const KeptUnderway& self, double s) { return self.motion.moved(s); })
        .def("at", [](const KeptUnderway& self, double t) {
            const State state = self.motion.at(t);
            return std::make_tuple(state.s, state.rate);
        })
        .def("rows", [](const KeptUnderway& self, double until) { return table_of(self.motion.rows(until)); })
        .def("braking", [](const KeptUnderway& self, double s, double rate, double rest, const Column& acceleration,
                           double margin) -> nb::object {
            require(acceleration.shape(0) == self.motion.left.joints, "a limit for each joint");
            const auto found = self.motion.braking({s, rate}, rest, acceleration.data(), margin);
            if (!found) return nb::none();
            return nb::make_tuple(table_of(found->rows), found->end);
        });
    m.def("stop_duration", [](const Rows& waypoints, const Column& knots, const Rows& tangents, const std::vector<std::size_t>& turns,
                              const Column& velocity, const Column& acceleration) {
        const std::size_t points = waypoints.shape(0), n = waypoints.shape(1);
        require(points >= 1 && knots.shape(0) == points && tangents.shape(0) + 1 == points && tangents.shape(1) == n,
                "a knot for each waypoint, a tangent for each line");
        const Path path{n, points, 0, waypoints.data(), knots.data(), tangents.data(), nullptr, nullptr, nullptr, nullptr};
        const Limits limits = limits_of(path, velocity, acceleration, acceleration);
        const auto stops = inner_waypoints(path, turns);
        return unless_unusual([&] { return stop_duration(path, limits, stops); }, [](double seconds) { return nb::cast(seconds); });
    });
    m.def("setpoints", [](const Column& place, const Column& radius, const Column& speed, const Column& change, const Column& due,
                          const Rows& targets, const std::array<double, 3>& shares, double goal_time, bool aside) {
        const std::size_t n = place.shape(0), count = targets.shape(0);
        for (const Column* each : {&radius, &speed, &change, &due}) require(each->shape(0) == n, "as many joints");
        require(targets.shape(1) == n, "targets of as many joints");
        const Setpoint now{place.data(), radius.data(), speed.data(), change.data(), due.data()};
        Course found = course(n, count, now, targets.data(), shares[0], shares[1], shares[2], goal_time, aside);
        const auto arrivals = [&](std::vector<double>& rows) { return array_of<double>(std::move(rows), {count + 1, n}); };
        const nb::object places = arrivals(found.places), in_time = aside ? arrivals(found.due) : places;
        return nb::make_tuple(places, arrivals(found.radii), array_of<double>(std::move(found.going), {count, n}),
                              arrivals(found.before), arrivals(found.changes), in_time);
    });
    m.def("tool_speeds", [](const Rows& table, std::size_t tool_body, const std::array<double, 3>& tool, const Rows& Q, const Rows& Qd) {
        require(Q.shape(0) == Qd.shape(0) && Q.shape(1) == Qd.shape(1), "a velocity for each configuration");
        const Arm arm = arm_of(table, tool_body, tool, Q.shape(1));
        return array_of<double>(tool_speeds(arm, Q.shape(1), Q.shape(0), Q.data(), Qd.data()), {Q.shape(0)});
    });
}

}  // namespace timing
