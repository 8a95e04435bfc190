// The kernel as Python sees it (_core.pyi): a model built from arrays, and what is asked of it.
#include <nanobind/nanobind.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>
#include <string>

#include "../arrays.hpp"
#include "distance.hpp"
#include "kernel.hpp"
#include "model.hpp"
#include "samples.hpp"
#include "tables.hpp"

namespace nb = nanobind;

namespace collision {

namespace {

using arrays::array_of;
using arrays::NumberRows;
using arrays::require;
using arrays::Rows;
using Anything = nb::ndarray<nb::ro, nb::device::cpu>;

int whole(std::int64_t value, std::int64_t low, std::int64_t high, const char* what) {
    require(low <= value && value <= high, what);
    return static_cast<int>(value);
}

// Refuses a matrix that is no rotation: bounds would be too small.
void copy_rotation(const double* from, double* to) {
    for (int i = 0; i < 3; ++i)
        for (int j = i; j < 3; ++j) {
            double product = 0.0;
            for (int k = 0; k < 3; ++k) product += from[3 * i + k] * from[3 * j + k];
            require(std::fabs(product - (i == j ? 1.0 : 0.0)) < 1e-6, "a rotation is not orthonormal");
        }
    std::copy(from, from + 9, to);
}

bool is_identity(const double* R) {
    for (int k = 0; k < 9; ++k)
        if (R[k] != (k % 4 == 0 ? 1.0 : 0.0)) return false;
    return true;
}

// What is no number is neither above nor below another: every proof that solids are apart relies on these.
void require_finite(const double* values, std::size_t count) {
    for (std::size_t k = 0; k < count; ++k) require(std::isfinite(values[k]), "finite numbers");
}

void require_finite(const Rows& rows) { require_finite(rows.data(), rows.shape(0) * rows.shape(1)); }

// ``Near`` as arrays.
struct NearArrays {
    nb::object rows, pairs, distances, points, gradients;
    std::int64_t measured;
};

// Which samples of an edge are checked: ``Samples`` in edge_sampling.py.
enum class Samples { all, coarse, rest };

// Lets other threads into the interpreter while so much is judged that it takes longer than to wait for it again.
class Released {
  public:
    explicit Released(std::int64_t pairs) {
        if (pairs > MANY) released_.emplace();
    }

  private:
    static constexpr std::int64_t MANY = 100'000;  // some 0.1 ms
    std::optional<nb::gil_scoped_release> released_;
};

class Kernel {
  public:
    Kernel(const Rows& joints, const Rows& bodies_and_poses, const Rows& solids, const NumberRows& runs,
           const NumberRows& pairs, const std::vector<Rows>& hulls, double margin, const std::string& variant) {
        require_finite(&margin, 1);
        model_.margin = margin;
        if (variant == doubter.name) variant_ = &doubter;
        for (const auto* found : variants())
            if (variant.empty() || variant == found->name) variant_ = found;
        require(variant_ != nullptr, "this processor has no such instruction set");
        add_joints(joints);
        add_hulls(hulls);
        add_parts(bodies_and_poses, solids);
        add_pairs(runs, pairs);
        build_nodes(model_);
        build_groups(model_);
    }

    const char* variant() const { return variant_->name; }

    View view() const {
        require(!settings_.lower.empty(), "a kernel that is configured for edges");
        return View{model_, *variant_, settings_};
    }

    std::vector<std::pair<int, int>> candidates(const Rows& Q) const {
        const int m = rows_of(Q);
        const Released released(pairs_of(m));
        return collision::candidates(model_, *variant_, Q.data(), m);
    }

    RowCheck check_rows(const Rows& Q, int start, int stop) const {
        require(0 <= start && start <= stop && stop <= rows_of(Q), "start <= stop <= rows");
        const Released released(pairs_of(stop - start));
        return collision::check_rows(model_, *variant_, Q.data(), start, stop);
    }

    RowCheck check_edge_rows(std::vector<double> a, std::vector<double> b, int ends, int segments, int start,
                             int stop) const {
        const Edge edge = edge_of(std::move(a), std::move(b), ends, segments);
        require(0 <= start && start <= stop && stop <= edge.rows(), "start <= stop <= rows");
        const Released released(pairs_of(stop - start));
        return collision::check_rows(model_, *variant_, edge, start, stop);
    }

