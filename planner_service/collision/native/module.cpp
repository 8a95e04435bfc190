// planner_service.collision._kernel: the model built from arrays, and its questions.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>

#include "distance.hpp"
#include "model.hpp"
#include "samples.hpp"

namespace nb = nanobind;

namespace kernel {

namespace {

using Rows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Anything = nb::ndarray<nb::ro, nb::device::cpu>;
using NumberRows = nb::ndarray<const std::int64_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void require(bool condition, const char* what) {
    if (!condition) throw std::invalid_argument(what);
}

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

// Half lengths of the box around a solid along the world's axes.
void reach_of(const Solid& s, const double* R, double* out) {
    for (int i = 0; i < 3; ++i) {
        const double* row = R + 3 * i;
        out[i] = s.ball + s.disc * std::sqrt(row[0] * row[0] + row[1] * row[1]);
        for (int k = 0; k < 3; ++k) out[i] += std::fabs(row[k]) * s.half[k];
    }
}

nb::object told(const std::optional<Doubt>& doubt) {
    if (!doubt) return nb::none();
    if (doubt->deep) return nb::make_tuple(doubt->row, doubt->fraction, doubt->pairs.front());
    return nb::make_tuple(doubt->row, doubt->fraction, doubt->q, doubt->pairs);
}

// A numpy array that keeps the numbers of a vector.
template <typename T>
nb::object array_of(std::vector<T>&& values, std::initializer_list<std::size_t> shape) {
    auto* kept = new std::vector<T>(std::move(values));
    const nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
    return nb::ndarray<nb::numpy, T>(kept->data(), shape, owner).cast();
}

class Kernel {
  public:
    Kernel(const Rows& joints, const Rows& bodies_and_poses, const Rows& solids, const NumberRows& runs,
           const NumberRows& pairs, const std::vector<Rows>& hulls, double margin, const std::string& variant) {
        require_finite(&margin, 1);
        model_.margin = margin;
        for (const auto* found : variants())
            if (variant.empty() || variant == found->name) variant_ = found;
        require(variant_ != nullptr, "this processor has no such instruction set");
        add_joints(joints);
        add_hulls(hulls);
        add_parts(bodies_and_poses, solids);
        add_pairs(runs, pairs);
        build_nodes(model_);
    }

    const char* variant() const { return variant_->name; }

    std::vector<std::pair<int, int>> candidates(const Rows& Q) const {
        const int m = rows_of(Q);
        nb::gil_scoped_release release;
        return kernel::candidates(model_, *variant_, Q.data(), m);
    }

    std::optional<Doubt> first(const Rows& Q, int start, int stop) const {
        require(0 <= start && start <= stop && stop <= rows_of(Q), "start <= stop <= rows");
        nb::gil_scoped_release release;
        return first_in_doubt(model_, *variant_, Q.data(), start, stop);
    }

    std::optional<Doubt> edge(std::vector<double> a, std::vector<double> b, int ends, int segments, int start,
                              int stop) const {
        const Edge edge = edge_of(std::move(a), std::move(b), ends, segments);
        require(0 <= start && start <= stop && stop <= edge.rows(), "start <= stop <= rows");
        nb::gil_scoped_release release;
        return first_in_doubt(model_, *variant_, edge, start, stop);
    }

    nb::object near(const Rows& Q, double within) const {
        const int m = rows_of(Q);
        require(std::isfinite(within), "a distance in metres");
        Near found;
        {
            nb::gil_scoped_release release;
            found = kernel::near(model_, Q.data(), m, within);
        }
        const std::size_t count = found.rows.size(), n = static_cast<std::size_t>(model_.dof);
        return nb::make_tuple(array_of(std::move(found.rows), {count}), array_of(std::move(found.pairs), {count}),
                              array_of(std::move(found.distances), {count}),
                              array_of(std::move(found.points), {count, 2, 3}),
                              array_of(std::move(found.gradients), {count, n}), found.asked);
    }

    void agree(std::vector<double> lower, std::vector<double> upper, std::vector<double> reach,
               const std::vector<std::pair<bool, double>>& rules) {
        const auto n = static_cast<std::size_t>(model_.dof);
        require(lower.size() == n && upper.size() == n && reach.size() == n && !rules.empty(), "terms of another robot");
        terms_ = Terms{std::move(lower), std::move(upper), std::move(reach), {}};
        for (const auto& [motion, step] : rules) {
            require(step > 0.0, "a step is positive");
            terms_.rules.push_back({motion, step});
        }
    }

    nb::object state(nb::handle q) const {
        std::vector<double> values;
        if (!read(q, values)) return nb::none();
        std::optional<Doubt> doubt;
        {
            nb::gil_scoped_release release;
            doubt = first_in_doubt(model_, *variant_, values.data(), 0, 1);
        }
        return doubt ? told(doubt) : nb::bool_(true);
    }

