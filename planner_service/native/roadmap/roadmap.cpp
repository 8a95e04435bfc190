// Queries of a roadmap as Python sees them (_core.pyi).
#include "roadmap.hpp"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unordered_map.h>
#include <nanobind/stl/vector.h>

#include "graph.hpp"
#include "places.hpp"
#include "query.hpp"

namespace nb = nanobind;

namespace roadmap {

void bind(nb::module_& m) {
    using arrays::NumberRows, arrays::Numbers, arrays::Row, arrays::Rows;
    nb::class_<Trunk>(m, "RoadmapTrunk")
        .def(nb::init<const Rows&, const NumberRows&, const Row&, double, const Numbers&, const Numbers&, const Row&,
                      const Numbers&, const Numbers&>());
    nb::class_<Graph>(m, "RoadmapGraph")
        .def(nb::init<const Trunk&, const Rows&, const NumberRows&, const Row&, double, NeighboursOf,
                      std::unordered_map<std::int64_t, std::int64_t>>(), nb::keep_alive<1, 2>());
    nb::class_<Places>(m, "Places")
        .def(nb::init<const Graph&, const Flags&, const Flags&, bool>(), nb::keep_alive<1, 2>());
    nb::class_<NearestPlaces>(m, "NearestPlaces")
        .def(nb::init<const Places&, std::vector<double>>(), nb::keep_alive<1, 2>())
        .def("next", [](NearestPlaces& self) {
            const auto found = self.next();
            if (!found) return nb::object(nb::none());
            return nb::object(nb::make_tuple(found->far, found->edge, found->milestone, nb::tuple(nb::cast(found->q))));
        });
    nb::class_<Query>(m, "RoadmapQuery")
        .def(nb::init<const Graph&, const Places&, const Verdicts&, const Verdicts&, const Configuration&,
                      const std::vector<Configuration>&, search::Oracle&>(),
             nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>(), nb::keep_alive<1, 8>())
        .def("route", [](Query& self, nb::object ask) {
            Query::Carried carried;
            if (!ask.is_none())
                carried = [&ask](const std::vector<std::int64_t>& milestones, const std::vector<std::int64_t>& edges) {
                    const nb::gil_scoped_acquire locked;
                    return nb::cast<std::vector<bool>>(ask(milestones, edges));
                };
            const nb::gil_scoped_release unlocked;
            return self.route(carried);
        }, nb::arg("carried").none())
        .def_prop_ro("learned", [](const Query& self) { return std::make_pair(self.learned()[0], self.learned()[1]); });
}

}  // namespace roadmap
