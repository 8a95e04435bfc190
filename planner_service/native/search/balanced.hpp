// RRT-Connect with balanced trees and dynamic domains, as search/planners.py says.
#pragma once

#include <limits>
#include <utility>

#include "tree.hpp"

namespace search {

struct Grown {
    std::vector<Configuration> milestones;
    std::vector<std::pair<int, int>> edges;
};

class BalancedSearch {
  public:
    // ``longest``: of the path, between start and goal as their distances are without weights; for no bound, infinity.
    BalancedSearch(Oracle& oracle, Space space, double range, std::uint64_t seed,
                   double longest = std::numeric_limits<double>::infinity());

    // The path from the start to the goal that is reached first. Without constraints only an exception of the oracle ends
    // it without one; with them, or a bound, also that nothing was left to judge for long: the path is then empty.
    std::vector<Configuration> run(const Configuration& start, const std::vector<Configuration>& goals);

    // Both trees as they are.
    Grown grown() const;

  private:
    int extended(Tree& tree);
    int connected(Tree& tree, const Configuration& target, double cost);
    int walked(Tree& tree, int node, const Configuration& target, double most, bool target_is_node);
    void hold_some(const Configuration& q);
    bool bounded() const { return longest_ < std::numeric_limits<double>::infinity(); }
    double draw_bounded(const Tree& tree);
    double rest(const Tree& tree, const Configuration& q) const;
    double way(const Tree& tree, int node, const Configuration& q) const;
    bool step_is_free(const Configuration& from, const Configuration& to, Known known);
    bool confirmed(Tree& tree, int node);
    bool confirm(Tree& tree, int node);
    void confirm_all(Tree& tree);
    std::vector<Configuration> path(int at_start, int at_goal) const;

    Oracle& oracle_;
    Space space_;
    double range_, radius_, moving_, longest_;
    std::vector<Configuration> starts_, goals_;
    Generator generator_;
    Tree start_, goal_;
    int refuted_ = 0;      // paths with an edge that was not free after all
    int left_out_ = 0;     // samples in a row
    int idle_ = 0;         // steps in a row that the constraints left nothing of
    double stride_;        // length of the last step that kept the constraints
    bool coarse_;          // whether edges are judged coarsely first
    Configuration near_, drawn_, fresh_;
};

}  // namespace search
