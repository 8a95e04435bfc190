// The places nearest to a configuration, as roadmap/query.py says.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <optional>
#include <unordered_set>
#include <utility>
#include <vector>

#include "graph.hpp"

namespace roadmap {

// A configuration on a roadmap, as ``Place`` in query.py.
struct Place {
    double far;
    std::int64_t edge, milestone;
    std::vector<double> q;
};

using Flags = arrays::Array<bool, 1>;

// The milestones and edges that a query may use. The graph outlives it.
class Places {
  public:
    // ``few`` of the trunk's edges are free: then there is no limit to the points on them that are looked at.
    Places(const Graph& graph, const Flags& offered, const Flags& free, bool few);

    const Graph& graph() const { return graph_; }
    bool offered(std::size_t milestone) const { return offered_.data()[milestone]; }
    bool free(std::size_t edge) const { return free_.data()[edge]; }
    // How many of the trunk's milestones and points on edges are looked at; 0 for all.
    const std::array<std::size_t, 2>& most() const { return most_; }

  private:
    const Graph& graph_;
    Flags offered_, free_;
    std::array<std::size_t, 2> most_;
};

// The places nearest to q one after the other: looks only as far as it is asked.
class NearestPlaces {
  public:
    NearestPlaces(const Places& places, std::vector<double> q);

    // The next place; none after the last.
    std::optional<Place> next();

  private:
    // A milestone, or the nearest point on an edge of those that were not passed yet.
    struct Point {
        double far;
        std::int64_t edge, milestone;
        std::size_t k, opened;  // its number on the edge; where the motions to the edge's points begin
    };
    struct Edge {
        double least;
        std::size_t number;
    };
    static bool later(const Point& a, const Point& b);
    static bool farther(const Edge& a, const Edge& b) { return a.least > b.least; }
    bool counts(bool on_edge, std::size_t number) const;
    std::pair<const EdgePoints&, std::size_t> points_on(std::size_t edge) const;
    void widen_to(double radius);
    void open(std::size_t edge);
    void push_nearest_on(std::size_t edge, std::size_t opened);
    bool look_further();

    const Places& places_;
    std::vector<double> q_;
    std::vector<double> far_;       // the motion to each milestone
    double radius_, slack_ = 0.0;   // what begins within the radius is in the heaps; rounding of where it begins
    int widened_ = 0;
    std::vector<Edge> edges_;       // heaps
    std::vector<Point> points_;
    std::vector<double> motions_;   // to the points on opened edges; infinite once passed
    std::deque<Place> found_;
    std::unordered_set<std::int64_t> taken_;  // edges with a place
    double passed_ = 0.0;                     // all nearer points were looked at
    double beyond_;                           // the places are those nearer than this
    bool ended_ = false;
    std::array<std::size_t, 2> looked_at_{};  // of the trunk's milestones, and of the points on its edges
};

}  // namespace roadmap