    NearArrays near(const Rows& Q, double within) const {
        const int m = rows_of(Q);
        require(std::isfinite(within), "a distance in metres");
        Near found;
        {
            const Released released(pairs_of(m));
            found = collision::near(model_, Q.data(), m, within);
        }
        const std::size_t count = found.rows.size(), n = static_cast<std::size_t>(model_.dof);
        return {array_of<std::int64_t>(std::move(found.rows), {count}),
                array_of<std::int64_t>(std::move(found.pairs), {count}),
                array_of<double>(std::move(found.distances), {count}),
                array_of<double>(std::move(found.points), {count, 2, 3}),
                array_of<double>(std::move(found.gradients), {count, n}),
                found.measured};
    }

    void configure(std::vector<double> lower, std::vector<double> upper, const std::vector<double>& table_lower,
                   const std::vector<double>& table_upper, std::vector<double> reach, std::vector<double> motion_steps,
                   std::vector<double> joint_steps, int coarse_segments) {
        const auto n = static_cast<std::size_t>(model_.dof);
        require(lower.size() == n && upper.size() == n && reach.size() == n, "limits and reach of another robot");
        require(table_lower.size() == n && table_upper.size() == n, "limits of another robot");
        require_finite(table_lower.data(), n);
        require_finite(table_upper.data(), n);
        for (const double step : motion_steps) require(step > 0.0, "a step is positive");
        for (const double step : joint_steps) require(step > 0.0, "a step is positive");
        require(1 <= coarse_segments && coarse_segments <= 1000, "1 to 1000 segments between coarse samples");
        require_finite(lower.data(), n);
        require_finite(upper.data(), n);
        bound_motion(model_, lower, upper);
        add_tables(model_, table_lower, table_upper);
        settings_ = Settings{std::move(lower),        std::move(upper),       std::move(reach),
                             std::move(motion_steps), std::move(joint_steps), coarse_segments};
    }

    nb::object check_state(nb::handle q) const {
        std::vector<double> values;
        if (!read(q, values)) return nb::cast(RowCheck{Status::refused, 0, 0.0, {}, {}});
        RowCheck check;
        {
            const Released released(pairs_of(1));
            check = collision::check_rows(model_, *variant_, values.data(), 0, 1);
        }
        return check.status == Status::free ? free_ : nb::cast(std::move(check));
    }

    EdgeCheck check_edge(nb::handle q1, nb::handle q2, int known, int samples, int max_rows) const {
        require(0 <= samples && samples <= static_cast<int>(Samples::rest), "all samples, the coarse ones or the rest");
        require(0 < max_rows, "at least one row");
        EdgeCheck out;
        std::vector<double> a, b;
        if (!read(q1, a) || !read(q2, b)) return out;
        out.segments = segments_of(settings_, a, b);
        if (out.segments == 0) return out;
        out.ends = 3 & ~(a == b ? known | 2 : known);
        const Edge edge = edge_of(std::move(a), std::move(b), out.ends, out.segments);
        const auto which = static_cast<Samples>(samples);
        const int coarse = edge.ends() + coarse_samples(out.segments, settings_.coarse_segments);
        const int start = which == Samples::rest ? coarse : 0;
        out.rows = which == Samples::coarse ? coarse : edge.rows();
        const int stop = std::min(start + max_rows, out.rows);
        RowCheck check;
        {
            const Released released(pairs_of(stop - start));
            check = collision::check_rows(model_, *variant_, edge, start, stop);
        }
        if (check.status == Status::colliding) {
            out.status = Status::colliding;
            out.judged = check.row - start + 1;
            out.fraction = check.fraction;
            out.pair = check.pairs.front();
            return out;
        }
        out.next = check.status == Status::free ? stop : start;
        out.judged = out.next - start;
        out.status = out.next == out.rows ? Status::free : Status::undecided;
        return out;
    }

  private:
    Model model_;
    Settings settings_;
    const Variant* variant_ = nullptr;
    nb::object free_ = nb::cast(RowCheck{});  // of every free state the same: to make one takes as long as some checks
    nb::object array_ = nb::module_::import_("numpy").attr("ndarray");

    // Whether q is n doubles, as a tuple or an array, within the limits.
    bool read(nb::handle q, std::vector<double>& out) const {
        const auto n = settings_.lower.size();
        if (n == 0) return false;
        out.resize(n);
        if (PyTuple_CheckExact(q.ptr())) {
            if (PyTuple_Size(q.ptr()) != static_cast<Py_ssize_t>(n)) return false;
            for (std::size_t k = 0; k < n; ++k) {
                PyObject* value = PyTuple_GetItem(q.ptr(), static_cast<Py_ssize_t>(k));
                if (!PyFloat_Check(value)) return false;
                out[k] = PyFloat_AsDouble(value);
            }
            return within_limits(settings_, out);
        }
        if (!q.type().is(array_)) return false;  // others may hide entries
        Anything array;
        if (!nb::try_cast(q, array, false)) return false;
        if (array.ndim() != 1 || array.shape(0) != n || array.dtype() != nb::dtype<double>()) return false;
        const auto* values = static_cast<const double*>(array.data());
        for (std::size_t k = 0; k < n; ++k) out[k] = values[static_cast<std::int64_t>(k) * array.stride(0)];
        return within_limits(settings_, out);
    }

