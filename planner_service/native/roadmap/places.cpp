// The places nearest to a configuration: one round of nearest_places of roadmap/nearest.py.
#include "places.hpp"

#include <nanobind/stl/pair.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <tuple>
#include <utility>
#include <vector>

#include "../arrays.hpp"

namespace nb = nanobind;

namespace roadmap {

namespace {

using arrays::Rows;
using arrays::Row;
using arrays::Numbers;
using Flags = arrays::Array<bool, 1>;
using arrays::require;

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double just_within = 1.0 - 1e-9;
constexpr std::size_t leaf_size = 16;

// A point that may be a place: of a milestone the edge is -1, of a point on an edge the milestone.
struct Candidate {
    double far;
    std::int64_t edge, milestone;
    const double* q;
};

// The points of a trunk, its milestones or those on its edges, in a k-d tree (Bentley, 1975).
class PlaceTree {
  public:
    PlaceTree(const Rows& points, const Numbers& edges, const Row& reach)
        : n_(points.shape(1)), order_(points.shape(0)), reach_(reach.data(), reach.data() + reach.shape(0)) {
        require(n_ == reach_.size() && edges.shape(0) == order_.size(), "an edge for each point, a reach for each joint");
        const double* given = points.data();
        require(std::all_of(given, given + points.size(), [](double x) { return std::isfinite(x); }), "a point that is not finite");
        std::iota(order_.begin(), order_.end(), 0);
        if (!order_.empty()) build(given, 0, order_.size());
        points_.reserve(points.size());
        for (const auto row : order_) {
            points_.insert(points_.end(), given + row * n_, given + (row + 1) * n_);
            edges_.push_back(edges.data()[row]);
        }
    }

    std::size_t size() const { return order_.size(); }
    const std::vector<double>& reach() const { return reach_; }

    // The nearest points to q, in the order of their rows.
    std::vector<Candidate> nearest(const double* q, std::size_t count) const {
        std::vector<std::pair<double, std::size_t>> best;  // a heap, the farthest first
        if (size() <= count)
            for (std::size_t k = 0; k < size(); ++k) best.emplace_back(motion(k, q), k);
        else
            look(0, q, count, best);
        std::sort(best.begin(), best.end(), [&](const auto& a, const auto& b) { return order_[a.second] < order_[b.second]; });
        std::vector<Candidate> found;
        for (const auto& [far, k] : best)
            found.push_back({far, edges_[k], edges_[k] < 0 ? static_cast<std::int64_t>(order_[k]) : -1, &points_[k * n_]});
        return found;
    }

  private:
    struct Node {
        std::size_t begin, end, right;  // the left child follows its parent; right is 0 in a leaf
    };

    double motion(std::size_t k, const double* q) const {
        double total = 0.0;
        for (std::size_t j = 0; j < n_; ++j) total += reach_[j] * std::abs(q[j] - points_[k * n_ + j]);
        return total;
    }

    // No more than the motion to any point in the node's box, in floating point too: each step of the sum is monotone.
    double least_motion(std::size_t node, const double* q) const {
        const double *low = &boxes_[2 * node * n_], *high = low + n_;
        double total = 0.0;
        for (std::size_t j = 0; j < n_; ++j) total += reach_[j] * std::max({0.0, low[j] - q[j], q[j] - high[j]});
        return total;
    }

    std::size_t build(const double* given, std::size_t begin, std::size_t end) {
        const std::size_t node = nodes_.size();
        nodes_.push_back({begin, end, 0});
        std::size_t widest = 0;
        double width = -1.0;
        boxes_.resize(boxes_.size() + 2 * n_);
        double *low = &boxes_[2 * node * n_], *high = low + n_;
        for (std::size_t j = 0; j < n_; ++j) {
            low[j] = infinity;
            high[j] = -infinity;
            for (std::size_t k = begin; k < end; ++k) {
                low[j] = std::min(low[j], given[order_[k] * n_ + j]);
                high[j] = std::max(high[j], given[order_[k] * n_ + j]);
            }
            if (reach_[j] * (high[j] - low[j]) > width) {
                width = reach_[j] * (high[j] - low[j]);
                widest = j;
            }
        }
        if (end - begin > leaf_size) {
            const auto at = [&](std::size_t k) { return order_.begin() + static_cast<std::ptrdiff_t>(k); };
            const std::size_t middle = begin + (end - begin) / 2;
            std::nth_element(at(begin), at(middle), at(end),
                             [&](std::size_t a, std::size_t b) { return given[a * n_ + widest] < given[b * n_ + widest]; });
            build(given, begin, middle);
            nodes_[node].right = build(given, middle, end);
        }
        return node;
    }

