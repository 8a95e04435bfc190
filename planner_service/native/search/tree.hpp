// A tree of configurations, with the nearest to any other found by looking at all of them.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "space.hpp"

namespace search {

class Tree {
  public:
    explicit Tree(const Space& space) : space_(space), dof_(space.dof()) { widen(64); }

    // Nodes ever added, those that were cut off too.
    int size() const { return static_cast<int>(parents_.size()); }
    int parent(int node) const { return parents_[index(node)]; }
    bool cut_off(int node) const { return cut_off_[index(node)] != 0; }

    // Whether a step from the node was not free.
    bool blocked(int node) const { return blocked_[index(node)] != 0; }
    void block(int node) { blocked_[index(node)] = 1; }
    // Whether all samples of the edge from the parent were judged.
    bool confirmed(int node) const { return confirmed_[index(node)] != 0; }
    void confirm(int node) { confirmed_[index(node)] = 1; }

    // The length of the way from the root to a node, where the search bounds it.
    double cost(int node) const { return costs_[index(node)]; }

    int add(const Configuration& q, int parent, bool confirmed, double cost = 0.0);
    void get(int node, Configuration& q) const;
    // The node nearest to q, of several the first, and its squared distance.
    int nearest(const Configuration& q, double& squared) const;
    // The same of those over which the way from the root to q is no longer than ``most``; -1 if there is none.
    int nearest_within(const Configuration& q, double most, double& squared) const;
    // Takes a node and all that grew from it out of the tree.
    void cut(int node);

  private:
    static std::size_t index(int node) { return static_cast<std::size_t>(node); }
    const double* column(std::size_t joint) const { return values_.data() + joint * capacity_; }
    double* column(std::size_t joint) { return values_.data() + joint * capacity_; }
    void widen(std::size_t capacity);

    const Space& space_;
    std::size_t dof_, capacity_ = 0;
    std::vector<double> values_;  // all values of the first joint, then of the second, ...; far away where no node is
    std::vector<int> parents_;
    std::vector<double> costs_;
    std::vector<std::uint8_t> blocked_, confirmed_, cut_off_;
};

}  // namespace search
