#include "graph.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace roadmap {

using arrays::Numbers;
using arrays::require;

namespace {

constexpr double max_points_per_edge = 1000.0;  // that of graph.py

std::int64_t checked(std::int64_t number, std::size_t count) {
    require(0 <= number && number < static_cast<std::int64_t>(count), "no such milestone or edge");
    return number;
}

}  // namespace

EdgePoints::EdgePoints(const arrays::Rows& milestones, const std::int64_t* edges, std::size_t count,
                       const arrays::Row& reach, double spacing)
    : n_(milestones.shape(1)), milestones_(milestones.data()), reach_(reach.data()) {
    require(reach.shape(0) == n_, "a reach for each joint");
    for (std::size_t edge = 0; edge < count; ++edge) {
        for (std::size_t k = 0; k < 2; ++k)
            ends_.push_back(static_cast<std::uint32_t>(checked(edges[2 * edge + k], milestones.shape(0))));
        const double *a = end(edge, 0), *b = end(edge, 1);
        double length = 0.0;
        for (std::size_t j = 0; j < n_; ++j) length += reach_[j] * std::abs(b[j] - a[j]);
        lengths_.push_back(length);
        parts_.push_back(static_cast<std::int32_t>(std::min(std::max(length / spacing, 1.0), max_points_per_edge)));
        points_ += points(edge);
        const auto number = static_cast<std::uint32_t>(edge);
        if (fans_.empty() || fans_.back().milestone != ends_[2 * edge]) fans_.push_back({ends_[2 * edge], number, number, 0.0});
        fans_.back().last = number + 1;
        fans_.back().longest = std::max(fans_.back().longest, length);
    }
}

void EdgePoints::motions(std::size_t edge, const double* q, std::vector<double>& found) const {
    const double *a = end(edge, 0), *b = end(edge, 1);
    const std::size_t count = points(edge), first = found.size();
    found.resize(first + count, 0.0);
    double* motion = found.data() + first;
    double shares[static_cast<std::size_t>(max_points_per_edge)];
    for (std::size_t k = 0; k < count; ++k) shares[k] = share(edge, k);
    for (std::size_t j = 0; j < n_; ++j)
        for (std::size_t k = 0; k < count; ++k) motion[k] += reach_[j] * std::abs(q[j] - (a[j] + (b[j] - a[j]) * shares[k]));
}

std::vector<double> EdgePoints::point(std::size_t edge, std::size_t k) const {
    const double *a = end(edge, 0), *b = end(edge, 1);
    std::vector<double> q(n_);
    for (std::size_t j = 0; j < n_; ++j) q[j] = a[j] + (b[j] - a[j]) * share(edge, k);
    return q;
}

Trunk::Trunk(const arrays::Rows& milestones, const arrays::NumberRows& edges, const arrays::Row& reach, double spacing,
             const Numbers& starts, const Numbers& other, const arrays::Row& lengths, const Numbers& numbers,
             const Numbers& components)
    : milestones_(milestones), reach_(reach), starts_(starts), other_(other), lengths_(lengths), numbers_(numbers),
      components_(components), points_(milestones, edges.data(), edges.shape(0), reach, spacing) {
    const std::size_t nodes = milestones.shape(0), rows = other.shape(0);
    require(edges.shape(1) == 2 && starts.shape(0) == nodes + 1 && components.shape(0) == nodes,
            "rows and a component of each milestone");
    require(lengths.shape(0) == rows && numbers.shape(0) == rows, "a length and an edge for each neighbour");
    require(starts.data()[0] == 0 && starts.data()[nodes] == static_cast<std::int64_t>(rows), "rows of all milestones");
    for (std::size_t k = 0; k < nodes; ++k) require(starts.data()[k] <= starts.data()[k + 1], "rows in order");
    for (std::size_t k = 0; k < rows; ++k) {
        checked(other.data()[k], nodes);
        checked(numbers.data()[k], edges.shape(0));
    }
    for (std::size_t j = 0; j < reach.shape(0); ++j)
        for (std::size_t k = 0; k < nodes; ++k) columns_.push_back(milestones.data()[k * reach.shape(0) + j]);
}

std::vector<double> Trunk::motions(const double* q) const {
    const std::size_t count = milestones_.shape(0);
    std::vector<double> found(count, 0.0);
    for (std::size_t j = 0; j < reach_.shape(0); ++j)
        for (std::size_t k = 0; k < count; ++k) found[k] += reach_.data()[j] * std::abs(q[j] - columns_[j * count + k]);
    return found;
}

Graph::Graph(const Trunk& trunk, const arrays::Rows& milestones, const arrays::NumberRows& edges, const arrays::Row& reach,
             double spacing, NeighboursOf added, std::unordered_map<std::int64_t, std::int64_t> merged)
    : trunk_(trunk), milestones_(milestones), edges_(edges), reach_(reach),
      added_points_(milestones, edges.data() + 2 * std::min(trunk.points().edges(), edges.shape(0)),
                    edges.shape(0) - std::min(trunk.points().edges(), edges.shape(0)), reach, spacing),
      added_(std::move(added)), merged_(std::move(merged)) {
    require(edges.shape(1) == 2 && trunk.size() <= this->milestones() && trunk.points().edges() <= edges.shape(0),
            "all milestones and edges of the trunk");
    for (const auto& [milestone, rows] : added_)
        for (const auto& [other, length, edge] : rows) {
            checked(other, milestones.shape(0));
            checked(edge, edges.shape(0));
        }
}

std::vector<double> Graph::motions(const double* q) const {
    auto found = trunk_.motions(q);
    for (auto k = trunk_.size(); k < milestones(); ++k) {
        double far = 0.0;
        for (std::size_t j = 0; j < dof(); ++j) far += reach()[j] * std::abs(q[j] - milestone(k)[j]);
        found.push_back(far);
    }
    return found;
}

std::int64_t Graph::component(std::int64_t milestone) const {
    std::int64_t known = milestone < trunk_.size() ? trunk_.component(milestone) : milestone + trunk_.size();
    for (auto found = merged_.find(known); found != merged_.end(); found = merged_.find(known)) known = found->second;
    return known;
}

}  // namespace roadmap
