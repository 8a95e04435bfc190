// Smoothing as Python sees it (_core.pyi).
#include <nanobind/stl/vector.h>

#include "../arrays.hpp"
#include "smoothing.hpp"

namespace nb = nanobind;

namespace smoothing {

namespace {

using arrays::array_of;
using arrays::require;
using arrays::Row;
using arrays::Rows;

Polyline polyline_of(const Rows& rows) {
    require(rows.shape(0) > 0, "at least one waypoint");
    Polyline out;
    for (std::size_t k = 0; k < rows.shape(0); ++k)
        out.emplace_back(rows.data() + k * rows.shape(1), rows.data() + (k + 1) * rows.shape(1));
    return out;
}

// A read-only array.
nb::object matrix_of(const Polyline& polyline) {
    std::vector<double> values;
    for (const auto& q : polyline) values.insert(values.end(), q.begin(), q.end());
    return array_of<const double>(std::move(values), {polyline.size(), polyline.front().size()});
}

// Calls ``smooth`` while other threads may run Python.
template <class Smooth>
nb::object smoothed(const Rows& waypoints, Smooth smooth) {
    Polyline polyline = polyline_of(waypoints);
    {
        const nb::gil_scoped_release released;
        polyline = smooth(polyline);
    }
    return matrix_of(polyline);
}

}  // namespace

void bind(nb::module_& m) {
    m.def("shortcut", [](const Rows& waypoints, search::Oracle& oracle, const std::vector<double>& draws, int misses) {
        return smoothed(waypoints, [&](const Polyline& chain) { return shortcut(chain, oracle, draws, misses); });
    });
    m.def("shortcut_on", [](const Rows& waypoints, search::ConstrainedOracle& oracle, const std::vector<double>& draws, int misses,
                            double longest) {
        return smoothed(waypoints, [&](const Polyline& chain) { return shortcut_on(chain, oracle, draws, misses, longest); });
    });
    m.def("pulled_in", [](const Rows& waypoints, search::Oracle& oracle) {
        return smoothed(waypoints, [&](const Polyline& chain) { return pulled_in(chain, oracle); });
    });
    m.def("without_short_pieces", [](const Rows& waypoints, search::Oracle& oracle) {
        return smoothed(waypoints, [&](const Polyline& chain) { return without_short_pieces(chain, oracle); });
    });
    m.def("blend_widths", [](const Rows& waypoints, const Row& knots, const Rows& tangents, std::vector<std::int64_t> corners,
                             const Row& sizes, search::Oracle& oracle, double least) {
        const std::size_t count = waypoints.shape(0), n = waypoints.shape(1);
        require(count > 0 && knots.shape(0) == count && sizes.shape(0) == count, "a knot and a size for each waypoint");
        require(tangents.shape(0) + 1 == count && tangents.shape(1) == n, "a tangent for each line");
        require(least > 0.0, "a positive width");
        for (const std::int64_t k : corners) require(k > 0 && k + 1 < static_cast<std::int64_t>(count), "no such corner");
        const Corners path{n, count, waypoints.data(), knots.data(), tangents.data(), std::move(corners), sizes.data()};
        const nb::gil_scoped_release released;
        return blend_widths(path, oracle, least);
    });
}

}  // namespace smoothing
