// Searching as Python sees it (_core.pyi).
#include "search.hpp"

#include <nanobind/stl/map.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <limits>
#include <tuple>

#include "../collision/kernel.hpp"
#include "asked_oracle.hpp"
#include "balanced.hpp"
#include "constrained_oracle.hpp"
#include "edge_oracle.hpp"
#include "tiered_oracle.hpp"

namespace nb = nanobind;

namespace search {

namespace {

// What calls Python from a search that runs without the interpreter's lock.
EdgeOracle::Decide decide_by(nb::object ask) {
    return [ask](const Configuration& q, const std::vector<int>& pairs) {
        const nb::gil_scoped_acquire locked;
        return nb::cast<int>(ask(q, pairs));
    };
}

EdgeOracle::Poll poll_by(nb::object ask) {
    return [ask] {
        const nb::gil_scoped_acquire locked;
        ask();
    };
}

EdgeOracle::Split split_by(nb::object ask) {
    if (ask.is_none()) return {};
    return [ask](const Configuration& differences) {
        const nb::gil_scoped_acquire locked;
        return nb::cast<int>(ask(differences));
    };
}

nb::tuple tuple_of(const Configuration& q) { return nb::tuple(nb::cast(q)); }

std::function<bool(const Configuration&, const Configuration&, int)> edge_by(nb::object ask) {
    if (ask.is_none()) return {};
    return [ask](const Configuration& a, const Configuration& b, int known) {
        const nb::gil_scoped_acquire locked;
        return nb::cast<bool>(ask(tuple_of(a), tuple_of(b), known));
    };
}

AskedOracle::Answers answers_by(nb::object state, nb::object edge, nb::object coarse, nb::object last, nb::object poll) {
    return {[state](const Configuration& q) {
                const nb::gil_scoped_acquire locked;
                return nb::cast<bool>(state(tuple_of(q)));
            },
            edge_by(std::move(edge)), edge_by(std::move(coarse)),
            [last] {
                const nb::gil_scoped_acquire locked;
                return nb::cast<std::pair<double, int>>(last());
            },
            poll_by(std::move(poll))};
}

}  // namespace

void bind(nb::module_& m) {
    nb::class_<Oracle>(m, "Oracle")
        .def("state_is_free", &Oracle::state_is_free)
        .def("edge_is_free", &Oracle::edge_is_free)
        .def("edge_is_free_coarse", &Oracle::edge_is_free_coarse);
    nb::class_<AskedOracle, Oracle>(m, "AskedOracle")
        .def(
            "__init__",
            [](AskedOracle* self, nb::object state, nb::object edge, nb::object coarse, nb::object last, nb::object poll) {
                new (self) AskedOracle(answers_by(std::move(state), std::move(edge), std::move(coarse), std::move(last),
                                                  std::move(poll)));
            },
            nb::arg("state"), nb::arg("edge"), nb::arg("coarse").none(), nb::arg("last"), nb::arg("poll"));
    nb::class_<EdgeOracle, Oracle>(m, "EdgeOracle")
        .def(
            "__init__",
            [](EdgeOracle* self, nb::handle kernel, const std::vector<Configuration>& starts,
               const std::vector<Configuration>& goals, nb::object decide, nb::object poll,
               nb::object split) {
                const auto view = collision::view_of(kernel);
                new (self) EdgeOracle(view.model, view.variant, view.settings, starts, goals, decide_by(std::move(decide)),
                                      poll_by(std::move(poll)), split_by(std::move(split)));
            },
            nb::arg("kernel"), nb::arg("starts"), nb::arg("goals"), nb::arg("decide"), nb::arg("poll"), nb::arg("split").none(),
            nb::keep_alive<1, 2>())
        .def("allow", &EdgeOracle::allow)
        .def("take",
             [](EdgeOracle& self) {
                 auto tally = self.take();
                 return std::make_tuple(tally.states, tally.edges, std::move(tally.hits));
             })
        .def_prop_ro("spent", &EdgeOracle::spent)
        .def_prop_ro("refused", &EdgeOracle::refused)
        .def_prop_ro("last_fraction", &EdgeOracle::last_fraction)
        .def_prop_ro("last_pair", &EdgeOracle::last_pair)
        .def_prop_ro("motions", [](const EdgeOracle& self) {
            const auto both = [](const Motions& tried) { return std::make_pair(tried.free, tried.colliding); };
            return std::make_pair(both(self.starts_tried()), both(self.goals_tried()));
        });
    nb::class_<TieredOracle, Oracle>(m, "TieredOracle")
        .def(
            "__init__",
            [](TieredOracle* self, EdgeOracle& roomy, const std::vector<std::pair<Configuration, EdgeOracle*>>& tight,
               double near_end) {
                for (const auto& [q, oracle] : tight)
                    if (oracle == nullptr) throw std::invalid_argument("an oracle for each end");
                new (self) TieredOracle(roomy, tight, near_end);
            },
            nb::arg("roomy"), nb::arg("tight"), nb::arg("near_end"), nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>());
    nb::class_<ConstrainedOracle, Oracle>(m, "ConstrainedOracle")
        .def(nb::init<Oracle&, constraints::Projector&>(), nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>());
    nb::class_<BalancedSearch>(m, "BalancedSearch")
        .def(
            "__init__",
            [](BalancedSearch* self, Oracle& oracle, const Configuration& lower, const Configuration& upper,
               const Configuration& weights, double range, std::uint64_t seed, constraints::Projector* projector,
               double longest) {
                if (upper.size() != lower.size() || weights.size() != lower.size())
                    throw std::invalid_argument("a lower and an upper bound and a weight for each joint");
                new (self) BalancedSearch(oracle, Space(lower, upper, weights, projector), range, seed, longest);
            },
            nb::arg("oracle"), nb::arg("lower"), nb::arg("upper"), nb::arg("weights"), nb::arg("range"),
            nb::arg("seed"), nb::arg("projector") = nb::none(), nb::arg("longest") = std::numeric_limits<double>::infinity(), nb::keep_alive<1, 2>(), nb::keep_alive<1, 8>())
        .def("run", &BalancedSearch::run, nb::call_guard<nb::gil_scoped_release>())
        .def("grown", [](const BalancedSearch& self) {
            auto grown = self.grown();
            return std::make_pair(std::move(grown.milestones), std::move(grown.edges));
        });
}

}  // namespace search