    nb::object ask(nb::handle q1, nb::handle q2, int known, int glance, int many) const {
        require(-1000 <= glance && glance <= 1000, "a glance is 0 to 1000 segments");
        require(0 < many, "at least one row");
        std::vector<double> a, b;
        if (!read(q1, a) || !read(q2, b)) return nb::none();
        const int segments = segments_of(terms_, a, b);
        if (segments == 0) return nb::none();
        const int ends = 3 & ~(a == b ? known | 2 : known);
        const Edge edge = edge_of(std::move(a), std::move(b), ends, segments);
        const int looked = edge.ends() + first_samples(segments, std::abs(glance));
        const int start = glance < 0 ? looked : 0, rows = glance > 0 ? looked : edge.rows();
        const int last = std::min(start + many, rows);
        std::optional<Doubt> doubt;
        {
            nb::gil_scoped_release release;
            doubt = first_in_doubt(model_, *variant_, edge, start, last);
        }
        if (!doubt && last == rows) return nb::int_(rows - start);
        if (doubt && doubt->deep) return nb::make_tuple(doubt->row - start, doubt->fraction, doubt->pairs.front());
        return nb::make_tuple(ends, segments, rows, doubt ? start : last, doubt ? 0 : last - start);
    }

    std::vector<std::vector<double>> samples(std::vector<double> a, std::vector<double> b, int segments) const {
        const Edge edge = edge_of(std::move(a), std::move(b), 0, segments);
        std::vector<std::vector<double>> out;
        for (const int k : bisection_order(segments, segments - 1)) {
            out.emplace_back(static_cast<std::size_t>(model_.dof));
            edge.sample(0, k, out.back().data());
        }
        return out;
    }

  private:
    Model model_;
    Terms terms_;
    const Variant* variant_ = nullptr;
    nb::object array_ = nb::module_::import_("numpy").attr("ndarray");

    // Whether q is n doubles, as a tuple or an array, within the limits.
    bool read(nb::handle q, std::vector<double>& out) const {
        const auto n = terms_.lower.size();
        if (n == 0) return false;
        out.resize(n);
        if (PyTuple_CheckExact(q.ptr())) {
            if (PyTuple_Size(q.ptr()) != static_cast<Py_ssize_t>(n)) return false;
            for (std::size_t k = 0; k < n; ++k) {
                PyObject* value = PyTuple_GetItem(q.ptr(), static_cast<Py_ssize_t>(k));
                if (!PyFloat_Check(value)) return false;
                out[k] = PyFloat_AsDouble(value);
            }
            return within(terms_, out);
        }
        if (!q.type().is(array_)) return false;  // others may hide entries
        Anything array;
        if (!nb::try_cast(q, array, false)) return false;
        if (array.ndim() != 1 || array.shape(0) != n || array.dtype() != nb::dtype<double>()) return false;
        const auto* values = static_cast<const double*>(array.data());
        for (std::size_t k = 0; k < n; ++k) out[k] = values[static_cast<std::int64_t>(k) * array.stride(0)];
        return within(terms_, out);
    }

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

    // Rows: parent, q_index, 1 for a slide; axis (3); placement, rotation (9) then position (3).
    void add_joints(const Rows& rows) {
        require(rows.shape(1) == 18, "18 numbers for each joint");
        require_finite(rows);
        const auto count = static_cast<std::int64_t>(rows.shape(0));
        model_.dof = static_cast<int>(count);
        for (std::int64_t k = 0; k < count; ++k) {
            const double* row = rows.data() + 18 * k;
            Joint joint{};
            joint.parent = whole(static_cast<std::int64_t>(row[0]), 0, k, "a parent comes before its child");
            joint.q_index = whole(static_cast<std::int64_t>(row[1]), 0, count - 1, "no such entry of q");
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
            require_finite(corners);
            const std::size_t count = corners.shape(0), padded = (count + LANES - 1) / LANES * LANES;
            model_.hulls.push_back(Hull{model_.corners.size(), padded});
            for (std::size_t k = 0; k < 3; ++k)
                for (std::size_t i = 0; i < padded; ++i)
                    model_.corners.push_back(corners.data()[3 * std::min(i, count - 1) + k]);
        }
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
            const int body = whole(static_cast<std::int64_t>(place[0]), -1, model_.dof, "no such body");
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
        std::int64_t with_world = 0;
        for (int k = 0; k < count; ++k) {
            const int i = whole(pairs.data()[2 * k], 0, riding - 1, "the first of a pair rides");
            const int j = whole(pairs.data()[2 * k + 1], 0, riding + standing - 1, "no such part");
            if (j < riding) {
                require(model_.own_pairs.empty() || model_.own_pairs.back().first <= i, "pairs go by their first");
                model_.own_pairs.push_back({i, j, k});
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

}  // namespace

NB_MODULE(_kernel, m) {
    nb::set_leak_warnings(false);  // a checker that lives as long as the process is no leak
    m.def("instruction_sets", [] {
        std::vector<std::string> names;
        for (const auto* found : variants()) names.emplace_back(found->name);
        return names;
    });
    nb::class_<Kernel>(m, "Kernel")
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
        .def("first", [](const Kernel& self, const Rows& Q, int start, int stop) {
            return told(self.first(Q, start, stop));
        })
        .def("edge", [](const Kernel& self, std::vector<double> a, std::vector<double> b, int ends, int segments,
                        int start, int stop) {
            return told(self.edge(std::move(a), std::move(b), ends, segments, start, stop));
        })
        .def("near", &Kernel::near)
        .def("agree", &Kernel::agree)
        .def("state", &Kernel::state, nb::arg("q").none())
        .def("ask", &Kernel::ask, nb::arg("q1").none(), nb::arg("q2").none(), nb::arg("known"), nb::arg("glance"),
             nb::arg("many"))
        .def("samples", &Kernel::samples);
}

}  // namespace kernel