    void look(std::size_t node, const double* q, std::size_t count, std::vector<std::pair<double, std::size_t>>& best) const {
        const auto [begin, end, right] = nodes_[node];
        if (right == 0) {
            for (std::size_t k = begin; k < end; ++k) {
                const double far = motion(k, q);
                if (best.size() == count) {
                    if (far >= best.front().first) continue;
                    std::pop_heap(best.begin(), best.end());
                    best.pop_back();
                }
                best.emplace_back(far, k);
                std::push_heap(best.begin(), best.end());
            }
            return;
        }
        std::pair<double, std::size_t> near{least_motion(node + 1, q), node + 1}, away{least_motion(right, q), right};
        if (away.first < near.first) std::swap(near, away);
        for (const auto& [least, child] : {near, away})
            if (best.size() < count || least < best.front().first) look(child, q, count, best);
    }

    std::size_t n_;
    std::vector<std::size_t> order_;  // the row of each point
    std::vector<double> reach_, points_, boxes_;
    std::vector<std::int64_t> edges_;
    std::vector<Node> nodes_;
};

// Places beside those of the trees: milestones and points on edges, those of each edge one after the other.
class MorePlaces {
  public:
    MorePlaces(const Rows& points, const Numbers& edges, const Numbers& milestones)
        : points_(points), edges_(edges), milestones_(milestones) {
        require(edges.shape(0) == size() && milestones.shape(0) == size(), "an edge and a milestone for each point");
    }

    std::size_t size() const { return points_.shape(0); }
    std::size_t n() const { return points_.shape(1); }
    Candidate at(std::size_t row) const {
        return {0.0, edges_.data()[row], milestones_.data()[row], points_.data() + row * n()};
    }

  private:
    Rows points_;
    Numbers edges_, milestones_;
};

// The places found and whether there are no others.
std::pair<nb::list, bool> nearest_places(const PlaceTree& milestones, const PlaceTree* on_edges, const MorePlaces& more,
                                         const Flags& offered, const Flags& free, const Row& q, std::size_t count) {
    const std::size_t n = q.shape(0);
    const auto& reach = milestones.reach();
    require(reach.size() == n && (on_edges == nullptr || on_edges->reach().size() == n) && more.n() == n, "as many joints");
    std::vector<Candidate> found;  // one for each edge, whose points follow each other
    const auto take = [&](const Candidate& candidate) {
        const auto [number, flags] = candidate.edge < 0 ? std::pair{candidate.milestone, &offered} : std::pair{candidate.edge, &free};
        require(0 <= number && number < static_cast<std::int64_t>(flags->shape(0)), "no such milestone or edge");
        if (!flags->data()[number]) return;
        if (candidate.edge < 0 || found.empty() || found.back().edge != candidate.edge)
            found.push_back(candidate);
        else if (candidate.far < found.back().far)
            found.back() = candidate;
    };
    double beyond = infinity;  // a motion from q within which there are no others
    for (const auto* tree : {&milestones, on_edges}) {
        if (tree == nullptr) continue;
        double farthest = 0.0;
        for (const auto& candidate : tree->nearest(q.data(), count)) {
            farthest = std::max(farthest, candidate.far);
            take(candidate);
        }
        if (tree->size() > count) beyond = std::min(beyond, farthest * just_within);
    }
    for (std::size_t row = 0; row < more.size(); ++row) {
        auto candidate = more.at(row);
        for (std::size_t j = 0; j < n; ++j) candidate.far += reach[j] * std::abs(q.data()[j] - candidate.q[j]);
        take(candidate);
    }
    const auto others = [&](const Candidate& candidate) { return candidate.far >= beyond; };
    found.erase(std::remove_if(found.begin(), found.end(), others), found.end());
    const auto key = [](const Candidate& c) { return std::tuple{c.far, c.edge, c.milestone}; };
    std::sort(found.begin(), found.end(), [&](const auto& a, const auto& b) { return key(a) < key(b); });
    nb::list places;
    for (const auto& [far, edge, milestone, point] : found) {
        nb::list at;
        for (std::size_t j = 0; j < n; ++j) at.append(point[j]);
        places.append(nb::make_tuple(far, edge, milestone, nb::tuple(at)));
    }
    return {places, beyond == infinity};
}

}  // namespace

void bind_places(nb::module_& m) {
    nb::class_<PlaceTree>(m, "PlaceTree")
        .def(nb::init<const Rows&, const Numbers&, const Row&>(), nb::call_guard<nb::gil_scoped_release>());
    nb::class_<MorePlaces>(m, "MorePlaces").def(nb::init<const Rows&, const Numbers&, const Numbers&>());
    m.def("nearest_places", &nearest_places, nb::arg(), nb::arg().none(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg());
}

}  // namespace roadmap
