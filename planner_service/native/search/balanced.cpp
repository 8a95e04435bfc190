#include "balanced.hpp"

#include <algorithm>
#include <limits>

namespace search {

namespace {

constexpr double RADIUS = 0.2;  // how near samples must be to a blocked node, as a share of the longest distance
constexpr double MOST_MOVING = 7.0;  // joints of more that a step moves, on average
constexpr int MAX_LEFT_OUT = 30;  // samples left out in a row for being too far away, after which the next is used
constexpr int MAX_REFUTED = 8;  // paths with an edge that was not free after all, after which no edge is glanced at
constexpr int MAX_IDLE = 2000;  // steps in a row of which constraints, or the bound, left nothing, after which the search gives up

}  // namespace

BalancedSearch::BalancedSearch(Oracle& oracle, Space space, double range, std::uint64_t seed, double longest)
    : oracle_(oracle), space_(std::move(space)), range_(range), radius_(RADIUS * space_.extent()),
      moving_(MOST_MOVING / static_cast<double>(space_.dof())), longest_(longest), generator_(seed), start_(space_), goal_(space_), stride_(range),
      coarse_(oracle.glances()), near_(space_.dof()), drawn_(space_.dof()), fresh_(space_.dof()) {}

std::vector<Configuration> BalancedSearch::run(const Configuration& start, const std::vector<Configuration>& goals) {
    starts_ = {start};
    goals_ = goals;
    start_.add(start, -1, true);
    for (const auto& goal : goals) goal_.add(goal, -1, true);
    while (idle_ < MAX_IDLE) {
        oracle_.poll();
        const bool from_start = start_.size() <= goal_.size();
        Tree &tree = from_start ? start_ : goal_, &other = from_start ? goal_ : start_;
        const int node = extended(tree);
        if (node < 0) continue;
        const int met = connected(other, Configuration(fresh_), tree.cost(node));
        if (met < 0) continue;
        const int at_start = from_start ? node : met, at_goal = from_start ? met : node;
        if (confirmed(start_, at_start) && confirmed(goal_, at_goal)) return path(at_start, at_goal);
        if (++refuted_ == MAX_REFUTED) {
            coarse_ = false;
            confirm_all(start_);
            confirm_all(goal_);
        }
    }
    return {};
}

// The node by which a tree grew towards a random configuration, which is left in ``fresh_``; -1 if it did not grow.
int BalancedSearch::extended(Tree& tree) {
    double squared = 0.0;
    int nearest = -1;
    if (bounded()) {
        ++idle_;
        nearest = tree.nearest_within(drawn_, draw_bounded(tree), squared);
    } else {
        space_.draw(generator_, drawn_);
        nearest = tree.nearest(drawn_, squared);
    }
    if (nearest < 0) return -1;
    tree.get(nearest, near_);
    if (moving_ < 1.0) {
        hold_some(near_);
        squared = space_.squared_distance(near_.data(), drawn_.data());
        if (bounded() && way(tree, nearest, drawn_) + rest(tree, drawn_) > longest_) return -1;
    }
    const double distance = std::sqrt(squared);
    if (tree.blocked(nearest) && distance > radius_ && left_out_ < MAX_LEFT_OUT) {
        ++left_out_;
        return -1;
    }
    left_out_ = 0;
    int node = nearest;
    if (space_.projector() != nullptr) {
        node = walked(tree, nearest, Configuration(drawn_), range_, false);
        tree.get(node, fresh_);
    } else {
        if (bounded()) idle_ = 0;
        space_.step(near_, drawn_, distance, range_, fresh_);
        if (step_is_free(near_, fresh_, START)) node = tree.add(fresh_, nearest, !coarse_, way(tree, nearest, fresh_));
    }
    if (node != nearest) return node;
    tree.block(nearest);
    return -1;
}

// Gives some joints of what was drawn, each by the same chance, the values that they have at q; none if it were all.
void BalancedSearch::hold_some(const Configuration& q) {
    Configuration held(q);
    bool moves = false;
    for (std::size_t k = 0; k < held.size(); ++k) {
        if (!(generator_.uniform() < moving_)) continue;
        held[k] = drawn_[k];
        moves = true;
    }
    if (moves) drawn_ = held;
}

// The node by which a tree reached the target, growing towards it step by step; -1 if it did not.
int BalancedSearch::connected(Tree& tree, const Configuration& target, double cost) {
    double squared = 0.0;
    int node = bounded() ? tree.nearest_within(target, longest_ - cost, squared) : tree.nearest(target, squared);
    if (node < 0) return -1;
    double distance = std::sqrt(squared);
    if (space_.projector() != nullptr) {
        node = walked(tree, node, target, std::numeric_limits<double>::infinity(), true);
        tree.get(node, near_);
        return near_ == target ? node : -1;
    }
    while (distance > 0.0) {
        tree.get(node, near_);
        space_.step(near_, target, distance, range_, fresh_);
        const Known known = distance <= range_ ? BOTH : START;  // the target is a node of the other tree
        if (!step_is_free(near_, fresh_, known)) return -1;
        node = tree.add(fresh_, node, !coarse_, way(tree, node, fresh_));
        distance = std::sqrt(space_.squared_distance(fresh_.data(), target.data()));
    }
    return node;
}

// The node that a tree reached on its way from a node towards a target, at most ``most`` far, by steps that keep the
// constraints: halved until they do, then doubled again.
int BalancedSearch::walked(Tree& tree, int node, const Configuration& target, double most, bool target_is_node) {
    double gone = 0.0, stride = stride_;
    while (gone < most) {
        oracle_.poll();
        tree.get(node, near_);
        const double distance = std::sqrt(space_.squared_distance(near_.data(), target.data()));
        if (!(distance > 0.0)) break;
        const double step = std::min(stride, distance);
        const bool arrives = target_is_node && step == distance;
        space_.step(near_, target, distance, step, fresh_);
        if (!space_.projector()->step(near_, fresh_, target, distance, step, arrives)) {
            if (step <= constraints::Projector::LEAST_STRIDE) {
                ++idle_;
                break;
            }
            stride = step / 2.0;
            continue;
        }
        idle_ = 0;
        if (!step_is_free(near_, fresh_, arrives ? BOTH : START)) break;
        gone += std::sqrt(space_.squared_distance(near_.data(), fresh_.data()));
        node = tree.add(fresh_, node, !coarse_);
        stride_ = step;
        stride = std::min(2.0 * step, range_);
    }
    return node;
}

// Draws where a path that is short enough may go, and how long its way from the root of a tree to there may be.
double BalancedSearch::draw_bounded(const Tree& tree) {
    const auto goal = static_cast<std::size_t>(generator_.uniform() * static_cast<double>(goals_.size()));
    space_.draw_between(generator_, starts_.front(), goals_[goal], longest_, drawn_);
    const double least = rest(&tree == &start_ ? goal_ : start_, drawn_);
    return least + (longest_ - rest(tree, drawn_) - least) * generator_.uniform();
}

// The least length of a way from a configuration of a tree to where the other one is rooted.
double BalancedSearch::rest(const Tree& tree, const Configuration& q) const {
    double least = std::numeric_limits<double>::infinity();
    for (const auto& end : &tree == &start_ ? goals_ : starts_) least = std::min(least, space_.length(q.data(), end.data()));
    return least;
}

// The length of the way from the root of a tree over a node to a configuration.
double BalancedSearch::way(const Tree& tree, int node, const Configuration& q) const {
    if (!bounded()) return 0.0;
    Configuration at(space_.dof());
    tree.get(node, at);
    return tree.cost(node) + space_.length(at.data(), q.data());
}

bool BalancedSearch::step_is_free(const Configuration& from, const Configuration& to, Known known) {
    return coarse_ ? oracle_.edge_is_free_coarse(from, to, known) : oracle_.edge_is_free(from, to, known);
}

// Whether all edges from a node to its root are free; the first that is not is cut off.
bool BalancedSearch::confirmed(Tree& tree, int node) {
    for (; tree.parent(node) >= 0; node = tree.parent(node))
        if (!confirm(tree, node)) return false;
    return true;
}

// Whether the edge to a node is free at all its samples; the node is cut off if not.
bool BalancedSearch::confirm(Tree& tree, int node) {
    if (tree.confirmed(node)) return true;
    tree.get(tree.parent(node), near_);
    tree.get(node, fresh_);
    if (!oracle_.edge_is_free(near_, fresh_, BOTH)) {
        tree.cut(node);
        return false;
    }
    tree.confirm(node);
    return true;
}

void BalancedSearch::confirm_all(Tree& tree) {
    for (int node = 0; node < tree.size(); ++node)
        if (!tree.cut_off(node)) confirm(tree, node);
}

std::vector<Configuration> BalancedSearch::path(int at_start, int at_goal) const {
    std::vector<Configuration> out;
    Configuration q(space_.dof());
    const auto append = [&](const Tree& tree, int node) {
        for (; node >= 0; node = tree.parent(node)) {
            tree.get(node, q);
            out.push_back(q);
        }
    };
    append(start_, at_start);
    std::reverse(out.begin(), out.end());
    append(goal_, goal_.parent(at_goal));  // where the trees met is there already
    return out;
}

Grown BalancedSearch::grown() const {
    Grown out;
    for (const Tree* tree : {&start_, &goal_}) {
        std::vector<int> numbers(static_cast<std::size_t>(tree->size()), -1);
        Configuration q(space_.dof());
        for (int node = 0; node < tree->size(); ++node) {
            if (tree->cut_off(node)) continue;
            const int number = numbers[static_cast<std::size_t>(node)] = static_cast<int>(out.milestones.size());
            tree->get(node, q);
            out.milestones.push_back(q);
            if (tree->parent(node) >= 0) out.edges.emplace_back(numbers[static_cast<std::size_t>(tree->parent(node))], number);
        }
    }
    return out;
}

}  // namespace search