    // How many pairs there are in some configurations.
    std::int64_t pairs_of(int rows) const { return static_cast<std::int64_t>(rows) * model_.pairs; }

    int rows_of(const Rows& Q) const {
        require(Q.shape(1) == static_cast<std::size_t>(model_.dof), "a configuration of another robot");
        const int m = whole(static_cast<std::int64_t>(Q.shape(0)), 0, 100'000'000, "too many configurations");
        require_finite(Q);
        return m;
    }

    Edge edge_of(std::vector<double> a, std::vector<double> b, int ends, int segments) const {
        const auto n = static_cast<std::size_t>(model_.dof);
        require(a.size() == n && b.size() == n, "a configuration of another robot");
        require(1 <= segments && segments <= MAX_SEGMENTS, "1 to 1,000,000 segments");
        require_finite(a.data(), n);
        require_finite(b.data(), n);
        return Edge(std::move(a), std::move(b), (ends & 1) != 0, (ends & 2) != 0, segments);
    }

    // Rows: parent, q_index, 1 for a slide; axis (3); placement, rotation (9) then position (3); multiplier.
    void add_joints(const Rows& rows) {
        require(rows.shape(1) == 19, "19 numbers for each joint");
        require_finite(rows);
        const auto count = static_cast<std::int64_t>(rows.shape(0));
        for (std::int64_t k = 0; k < count; ++k) {
            const double* row = rows.data() + 19 * k;
            Joint joint{};
            joint.parent = whole(static_cast<std::int64_t>(row[0]), 0, k, "a parent comes before its child");
            joint.q_index = whole(static_cast<std::int64_t>(row[1]), 0, count - 1, "no such entry of q");
            model_.dof = std::max(model_.dof, joint.q_index + 1);
            joint.multiplier = row[18];
            std::copy(row + 3, row + 6, joint.axis);
            copy_rotation(row + 6, joint.rotation);
            std::copy(row + 15, row + 18, joint.offset);
            joint.turned = !is_identity(joint.rotation);
            joint.motion = row[2] != 0.0 ? Motion::slide : Motion::turn;
            for (int i = 0; i < 3 && joint.motion == Motion::turn; ++i)
                if (std::fabs(joint.axis[i]) == 1.0) joint.motion = static_cast<Motion>(i);
            model_.joints.push_back(joint);
        }
    }

    void add_hulls(const std::vector<Rows>& hulls) {
        for (const auto& corners : hulls) {
            require(corners.shape(1) == 3 && corners.shape(0) > 0, "corners of shape (v, 3)");
            require(corners.shape(0) < 1U << 24U, "fewer corners, whose numbers are whole in single precision");
            require_finite(corners);
            const std::size_t count = corners.shape(0), padded = (count + FLOATS - 1) / FLOATS * FLOATS;
            double radius = 0.0;
            for (std::size_t i = 0; i < count; ++i) {
                const double* c = corners.data() + 3 * i;
                radius = std::max(radius, std::sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]));
            }
            require(radius < FARTHEST, "corners that far away");
            // Of a height c.l each of the three terms is rounded five times at most: the numbers c and l, their product
            // and two sums; each time by 2^-24 of it. So a height is 3e-7 |c| |l| off at most, and the corner that
            // looks highest is 6e-7 |c| |l| below the highest.
            model_.hulls.push_back(Hull{model_.corners.size(), padded, radius, 6e-7 * radius});
            for (std::size_t k = 0; k < 3; ++k)
                for (std::size_t i = 0; i < padded; ++i)
                    model_.corners.push_back(corners.data()[3 * std::min(i, count - 1) + k]);
        }
        for (const double corner : model_.corners) model_.rounded_corners.push_back(static_cast<float>(corner));
    }

