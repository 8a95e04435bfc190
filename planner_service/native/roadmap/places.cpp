#include "places.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

namespace roadmap {

namespace {

using arrays::require;

constexpr double infinity = std::numeric_limits<double>::infinity();
// Those of query.py: how many are looked at, and how near all that are found certainly are.
constexpr std::size_t most = 1024;
constexpr double just_within = 1.0 - 1e-9;

// The first radius reaches this many milestones; the next ones are so much wider, and the last has no end.
constexpr std::size_t milestones_within = 2;
constexpr double wider = 1.3;
constexpr int times_widened = 5;
constexpr double rounding = 1e-13;

std::size_t limit(std::size_t count) { return count > most ? most : 0; }

}  // namespace

Places::Places(const Graph& graph, const Flags& offered, const Flags& free, bool few)
    : graph_(graph), offered_(offered), free_(free),
      most_{limit(static_cast<std::size_t>(graph.trunk().size())), few ? 0 : limit(graph.trunk().points().points())} {
    require(offered.shape(0) == static_cast<std::size_t>(graph.milestones()) &&
                free.shape(0) == static_cast<std::size_t>(graph.edges()), "a flag for each milestone and edge");
}

bool NearestPlaces::later(const Point& a, const Point& b) {
    if (a.far != b.far) return a.far > b.far;
    return std::tie(a.edge, a.milestone, a.k) > std::tie(b.edge, b.milestone, b.k);
}

NearestPlaces::NearestPlaces(const Places& places, std::vector<double> q)
    : places_(places), q_(std::move(q)), radius_(infinity), beyond_(infinity) {
    const auto& graph = places.graph();
    require(graph.dof() == q_.size(), "as many joints");
    far_ = graph.motions(q_.data());
    std::array<double, milestones_within> nearest;
    nearest.fill(infinity);
    double largest = 0.0;
    for (const double far : far_) {
        largest = std::max(largest, far);
        if (far >= nearest.back()) continue;
        nearest.back() = far;
        std::sort(nearest.begin(), nearest.end());
    }
    for (std::size_t j = 0; j < q_.size(); ++j) slack_ += graph.reach()[j] * std::abs(q_[j]);
    slack_ = rounding * (slack_ + largest);
    radius_ = -infinity;
    widen_to(nearest.back());
}

std::optional<Place> NearestPlaces::next() {
    // Whether a place is nearer than ``beyond_`` is known as soon as farther points were looked at.
    while (!ended_ && (found_.empty() || found_.front().far >= passed_ * just_within)) ended_ = !look_further();
    if (found_.empty() || found_.front().far >= beyond_) return std::nullopt;
    Place place = std::move(found_.front());
    found_.pop_front();
    return place;
}

// Take the nearest of the points that are left; false if there is none, or it is the last that is looked at.
bool NearestPlaces::look_further() {
    for (;;) {
        while (!edges_.empty() && (points_.empty() || edges_.front().least <= points_.front().far)) {
            const auto number = edges_.front().number;
            std::pop_heap(edges_.begin(), edges_.end(), farther);
            edges_.pop_back();
            open(number);
        }
        if (radius_ == infinity || (!points_.empty() && points_.front().far <= radius_)) break;
        widen_to(++widened_ < times_widened ? wider * radius_ : infinity);
    }
    if (points_.empty()) return false;
    const Point point = points_.front();
    std::pop_heap(points_.begin(), points_.end(), later);
    points_.pop_back();
    passed_ = point.far;
    const bool on_edge = point.edge >= 0;
    const auto number = static_cast<std::size_t>(on_edge ? point.edge : point.milestone);
    const bool counted = counts(on_edge, number);
    if (counted && ++looked_at_[on_edge] == places_.most()[on_edge]) {
        beyond_ = passed_ * just_within;
        return false;
    }
    if (!on_edge) {
        const double* q = places_.graph().milestone(point.milestone);
        if (places_.offered(number)) found_.push_back({point.far, -1, point.milestone, {q, q + q_.size()}});
        return true;
    }
    if (places_.free(number) && taken_.insert(point.edge).second) {
        const auto [points, edge] = points_on(number);
        found_.push_back({point.far, point.edge, -1, points.point(edge, point.k)});
    }
    if (counted) push_nearest_on(number, point.opened);
    return true;
}

// Whether a milestone, or the points on an edge, are among those of which only so many are looked at.
bool NearestPlaces::counts(bool on_edge, std::size_t number) const {
    const auto& trunk = places_.graph().trunk();
    return places_.most()[on_edge] > 0 && number < (on_edge ? trunk.points().edges() : static_cast<std::size_t>(trunk.size()));
}

// Look at the milestones, and where the edges begin, that are farther away than ``radius_`` and not farther than ``radius``.
void NearestPlaces::widen_to(double radius) {
    const auto within = [&](double far) { return radius_ < far && far <= radius; };
    for (std::size_t k = 0; k < far_.size(); ++k)
        if (within(far_[k]) && (places_.offered(k) || counts(false, k)))
            points_.push_back({far_[k], -1, static_cast<std::int64_t>(k), 0, 0});
    std::size_t first = 0;
    for (const auto* points : {&places_.graph().trunk().points(), &places_.graph().added_points()}) {
        points->each_within(radius + slack_, far_, [&](std::size_t edge, double motion) {
            const double least = motion - slack_;
            if (within(least) && (places_.free(first + edge) || counts(true, first + edge))) edges_.push_back({least, first + edge});
        });
        first += points->edges();
    }
    std::make_heap(points_.begin(), points_.end(), later);
    std::make_heap(edges_.begin(), edges_.end(), farther);
    radius_ = radius;
}

std::pair<const EdgePoints&, std::size_t> NearestPlaces::points_on(std::size_t edge) const {
    const auto& trunk = places_.graph().trunk().points();
    if (edge < trunk.edges()) return {trunk, edge};
    return {places_.graph().added_points(), edge - trunk.edges()};
}

void NearestPlaces::open(std::size_t number) {
    const auto [points, edge] = points_on(number);
    const std::size_t opened = motions_.size();
    points.motions(edge, q_.data(), motions_);
    push_nearest_on(number, opened);
}

void NearestPlaces::push_nearest_on(std::size_t number, std::size_t opened) {
    const auto [points, edge] = points_on(number);
    const auto first = motions_.begin() + static_cast<std::ptrdiff_t>(opened);
    const auto last = first + static_cast<std::ptrdiff_t>(points.points(edge));
    const auto nearest = std::min_element(first, last);  // the first of several
    if (nearest == last || *nearest == infinity) return;
    points_.push_back({*nearest, static_cast<std::int64_t>(number), -1, static_cast<std::size_t>(nearest - first), opened});
    std::push_heap(points_.begin(), points_.end(), later);
    *nearest = infinity;
}

}  // namespace roadmap
