// One query of a roadmap, as roadmap/query.py says.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <tuple>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include "../search/oracle.hpp"
#include "graph.hpp"
#include "places.hpp"

namespace roadmap {

using search::Configuration;
using Verdicts = arrays::Array<std::int8_t, 1>;
enum Verdict : std::int8_t { UNKNOWN = 0, FREE = 1, BLOCKED = 2, FREE_BEFORE = 3 };  // as in verdicts.py

class Query {
  public:
    // Which of some milestones and edges, FREE_BEFORE, are free still: first of the milestones, then of the edges.
    using Carried = std::function<std::vector<bool>(const std::vector<std::int64_t>&, const std::vector<std::int64_t>&)>;
    // The number of a milestone or edge, the verdict on it, and the pair that collides if it is BLOCKED.
    using Lesson = std::tuple<std::int64_t, int, int>;
    using Route = std::pair<std::vector<Configuration>, std::int64_t>;

    // All it is given but the verdicts, the start and the goals outlives it.
    Query(const Graph& graph, const Places& places, const Verdicts& milestones, const Verdicts& edges,
          const Configuration& start, const std::vector<Configuration>& goals, search::Oracle& oracle);

    // The path and the goal it reaches; none if the roadmap has none.
    std::optional<Route> route(const Carried& carried);

    // The new verdicts on milestones and on edges in the order in which they were found.
    const std::array<std::vector<Lesson>, 2>& learned() const { return learned_; }

  private:
    struct Step {
        std::int64_t from, to, piece;
    };
    struct End {
        std::int64_t node;
        Configuration q;
        NearestPlaces waiting;
        std::vector<std::int64_t> open;
        int tried = 0;
        std::deque<Place> shadowed;
        std::deque<Configuration> hits;
    };

    const double* at(std::int64_t node) const;
    Configuration configuration(std::int64_t node) const;
    double distance(const double* a, const double* b) const;
    double bound(std::int64_t node);
    std::int8_t verdict(std::int64_t node) const { return nodes_[static_cast<std::size_t>(node)]; }
    std::int8_t piece_verdict(std::int64_t piece) const { return pieces_[static_cast<std::size_t>(piece)]; }
    bool is_join(std::int64_t piece) const { return piece >= graph_.edges(); }
    std::pair<std::int64_t, std::int64_t> ends_of(std::int64_t piece) const;
    std::int64_t new_node(const double* q, Verdict verdict);
    Route traced(const std::vector<Step>& path) const;

    bool may_meet() const;
    std::unordered_set<std::int64_t> components(const End& end) const;
    bool widen();
    void join(End& end);
    void join_to(End& end, const Place& place);
    std::int64_t place_node(const Place& place);
    void link(std::int64_t a, std::int64_t b, double length, std::int64_t piece);
    bool in_shadow(const End& end, const double* q, const Configuration& hit) const;

    std::optional<std::vector<Step>> shortest();

    bool is_free(const std::vector<Step>& path, const Carried& carried);
    void carry(const std::vector<Step>& path, const Carried& carried);
    bool milestone_is_free(std::int64_t node);
    bool seems_free(std::int64_t piece);
    bool piece_is_free(std::int64_t piece);
    int known_ends(std::int64_t a, std::int64_t b) const { return (verdict(a) == FREE) + 2 * (verdict(b) == FREE); }
    void learn_node(std::int64_t node, Verdict verdict);
    void learn_piece(std::int64_t piece, Verdict verdict);
    void learn_join(std::int64_t piece, Verdict verdict);
    void paid(std::int64_t end, std::int64_t node, std::int64_t piece);
    void join_anywhere(End& end);
    std::tuple<bool, double, std::int64_t> promise(const End& end, std::int64_t piece);
    End& end_at(std::int64_t node) { return ends_[static_cast<std::size_t>(node - start_)]; }

    const Graph& graph_;
    const Places& places_;
    search::Oracle& oracle_;
    std::size_t dof_;
    std::vector<std::int8_t> nodes_, pieces_;
    std::vector<double> bounds_;  // from each node to the nearest goal, where they are known
    std::vector<Configuration> goals_;
    std::deque<Configuration> extra_;  // the nodes that are no milestones
    std::vector<std::pair<std::int64_t, std::int64_t>> joined_;  // the nodes of each joining edge
    std::unordered_map<std::int64_t, std::vector<Neighbour>> joins_;
    std::unordered_map<std::int64_t, std::vector<std::int64_t>> on_;  // the nodes on an edge
    std::unordered_set<std::int64_t> shaded_;  // joining edges that pass near a collision of another
    std::int64_t start_;
    std::deque<End> ends_;
    std::size_t at_once_ = 0;
    int effort_;
    std::array<std::vector<Lesson>, 2> learned_;
};

}  // namespace roadmap
