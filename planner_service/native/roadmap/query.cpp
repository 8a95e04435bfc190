#include "query.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <queue>

namespace roadmap {

namespace {

// These are those of roadmap/query.py.
constexpr std::size_t JOINS_AT_ONCE = 4, HITS = 12;
constexpr int MAX_JOINS = 48, NODES_PER_POLL = 256, MAX_NODES = 50'000;
constexpr double DETOUR = 4.0, GREED = 3.0, UNKNOWN_AS = 2.0, SHADOW = 0.06;

constexpr double NOT_KNOWN = -1.0;  // the distance from a node to the goals

}  // namespace

Query::Query(const Graph& graph, const Places& places, const Verdicts& milestones, const Verdicts& edges,
             const Configuration& start, const std::vector<Configuration>& goals, search::Oracle& oracle)
    : graph_(graph), places_(places), oracle_(oracle), dof_(graph.dof()),
      nodes_(milestones.data(), milestones.data() + milestones.size()), pieces_(edges.data(), edges.data() + edges.size()),
      bounds_(nodes_.size(), NOT_KNOWN), goals_(goals), start_(graph.milestones()), effort_(MAX_NODES) {
    const auto fits = [&](const Configuration& q) { return q.size() == dof_; };
    arrays::require(nodes_.size() == static_cast<std::size_t>(graph.milestones()) &&
                        pieces_.size() == static_cast<std::size_t>(graph.edges()), "a verdict on each milestone and edge");
    arrays::require(fits(start) && !goals.empty() && std::all_of(goals.begin(), goals.end(), fits), "as many joints");
    const auto add = [&](const Configuration& q) {
        ends_.push_back({new_node(q.data(), FREE), q, NearestPlaces(places_, q), {}, 0, {}, {}});
    };
    add(start);
    for (const auto& goal : goals_) add(goal);
}

std::optional<Query::Route> Query::route(const Carried& carried) {
    for (;;) {
        oracle_.poll();
        const auto path = may_meet() ? shortest() : std::nullopt;
        if (!path) {
            if (effort_ <= 0 || !widen()) return std::nullopt;
        } else if (is_free(*path, carried)) {
            return traced(*path);
        }
    }
}

// The configurations along a path. Places inside an edge where it neither joins nor leaves it are not among them.
Query::Route Query::traced(const std::vector<Step>& path) const {
    std::vector<Configuration> points{configuration(start_)};
    for (std::size_t k = 0; k < path.size(); ++k) {
        if (k + 1 < path.size() && path[k].piece == path[k + 1].piece) continue;
        auto q = configuration(path[k].to);
        if (q != points.back()) points.push_back(std::move(q));
    }
    return {std::move(points), path.back().to - start_ - 1};
}

const double* Query::at(std::int64_t node) const {
    return node < start_ ? graph_.milestone(node) : extra_[static_cast<std::size_t>(node - start_)].data();
}

Configuration Query::configuration(std::int64_t node) const { return {at(node), at(node) + dof_}; }

double Query::distance(const double* a, const double* b) const {
    double total = 0.0;
    for (std::size_t j = 0; j < dof_; ++j) total += (b[j] - a[j]) * (b[j] - a[j]);
    return std::sqrt(total);
}

double Query::bound(std::int64_t node) {
    double& least = bounds_[static_cast<std::size_t>(node)];
    if (least == NOT_KNOWN) {
        least = std::numeric_limits<double>::infinity();
        for (const auto& goal : goals_) least = std::min(least, distance(at(node), goal.data()));
    }
    return least;
}

std::pair<std::int64_t, std::int64_t> Query::ends_of(std::int64_t piece) const {
    if (is_join(piece)) return joined_[static_cast<std::size_t>(piece - graph_.edges())];
    const auto* ends = graph_.ends(piece);
    return {ends[0], ends[1]};
}

std::int64_t Query::new_node(const double* q, Verdict verdict) {
    extra_.emplace_back(q, q + dof_);
    nodes_.push_back(verdict);
    bounds_.push_back(NOT_KNOWN);
    return static_cast<std::int64_t>(nodes_.size()) - 1;
}

// Whether the start and a goal are joined to one component.
bool Query::may_meet() const {
    const auto first = components(ends_.front());
    for (std::size_t k = 1; k < ends_.size(); ++k)
        for (const auto component : components(ends_[k]))
            if (first.count(component) != 0) return true;
    return false;
}

std::unordered_set<std::int64_t> Query::components(const End& end) const {
    std::unordered_set<std::int64_t> found;
    for (const auto piece : end.open) {
        const auto node = ends_of(piece).second;
        // The first neighbours of a place are the ends of its edge.
        found.insert(graph_.component(node < start_ ? node : std::get<0>(joins_.at(node).front())));
    }
    return found;
}

bool Query::widen() {
    const std::size_t before = joined_.size();
    at_once_ += JOINS_AT_ONCE;
    for (auto& end : ends_) join(end);
    return joined_.size() > before;
}

// Join an end to as many places as allowed at a time, those in the shadow of a collision last.
void Query::join(End& end) {
    while (end.open.size() < at_once_ && end.tried < MAX_JOINS) {
        oracle_.poll();
        auto place = end.waiting.next();
        if (!place) {
            if (end.shadowed.empty()) return;
            place = end.shadowed.front();
            end.shadowed.pop_front();
        } else if (std::any_of(end.hits.begin(), end.hits.end(),
                               [&](const auto& hit) { return in_shadow(end, place->q.data(), hit); })) {
            end.shadowed.push_back(*place);
            continue;
        }
        join_to(end, *place);
    }
}

void Query::join_to(End& end, const Place& place) {
    ++end.tried;
    const auto node = place.edge < 0 ? place.milestone : place_node(place);
    const auto piece = static_cast<std::int64_t>(pieces_.size());
    pieces_.push_back(place.q == end.q ? FREE : UNKNOWN);
    joined_.emplace_back(end.node, node);
    end.open.push_back(piece);
    link(end.node, node, distance(end.q.data(), place.q.data()) + DETOUR * place.far, piece);
}

// A new node on an edge, joined along it to the edge's milestones and to other such nodes.
std::int64_t Query::place_node(const Place& place) {
    const auto node = new_node(place.q.data(), UNKNOWN);
    const auto* ends = graph_.ends(place.edge);
    auto& on = on_[place.edge];
    const auto along = [&](std::int64_t other) { link(node, other, distance(place.q.data(), at(other)), place.edge); };
    along(ends[0]);
    along(ends[1]);
    for (const auto other : on) along(other);
    on.push_back(node);
    return node;
}

void Query::link(std::int64_t a, std::int64_t b, double length, std::int64_t piece) {
    joins_[a].emplace_back(b, length, piece);
    joins_[b].emplace_back(a, length, piece);
}

// Whether the edge from an end to q passes near the collision of another one, given relative to that end in metres.
bool Query::in_shadow(const End& end, const double* q, const Configuration& hit) const {
    const double* reach = graph_.reach();
    const auto along = [&](std::size_t j) { return reach[j] * (q[j] - end.q[j]); };
    double square = 0.0, dot = 0.0, away = 0.0;
    for (std::size_t j = 0; j < dof_; ++j) {
        square += along(j) * along(j);
        dot += along(j) * hit[j];
    }
    const double share = square > 0.0 ? std::min(std::max(dot / square, 0.0), 1.0) : 0.0;
    for (std::size_t j = 0; j < dof_; ++j) away += std::abs(hit[j] - share * along(j));
    return away < SHADOW;
}

// Weighted A* (Pohl, 1970) over edges not known to be blocked. Of equal costs the smaller node wins.
std::optional<std::vector<Query::Step>> Query::shortest() {
    struct Reached {
        double cost = std::numeric_limits<double>::infinity();
        std::int64_t from = -1, piece = -1;
    };
    const auto last_end = start_ + static_cast<std::int64_t>(goals_.size());
    std::vector<Reached> nodes(nodes_.size());
    const auto reached = [&](std::int64_t node) -> Reached& { return nodes[static_cast<std::size_t>(node)]; };
    reached(start_).cost = 0.0;
    using Entry = std::tuple<double, std::int64_t, double>;  // least length of a path over it, node, its cost
    std::priority_queue<Entry, std::vector<Entry>, std::greater<>> front;
    front.emplace(GREED * bound(start_), start_, 0.0);
    double best = std::numeric_limits<double>::infinity();
    while (!front.empty()) {
        const auto node = std::get<1>(front.top());
        const auto spent = std::get<2>(front.top());
        front.pop();
        if (spent > reached(node).cost) continue;  // a shorter path to this node was found since
        if (start_ < node && node <= last_end) {
            std::vector<Step> steps;
            for (auto to = node; reached(to).piece >= 0; to = reached(to).from)
                steps.push_back({reached(to).from, to, reached(to).piece});
            std::reverse(steps.begin(), steps.end());
            return steps;
        }
        if (--effort_ <= 0) return std::nullopt;
        if (effort_ % NODES_PER_POLL == 0) oracle_.poll();
        const auto visit = [&, node, spent](std::int64_t other, double length, std::int64_t piece) {
            const double total = spent + (piece_verdict(piece) == FREE ? length : UNKNOWN_AS * length);
            if (reached(other).cost <= total) return;
            if (piece_verdict(piece) == BLOCKED || verdict(other) == BLOCKED) return;
            const double ahead = bound(other);
            if (total + ahead >= best) return;
            if (start_ < other && other <= last_end) best = total;
            reached(other) = {total, node, piece};
            front.emplace(total + GREED * ahead, other, total);
        };
        if (node < start_) graph_.each(node, visit);
        const auto more = joins_.find(node);
        if (more == joins_.end()) continue;
        for (const auto& [other, length, piece] : more->second) visit(other, length, piece);
    }
    return std::nullopt;
}

// Check what is unknown on a path: its milestones, then every piece coarsely, then the rest of each piece.
bool Query::is_free(const std::vector<Step>& path, const Carried& carried) {
    if (carried) carry(path, carried);
    for (const auto& step : path)
        for (const auto node : {step.from, step.to})
            if (node < start_ && !milestone_is_free(node)) return false;
    std::vector<std::int64_t> pieces;
    for (const auto& step : path)
        if (piece_verdict(step.piece) != FREE) pieces.push_back(step.piece);
    std::sort(pieces.begin(), pieces.end(), std::greater<>());  // those that join the ends first
    pieces.erase(std::unique(pieces.begin(), pieces.end()), pieces.end());
    for (const auto judge : {&Query::seems_free, &Query::piece_is_free})
        for (const auto piece : pieces) {
            if ((this->*judge)(piece)) continue;
            if (is_join(piece)) join_anywhere(end_at(ends_of(piece).first));
            return false;
        }
    return true;
}

// Keep what was free before and is proven untouched since.
void Query::carry(const std::vector<Step>& path, const Carried& carried) {
    std::vector<std::int64_t> nodes, pieces;
    for (const auto& step : path) {
        for (const auto node : {step.from, step.to})
            if (verdict(node) == FREE_BEFORE) nodes.push_back(node);
        if (piece_verdict(step.piece) == FREE_BEFORE) pieces.push_back(step.piece);
    }
    for (auto* numbers : {&nodes, &pieces}) {
        std::sort(numbers->begin(), numbers->end());
        numbers->erase(std::unique(numbers->begin(), numbers->end()), numbers->end());
    }
    if (nodes.empty() && pieces.empty()) return;
    const auto still = carried(nodes, pieces);
    arrays::require(still.size() == nodes.size() + pieces.size(), "an answer for each milestone and edge");
    for (std::size_t k = 0; k < nodes.size(); ++k)
        if (still[k]) learn_node(nodes[k], FREE);
    for (std::size_t k = 0; k < pieces.size(); ++k)
        if (still[nodes.size() + k]) learn_piece(pieces[k], FREE);
}

bool Query::milestone_is_free(std::int64_t node) {
    if (verdict(node) != FREE) learn_node(node, oracle_.state_is_free(configuration(node)) ? FREE : BLOCKED);
    return verdict(node) == FREE;
}

bool Query::seems_free(std::int64_t piece) {
    if (!oracle_.glances()) return piece_is_free(piece);
    const auto [a, b] = ends_of(piece);
    const bool free = oracle_.edge_is_free_coarse(configuration(a), configuration(b), known_ends(a, b));
    if (!free) learn_piece(piece, BLOCKED);
    return free;
}

bool Query::piece_is_free(std::int64_t piece) {
    if (piece_verdict(piece) != FREE) {
        const auto [a, b] = ends_of(piece);
        const bool free = oracle_.edge_is_free(configuration(a), configuration(b), known_ends(a, b));
        learn_piece(piece, free ? FREE : BLOCKED);
    }
    return piece_verdict(piece) == FREE;
}

void Query::learn_node(std::int64_t node, Verdict verdict) {
    nodes_[static_cast<std::size_t>(node)] = verdict;
    if (node < start_) learned_[0].emplace_back(node, verdict, verdict == BLOCKED ? oracle_.last_pair() : -1);
}

void Query::learn_piece(std::int64_t piece, Verdict verdict) {
    pieces_[static_cast<std::size_t>(piece)] = verdict;
    if (is_join(piece)) {
        learn_join(piece, verdict);
        return;
    }
    learned_[1].emplace_back(piece, verdict, verdict == BLOCKED ? oracle_.last_pair() : -1);
    if (verdict != FREE) return;
    for (const auto node : {graph_.ends(piece)[0], graph_.ends(piece)[1]})
        if (this->verdict(node) != FREE) learn_node(node, FREE);
}

// Enter the verdict on a joining edge; a blocked one is replaced by another.
void Query::learn_join(std::int64_t piece, Verdict verdict) {
    const auto [end_node, node] = ends_of(piece);
    if (verdict == FREE) {
        paid(end_node, node, piece);
        if (this->verdict(node) != FREE) learn_node(node, FREE);
        return;
    }
    End& end = end_at(end_node);
    end.open.erase(std::find(end.open.begin(), end.open.end(), piece));
    const double *q = at(node), fraction = oracle_.last_fraction();
    Configuration hit(dof_);
    for (std::size_t j = 0; j < dof_; ++j) hit[j] = fraction * (graph_.reach()[j] * (q[j] - end.q[j]));
    for (const auto other : end.open)
        if (in_shadow(end, at(ends_of(other).second), hit)) shaded_.insert(other);
    end.hits.push_back(std::move(hit));
    if (end.hits.size() > HITS) end.hits.pop_front();
    join(end);
}

// Let a joining edge that was checked cost no more than its length.
void Query::paid(std::int64_t end, std::int64_t node, std::int64_t piece) {
    const double length = distance(at(end), at(node));
    for (const auto from : {end, node})
        for (auto& [other, cost, number] : joins_.at(from))
            if (number == piece) cost = length;
}

// Check joining edges of an end, the most promising first, until one is free; before, no search succeeds.
void Query::join_anywhere(End& end) {
    const auto is_free = [&](std::int64_t piece) { return piece_verdict(piece) == FREE; };
    while (!end.open.empty() && std::none_of(end.open.begin(), end.open.end(), is_free)) {
        auto best = promise(end, end.open.front());
        for (const auto piece : end.open) best = std::min(best, promise(end, piece));
        if (seems_free(std::get<2>(best)) && piece_is_free(std::get<2>(best))) return;
    }
}

// The sort key of a joining edge: whether a collision is near, then the length of a path over it.
std::tuple<bool, double, std::int64_t> Query::promise(const End& end, std::int64_t piece) {
    const auto& rows = joins_.at(end.node);
    const auto row = std::find_if(rows.begin(), rows.end(), [&](const auto& each) { return std::get<2>(each) == piece; });
    return {shaded_.count(piece) != 0, std::get<1>(*row) + bound(ends_of(piece).second), piece};
}

}  // namespace roadmap
