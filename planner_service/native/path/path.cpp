#include "path.hpp"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <optional>
#include <tuple>
#include <utility>

#include "../arrays.hpp"

namespace nb = nanobind;

namespace path {

namespace {

using arrays::array_of;
using arrays::require;
using arrays::Row;
using arrays::Rows;

// Waypoints closer than this (rad) are one point: their direction would be rounding noise.
constexpr double merge = 1e-12;

// The same relative to the length: so that arc length grows with every waypoint in spite of rounding.
constexpr double merge_share = 2e-15;

// A larger change of any component of the tangent is a corner.
constexpr double collinear = 1e-12;

// Relative, of a coordinate. On a short piece it turns the tangent noticeably, which is no corner.
constexpr double rounding = 1e-15;

// If rounding may turn a tangent by more, a corner may be spread over many short pieces.
constexpr double noisy = 1e-9;

// Radians by which blends may overlap, relative to the wider: rounding.
constexpr double overshoot = 1e-9;

// Waypoints, row by row.
struct Points {
    std::size_t joints;
    std::vector<double> values;

    std::size_t count() const { return values.size() / joints; }
    const double* row(std::size_t k) const { return values.data() + k * joints; }
};

Points points_of(const Rows& rows) {
    require(rows.shape(0) > 0 && rows.shape(1) > 0, "at least one waypoint of one joint");
    return {rows.shape(1), {rows.data(), rows.data() + rows.size()}};
}

// L2 distance, summed joint by joint.
double distance(const double* a, const double* b, std::size_t joints) {
    double total = 0.0;
    for (std::size_t j = 0; j < joints; ++j) total += (b[j] - a[j]) * (b[j] - a[j]);
    return std::sqrt(total);
}

std::vector<double> steps_of(const Points& points) {
    std::vector<double> out;
    for (std::size_t k = 0; k + 1 < points.count(); ++k) out.push_back(distance(points.row(k), points.row(k + 1), points.joints));
    return out;
}

// The largest difference of two rows in any joint.
double change(const double* a, const double* b, std::size_t joints) {
    double most = 0.0;
    for (std::size_t j = 0; j < joints; ++j) most = std::max(most, std::fabs(b[j] - a[j]));
    return most;
}

// The points that do not coincide with the one before; the first and the last stay.
std::vector<std::size_t> apart(const Points& points, double near) {
    const std::size_t last = points.count() - 1;
    const auto away = [&](std::size_t a, std::size_t b) { return distance(points.row(a), points.row(b), points.joints); };
    std::vector<std::size_t> kept{0};
    for (std::size_t k = 1; k <= last; ++k)
        if (away(kept.back(), k) > near) kept.push_back(k);
    if (kept.back() != last) {
        while (kept.size() > 1 && away(kept.back(), last) <= near) kept.pop_back();
        if (away(kept.back(), last) > 0.0) kept.push_back(last);
    }
    return kept;
}

// The inner points at which a polyline turns.
std::vector<std::size_t> turns_of(const Points& points, const std::vector<double>& knots, const std::vector<double>& tangents) {
    const std::size_t n = points.joints, lines = points.count() - 1;
    std::vector<std::size_t> out;
    if (lines < 2) return out;
    double largest = 0.0;
    for (const double value : points.values) largest = std::max(largest, std::fabs(value));
    const double noise = rounding * largest;
    const auto length = [&](std::size_t k) { return knots[k + 1] - knots[k]; };
    const auto turn = [&](std::size_t a, std::size_t b) { return change(tangents.data() + a * n, tangents.data() + b * n, n); };
    std::vector<bool> turning(lines, false);  // by the line after it
    double noisiest = 0.0;
    for (std::size_t k = 1; k < lines; ++k) {
        const double here = noise * (1.0 / length(k) + 1.0 / length(k - 1));
        noisiest = std::max(noisiest, here);
        turning[k] = turn(k - 1, k) > collinear + here;
    }
    if (noisiest > noisy) {
        // Corners made of many pieces, each too short for an exact direction: each is compared with the longest since the last
        // corner, whose direction is the most exact.
        std::size_t best = 0;
        for (std::size_t k = 1; k < lines; ++k) {
            const bool turned = turn(best, k) > collinear + (noise / length(k) + noise / length(best));
            if (turned || turning[k] || length(k) >= length(best)) best = k;
            turning[k] = turning[k] || turned;
        }
    }
    for (std::size_t k = 1; k < lines; ++k)
        if (turning[k]) out.push_back(k);
    return out;
}

nb::object laid_polyline(const Rows& rows, bool merged) {
    Points points = points_of(rows);
    for (const double value : points.values)
        if (!std::isfinite(value)) return nb::none();
    std::vector<double> steps = steps_of(points);
    const double total = std::accumulate(steps.begin(), steps.end(), 0.0);
    if (!std::isfinite(total)) return nb::none();
    const double near = std::max(merge, merge_share * total);
    std::optional<std::vector<std::size_t>> kept;
    if (merged && !steps.empty() && !(*std::min_element(steps.begin(), steps.end()) > near)) {
        kept = apart(points, near);
        Points left{points.joints, {}};
        for (const std::size_t k : *kept) left.values.insert(left.values.end(), points.row(k), points.row(k) + points.joints);
        points = std::move(left);
        steps = steps_of(points);
    }
    const std::size_t n = points.joints, lines = steps.size();
    std::vector<double> knots{0.0}, tangents;
    for (const double step : steps) knots.push_back(knots.back() + step);
    for (std::size_t k = 0; k < lines; ++k)
        for (std::size_t j = 0; j < n; ++j) tangents.push_back((points.row(k + 1)[j] - points.row(k)[j]) / steps[k]);
    const auto turns = turns_of(points, knots, tangents);
    return nb::make_tuple(kept, array_of<const double>(std::move(knots), {lines + 1}),
                          array_of<const double>(std::move(tangents), {lines, n}), nb::tuple(nb::cast(turns)));
}

// Where blends of these widths cannot be: at a corner that turns back, or from a waypoint to the next, where they overlap.
std::pair<std::int64_t, std::int64_t> obstacle(std::size_t n, const std::vector<double>& blends, const Row& knots, const Rows& tangents) {
    for (std::size_t k = 1; k + 1 < blends.size(); ++k)
        if (blends[k] > 0.0 && turns_back(tangents.data() + (k - 1) * n, tangents.data() + k * n, n))
            return {static_cast<std::int64_t>(k), -1};
    bool refused = false;
    std::size_t worst = 0;
    double most = 0.0;
    for (std::size_t k = 0; k + 1 < blends.size(); ++k) {
        const double over = blends[k] + blends[k + 1] - (knots.data()[k + 1] - knots.data()[k]);
        refused = refused || over > overshoot * std::max(blends[k], blends[k + 1]);
        if (k == 0 || over > most) worst = k, most = over;
    }
    return {-1, refused ? static_cast<std::int64_t>(worst) : -1};
}

nb::object laid_blends(const Rows& waypoints, const Row& knots, const Rows& tangents, const std::vector<std::size_t>& turns,
                       const std::vector<double>& widths) {
    const std::size_t count = waypoints.shape(0), n = waypoints.shape(1);
    require(count > 0 && knots.shape(0) == count && widths.size() == count, "a knot and a width for each waypoint");
    require(tangents.shape(0) + 1 == count && tangents.shape(1) == n, "a tangent for each line");
    std::vector<double> blends(count, 0.0), breaks, table;
    for (const std::size_t k : turns) {
        require(k > 0 && k + 1 < count, "inner waypoints");
        blends[k] = widths[k];
    }
    const auto [back, over] = obstacle(n, blends, knots, tangents);
    if (back >= 0 || over >= 0) return nb::make_tuple(back, over, nb::none());
    std::vector<std::int64_t> lines, rows;
    std::int64_t row = -1;
    double at = 0.0;
    const auto piece = [&](std::size_t line, std::int64_t blend) {
        breaks.push_back(at);
        lines.push_back(static_cast<std::int64_t>(line));
        rows.push_back(blend);
    };
    for (std::size_t k = 0; k + 1 < count; ++k) {
        if (blends[k] > 0.0) {
            piece(k, ++row);
            at = knots.data()[k] + blends[k];
            table.insert(table.end(), {knots.data()[k], blends[k]});
            table.insert(table.end(), waypoints.data() + k * n, waypoints.data() + (k + 1) * n);
            table.insert(table.end(), tangents.data() + (k - 1) * n, tangents.data() + (k + 1) * n);
        }
        const double end = knots.data()[k + 1] - blends[k + 1];
        if (end > at) {
            piece(k, -1);
            at = end;
        }
    }
    breaks.push_back(knots.data()[count - 1]);
    const std::size_t pieces = lines.size(), blended = static_cast<std::size_t>(row + 1);
    return nb::make_tuple(
        back, over,
        nb::make_tuple(array_of<const double>(std::move(blends), {count}), array_of<const double>(std::move(breaks), {pieces + 1}),
                       array_of<const std::int64_t>(std::move(lines), {pieces}), array_of<const std::int64_t>(std::move(rows), {pieces}),
                       array_of<const double>(std::move(table), {blended, 2 + 3 * n})));
}

}  // namespace

void bind(nb::module_& m) {
    m.def("laid_polyline", &laid_polyline);
    m.def("laid_blends", &laid_blends);
    m.def("polyline_length", [](const Rows& points) { return arithmetic::exact_sum(steps_of(points_of(points))); });
    m.def("turns_back", [](const Rows& tangents) {
        require(tangents.shape(0) == 2, "the tangents before and after a corner");
        return turns_back(tangents.data(), tangents.data() + tangents.shape(1), tangents.shape(1));
    });
}

}  // namespace path
