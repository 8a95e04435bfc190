// A roadmap's milestones and edges as a query reads them: ``Graph`` of roadmap/graph.py.
#pragma once

#include <cstdint>
#include <tuple>
#include <unordered_map>
#include <vector>

#include "../arrays.hpp"

namespace roadmap {

// Some edges and the points along them, as ``EdgePoints`` of graph.py has them. The points are computed when needed: reading
// them from memory would take longer.
class EdgePoints {
  public:
    // ``edges`` are pairs of rows of ``milestones``, which outlive it.
    EdgePoints(const arrays::Rows& milestones, const std::int64_t* edges, std::size_t count, const arrays::Row& reach,
               double spacing);

    std::size_t edges() const { return lengths_.size(); }
    std::size_t points() const { return points_; }
    std::size_t points(std::size_t edge) const { return static_cast<std::size_t>(parts_[edge] - 1); }
    // Calls ``visit(edge, least)`` for each edge that begins within a radius of where the milestones are ``far``: ``least``, at
    // most the motion to any point on it but for rounding, is the motion to the box around it.
    template <typename Visit>
    void each_within(double radius, const std::vector<double>& far, Visit visit) const {
        for (const auto& [milestone, first, last, longest] : fans_) {
            if (far[milestone] - longest > radius) continue;
            for (auto edge = first; edge < last; ++edge) {
                const double least = 0.5 * (far[milestone] + far[ends_[2 * edge + 1]] - lengths_[edge]);
                if (least <= radius) visit(edge, least);
            }
        }
    }
    // Appends the motion from q to each point on an edge.
    void motions(std::size_t edge, const double* q, std::vector<double>& found) const;
    std::vector<double> point(std::size_t edge, std::size_t k) const;

  private:
    double share(std::size_t edge, std::size_t k) const { return static_cast<double>(k + 1) / static_cast<double>(parts_[edge]); }
    const double* end(std::size_t edge, std::size_t k) const { return milestones_ + ends_[2 * edge + k] * n_; }

    // Edges one after the other from the same milestone.
    struct Fan {
        std::uint32_t milestone, first, last;
        double longest;
    };

    std::size_t n_, points_ = 0;
    const double *milestones_, *reach_;
    std::vector<std::uint32_t> ends_;
    std::vector<double> lengths_;  // in metres of motion
    std::vector<std::int32_t> parts_;
    std::vector<Fan> fans_;
};

// A trunk: the neighbours of each milestone, one milestone after the other, its component, and the points on its edges.
class Trunk {
  public:
    Trunk(const arrays::Rows& milestones, const arrays::NumberRows& edges, const arrays::Row& reach, double spacing,
          const arrays::Numbers& starts, const arrays::Numbers& other, const arrays::Row& lengths,
          const arrays::Numbers& numbers, const arrays::Numbers& components);

    std::int64_t size() const { return static_cast<std::int64_t>(components_.shape(0)); }
    const EdgePoints& points() const { return points_; }
    // The motion from q to each milestone.
    std::vector<double> motions(const double* q) const;
    std::int64_t component(std::int64_t milestone) const { return components_.data()[milestone]; }

    template <typename Visit>
    void each(std::int64_t milestone, Visit visit) const {
        for (auto k = starts_.data()[milestone]; k < starts_.data()[milestone + 1]; ++k)
            visit(other_.data()[k], lengths_.data()[k], numbers_.data()[k]);
    }

  private:
    arrays::Rows milestones_;
    arrays::Row reach_;
    std::vector<double> columns_;  // the milestones' values of the first joint, of the second, ...
    arrays::Numbers starts_, other_;
    arrays::Row lengths_;
    arrays::Numbers numbers_, components_;
    EdgePoints points_;
};

using Neighbour = std::tuple<std::int64_t, double, std::int64_t>;  // the other end of a piece, its length, its number
using NeighboursOf = std::unordered_map<std::int64_t, std::vector<Neighbour>>;

class Graph {
  public:
    // ``added`` and ``merged`` are those of graph.py; ``spacing`` is between points on added edges. The trunk outlives it.
    Graph(const Trunk& trunk, const arrays::Rows& milestones, const arrays::NumberRows& edges, const arrays::Row& reach,
          double spacing, NeighboursOf added, std::unordered_map<std::int64_t, std::int64_t> merged);

    std::int64_t milestones() const { return static_cast<std::int64_t>(milestones_.shape(0)); }
    std::int64_t edges() const { return static_cast<std::int64_t>(edges_.shape(0)); }
    std::size_t dof() const { return milestones_.shape(1); }
    const double* milestone(std::int64_t k) const { return milestones_.data() + static_cast<std::size_t>(k) * dof(); }
    const std::int64_t* ends(std::int64_t edge) const { return edges_.data() + 2 * edge; }
    const double* reach() const { return reach_.data(); }
    std::int64_t component(std::int64_t milestone) const;
    const Trunk& trunk() const { return trunk_; }
    const EdgePoints& added_points() const { return added_points_; }
    // The motion from q to each milestone.
    std::vector<double> motions(const double* q) const;

    // All neighbours of a milestone: their number, the length of the edge and its number.
    template <typename Visit>
    void each(std::int64_t milestone, Visit visit) const {
        if (milestone < trunk_.size()) trunk_.each(milestone, visit);
        const auto found = added_.find(milestone);
        if (found == added_.end()) return;
        for (const auto& [other, length, edge] : found->second) visit(other, length, edge);
    }

  private:
    const Trunk& trunk_;
    arrays::Rows milestones_;
    arrays::NumberRows edges_;
    arrays::Row reach_;
    EdgePoints added_points_;
    NeighboursOf added_;
    std::unordered_map<std::int64_t, std::int64_t> merged_;
};

}  // namespace roadmap