    // Rows: body (-1: it stands), rotation (9), position (3); half lengths (3), ball, disc, hull.
    void add_parts(const Rows& places, const Rows& solids) {
        require(places.shape(1) == 13 && solids.shape(1) == 6, "13 and 6 numbers for each part");
        require(places.shape(0) == solids.shape(0), "a solid for each part");
        require_finite(places);
        require_finite(solids);
        for (std::size_t k = 0; k < places.shape(0); ++k) {
            const double *place = places.data() + 13 * k, *row = solids.data() + 6 * k;
            Solid solid{};
            std::copy(row, row + 3, solid.half);
            solid.ball = row[3];
            solid.disc = row[4];
            solid.hull = whole(static_cast<std::int64_t>(row[5]), -1, static_cast<std::int64_t>(model_.hulls.size()) - 1,
                               "no such hull");
            const int body = whole(static_cast<std::int64_t>(place[0]), -1, static_cast<std::int64_t>(model_.joints.size()), "no such body");
            if (body >= 0) {
                require(model_.standers.empty(), "what rides comes first");
                Rider rider{};
                rider.solid = solid;
                rider.body = body;
                copy_rotation(place + 1, rider.rotation);
                std::copy(place + 10, place + 13, rider.position);
                rider.turned = !is_identity(rider.rotation);
                model_.riders.push_back(rider);
            } else {
                add_stander(solid, place);
            }
        }
    }

    void add_stander(const Solid& solid, const double* place) {
        Stander stander{};
        stander.solid = solid;
        stander.part = static_cast<int>(model_.standers.size());
        copy_rotation(place + 1, stander.rotation);
        std::copy(place + 10, place + 13, stander.position);
        stander.turned = !is_identity(stander.rotation);
        double reach[3];
        reach_of(solid, stander.rotation, reach);
        for (int k = 0; k < 3; ++k) {
            stander.low[k] = stander.position[k] - reach[k];
            stander.high[k] = stander.position[k] + reach[k];
        }
        round_outwards(stander.low, stander.high, stander.bounds);
        model_.standers.push_back(stander);
    }

    // Runs: first and end, among those that stand, of the parts of each obstacle, which are judged all or none.
    void add_pairs(const NumberRows& runs, const NumberRows& pairs) {
        require(runs.shape(1) == 2 && pairs.shape(1) == 2, "two numbers for each run and pair");
        const auto standing = static_cast<std::int64_t>(model_.standers.size());
        const auto riding = static_cast<std::int64_t>(model_.riders.size());
        model_.run_of.assign(model_.standers.size(), -1);
        for (std::size_t run = 0; run < runs.shape(0); ++run) {
            const int first = whole(runs.data()[2 * run], 0, standing, "no such part");
            const int end = whole(runs.data()[2 * run + 1], first, standing, "no such part");
            model_.run_first.push_back(first);
            for (int k = first; k < end; ++k) model_.run_of[static_cast<std::size_t>(k)] = static_cast<int>(run);
        }
        for (const int run : model_.run_of) require(run >= 0, "a part of no obstacle");
        const std::size_t obstacles = model_.run_first.size();
        model_.first_pair.assign(model_.riders.size() * obstacles, -1);
        const auto count = whole(static_cast<std::int64_t>(pairs.shape(0)), 0, 2'000'000'000, "too many pairs");
        model_.pairs = count;
        std::int64_t with_world = 0;
        for (int k = 0; k < count; ++k) {
            const int i = whole(pairs.data()[2 * k], 0, riding - 1, "the first of a pair rides");
            const int j = whole(pairs.data()[2 * k + 1], 0, riding + standing - 1, "no such part");
            if (j < riding) {
                require(model_.own_pairs.empty() || model_.own_pairs.back().first <= i, "pairs go by their first");
                model_.own_pairs.push_back({i, j, k, -1});
                continue;
            }
            ++with_world;
            const auto part = static_cast<std::size_t>(j - riding);
            const auto run = static_cast<std::size_t>(model_.run_of[part]);
            model_.riders[static_cast<std::size_t>(i)].meets_world = true;
            if (model_.run_first[run] == static_cast<int>(part))
                model_.first_pair[static_cast<std::size_t>(i) * obstacles + run] = k;
        }
        check_pairs(pairs, with_world);
        model_.own_from.assign(model_.riders.size() + 1, 0);
        for (const auto& pair : model_.own_pairs) ++model_.own_from[static_cast<std::size_t>(pair.first) + 1];
        for (std::size_t i = 1; i < model_.own_from.size(); ++i) model_.own_from[i] += model_.own_from[i - 1];
    }

    // Every pair with the world has the number that is worked out for it, and there are no others.
    void check_pairs(const NumberRows& pairs, std::int64_t with_world) const {
        const auto riding = static_cast<std::int64_t>(model_.riders.size());
        for (std::size_t k = 0; k < pairs.shape(0); ++k) {
            const std::int64_t i = pairs.data()[2 * k], j = pairs.data()[2 * k + 1];
            if (j < riding) continue;
            const int number = model_.pair_number(static_cast<std::size_t>(i),
                                                  model_.standers[static_cast<std::size_t>(j - riding)]);
            require(number == static_cast<int>(k), "the pairs of an obstacle's parts are not numbered in their order");
        }
        std::int64_t expected = 0;
        for (std::size_t i = 0; i < model_.riders.size(); ++i)
            for (const auto& stander : model_.standers) expected += model_.pair_number(i, stander) >= 0 ? 1 : 0;
        require(expected == with_world, "an obstacle's parts are judged all or none");
    }
};

// The status as four questions: comparing members of a Python enum would take a tenth of what a check takes.
template <class Check>
nb::class_<Check> bind_check(nb::module_& m, const char* name) {
    return nb::class_<Check>(m, name)
        .def_prop_ro("refused", [](const Check& self) { return self.status == Status::refused; })
        .def_prop_ro("free", [](const Check& self) { return self.status == Status::free; })
        .def_prop_ro("colliding", [](const Check& self) { return self.status == Status::colliding; })
        .def_prop_ro("undecided", [](const Check& self) { return self.status == Status::undecided; })
        .def_ro("fraction", &Check::fraction);
}

}  // namespace

