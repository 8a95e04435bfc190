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
    Kernel(const Rows& joints, const Rows& solids, const std::vector<Rows>& hulls, const Rows& riders, const Rows& turns,
           const NumberRows& standers, const Rows& positions, const NumberRows& runs, const NumberRows& pairs,
           std::int64_t count, double margin, const std::string& variant) {
        require_finite(&margin, 1);
        model_.margin = margin;
        if (variant == doubter.name) variant_ = &doubter;
        for (const auto* found : variants())
            if (variant.empty() || variant == found->name) variant_ = found;
        require(variant_ != nullptr, "this processor has no such instruction set");
        add_joints(joints);
        add_hulls(hulls);
        add_solids(solids);
        add_riders(riders);
        add_turns(turns);
        add_standers(standers, positions);
        add_pairs(runs, pairs, count);
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

    // Rows: half lengths (3), ball, disc, hull. The first solids are those of what rides.
    void add_solids(const Rows& rows) {
        require(rows.shape(1) == 6, "6 numbers for each solid");
        require_finite(rows);
        const auto hulls = static_cast<std::int64_t>(model_.hulls.size());
        for (std::size_t k = 0; k < rows.shape(0); ++k) {
            const double* row = rows.data() + 6 * k;
            Solid solid{};
            std::copy(row, row + 3, solid.half);
            solid.ball = row[3];
            solid.disc = row[4];
            solid.hull = whole(static_cast<std::int64_t>(row[5]), -1, hulls - 1, "no such hull");
            model_.solids.push_back(solid);
        }
    }

    // Rows: body, rotation (9), position (3).
    void add_riders(const Rows& rows) {
        require(rows.shape(1) == 13 && rows.shape(0) <= model_.solids.size(), "13 numbers and a solid for what rides");
        require_finite(rows);
        for (std::size_t k = 0; k < rows.shape(0); ++k) {
            const double* row = rows.data() + 13 * k;
            Rider rider{};
            rider.solid = model_.solids[k];
            rider.body = whole(static_cast<std::int64_t>(row[0]), 0, static_cast<std::int64_t>(model_.joints.size()), "no such body");
            copy_rotation(row + 1, rider.rotation);
            std::copy(row + 10, row + 13, rider.position);
            rider.turned = !is_identity(rider.rotation);
            model_.riders.push_back(rider);
        }
    }

    void add_turns(const Rows& rows) {
        require(rows.shape(1) == 9, "9 numbers for each rotation");
        require_finite(rows);
        for (std::size_t k = 0; k < rows.shape(0); ++k) {
            Turn turn{};
            copy_rotation(rows.data() + 9 * k, turn.rotation);
            turn.turned = !is_identity(turn.rotation);
            model_.turns.push_back(turn);
        }
    }

    // Numbers: which solid and which turn.
    void add_standers(const NumberRows& numbers, const Rows& positions) {
        require(numbers.shape(1) == 2 && positions.shape(1) == 3, "two numbers and a position for what stands");
        require(numbers.shape(0) == positions.shape(0), "a position for each that stands");
        require(numbers.shape(0) <= 1'000'000'000, "too many that stand");
        require_finite(positions);
        model_.standers.reserve(numbers.shape(0));
        for (std::size_t k = 0; k < numbers.shape(0); ++k) {
            Stander stander{};
            stander.solid = whole(numbers.data()[2 * k], 0, static_cast<std::int64_t>(model_.solids.size()) - 1, "no such solid");
            stander.turn = whole(numbers.data()[2 * k + 1], 0, static_cast<std::int64_t>(model_.turns.size()) - 1, "no such turn");
            stander.part = static_cast<int>(k);
            stander.run = -1;
            std::copy(positions.data() + 3 * k, positions.data() + 3 * k + 3, stander.position);
            double low[3], high[3];
            box_around(model_, stander, low, high);
            round_outwards(low, high, stander.bounds);
            model_.standers.push_back(stander);
        }
    }

    // Runs: first and end, among those that stand, of the parts of each obstacle, which are judged all or none. Pairs, in
    // runs: the number of the first, its rider, and the first of the others, which follow each other.
    void add_pairs(const NumberRows& runs, const NumberRows& pairs, std::int64_t count) {
        require(runs.shape(1) == 2 && pairs.shape(1) == 3, "two numbers for each obstacle and three for each run of pairs");
        const auto standing = static_cast<std::int64_t>(model_.standers.size());
        const auto riding = static_cast<std::int64_t>(model_.riders.size());
        std::vector<int>& firsts = model_.run_first;
        for (std::size_t run = 0; run < runs.shape(0); ++run) {
            const int first = whole(runs.data()[2 * run], 0, standing - 1, "no such part");
            const int end = whole(runs.data()[2 * run + 1], first + 1, standing, "no such part");
            require(first == (run == 0 ? 0 : static_cast<int>(runs.data()[2 * run - 1])), "obstacles follow each other");
            firsts.push_back(first);
            for (int k = first; k < end; ++k) model_.standers[static_cast<std::size_t>(k)].run = static_cast<int>(run);
        }
        require(model_.standers.empty() || model_.standers.back().run >= 0, "a part of no obstacle");
        const std::size_t obstacles = firsts.size();
        model_.first_pair.assign(model_.riders.size() * obstacles, -1);
        model_.pairs = whole(count, 0, 2'000'000'000, "too many pairs");
        for (std::size_t row = 0; row < pairs.shape(0); ++row) {
            const std::int64_t* run = pairs.data() + 3 * row;
            const bool last = row + 1 == pairs.shape(0);
            const int number = whole(run[0], 0, row == 0 ? 0 : count, "runs of pairs begin with the first");
            const int end = whole(last ? count : run[3], number, count, "runs of pairs follow each other");
            const int i = whole(run[1], 0, riding - 1, "the first of a pair rides");
            const int j = whole(run[2], 0, riding + standing - (end - number), "no such part");
            if (j < riding) {
                require(j + (end - number) <= riding, "a run of pairs is the robot's own or with the world");
                require(model_.own_pairs.empty() || model_.own_pairs.back().first <= i, "pairs go by their first");
                for (int k = number; k < end; ++k) model_.own_pairs.push_back({i, j + k - number, k, -1});
                continue;
            }
            const int begin = j - static_cast<int>(riding), stop = begin + end - number;
            model_.riders[static_cast<std::size_t>(i)].meets_world |= end > number;
            auto found = std::lower_bound(firsts.begin(), firsts.end(), begin);
            require(begin == stop || (found != firsts.end() && *found == begin), "an obstacle's parts are judged all or none");
            for (; found != firsts.end() && *found < stop; ++found) {
                const auto obstacle = static_cast<std::size_t>(found - firsts.begin());
                int& first = model_.first_pair[static_cast<std::size_t>(i) * obstacles + obstacle];
                require(first < 0, "a pair twice");
                require(runs.data()[2 * obstacle + 1] <= stop, "an obstacle's parts are judged all or none");
                first = number + *found - begin;
            }
        }
        require(pairs.shape(0) > 0 || count == 0, "pairs of no run");
        model_.own_from.assign(model_.riders.size() + 1, 0);
        for (const auto& pair : model_.own_pairs) ++model_.own_from[static_cast<std::size_t>(pair.first) + 1];
        for (std::size_t i = 1; i < model_.own_from.size(); ++i) model_.own_from[i] += model_.own_from[i - 1];
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
        .def(nb::init<const Rows&, const Rows&, const std::vector<Rows>&, const Rows&, const Rows&, const NumberRows&,
                      const Rows&, const NumberRows&, const NumberRows&, std::int64_t, double, const std::string&>(),
             nb::arg("joints"), nb::arg("solids"), nb::arg("hulls"), nb::arg("riders"), nb::arg("turns"),
             nb::arg("standers"), nb::arg("positions"), nb::arg("runs"), nb::arg("pairs"), nb::arg("count"),
             nb::arg("margin"), nb::arg("variant") = "")
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