View view_of(nb::handle kernel) { return nb::cast<const Kernel&>(kernel).view(); }

void bind(nb::module_& m) {
    m.def("instruction_sets", [] {
        std::vector<std::string> names;
        for (const auto* found : variants()) names.emplace_back(found->name);
        return names;
    });
    bind_check<RowCheck>(m, "RowCheck")
        .def_ro("row", &RowCheck::row)
        .def_prop_ro("pair", [](const RowCheck& self) { return self.pairs.empty() ? -1 : self.pairs.front(); })
        .def_ro("q", &RowCheck::q)
        .def_ro("pairs", &RowCheck::pairs);
    bind_check<EdgeCheck>(m, "EdgeCheck")
        .def_ro("judged", &EdgeCheck::judged)
        .def_ro("pair", &EdgeCheck::pair)
        .def_ro("ends", &EdgeCheck::ends)
        .def_ro("segments", &EdgeCheck::segments)
        .def_ro("rows", &EdgeCheck::rows)
        .def_ro("next", &EdgeCheck::next);
    nb::class_<NearArrays>(m, "NearArrays")
        .def_ro("rows", &NearArrays::rows)
        .def_ro("pairs", &NearArrays::pairs)
        .def_ro("distances", &NearArrays::distances)
        .def_ro("points", &NearArrays::points)
        .def_ro("gradients", &NearArrays::gradients)
        .def_ro("measured", &NearArrays::measured);
    nb::class_<Kernel>(m, "CollisionKernel")
        .def(nb::init<const Rows&, const Rows&, const Rows&, const NumberRows&, const NumberRows&,
                      const std::vector<Rows>&, double, const std::string&>(),
             nb::arg("joints"), nb::arg("places"), nb::arg("solids"), nb::arg("runs"), nb::arg("pairs"),
             nb::arg("hulls"), nb::arg("margin"), nb::arg("variant") = "")
        .def_prop_ro("variant", &Kernel::variant)
        .def("candidates",
             [](const Kernel& self, const Rows& Q) {
                 std::vector<int> rows, pairs;
                 for (const auto& [row, pair] : self.candidates(Q)) {
                     rows.push_back(row);
                     pairs.push_back(pair);
                 }
                 return nb::make_tuple(rows, pairs);
             })
        .def("check_rows", &Kernel::check_rows)
        .def("check_edge_rows", &Kernel::check_edge_rows)
        .def("near", &Kernel::near)
        .def("configure", &Kernel::configure, nb::arg("lower"), nb::arg("upper"), nb::arg("table_lower"), nb::arg("table_upper"),
             nb::arg("reach"), nb::kw_only(),
             nb::arg("motion_steps"), nb::arg("joint_steps"), nb::arg("coarse_segments"))
        .def("check_state", &Kernel::check_state, nb::arg("q").none())
        .def("check_edge", &Kernel::check_edge, nb::arg("q1").none(), nb::arg("q2").none(), nb::arg("known"),
             nb::arg("samples"), nb::arg("max_rows"));
}

}  // namespace collision
