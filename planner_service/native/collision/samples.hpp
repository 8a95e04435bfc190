// The samples of an edge, and the first of a list of configurations that is not free.
#pragma once

#include <utility>
#include <vector>

#include "model.hpp"

namespace collision {

// Numbers k of the samples k / segments inside an edge in bisection order, the first ``count`` of them.
std::vector<int> bisection_order(int segments, int count);

// The joint limits, and how finely edges are sampled: the rules and the arithmetic of edge_sampling.py.
struct Settings {
    std::vector<double> lower, upper, reach;
    std::vector<double> motion_steps, joint_steps;  // the finest of all of them holds
    int coarse_segments = 0;                        // between two samples of a coarse check
};

constexpr int MAX_SEGMENTS = 1'000'000;

bool within_limits(const Settings& settings, const std::vector<double>& q);

// Equal parts of the edge from a to b; 0 if there would be more than MAX_SEGMENTS.
int segments_of(const Settings& settings, const std::vector<double>& a, const std::vector<double>& b);

// How many interior samples a coarse check takes: those that split an edge into about ``coarse`` segments each.
int coarse_samples(int segments, int coarse);

// The straight line from a to b as rows of configurations: the ends that are to be checked, then the samples between
// them in bisection order, computed from the lexicographically smaller end. Compiled without fused multiply-adds: the bits are
// those of numpy.
class Edge {
  public:
    Edge(std::vector<double> a, std::vector<double> b, bool check_a, bool check_b, int segments);
    int rows() const { return ends_ + segments_ - 1; }
    int ends() const { return ends_; }
    int segments() const { return segments_; }
    // Fraction of the way from a to b; ``k`` of segments for a row that is no end.
    double fraction(int row, int k) const;
    void sample(int row, int k, double* q) const;
    // At a fraction of the way from the end that samples are computed from.
    void at(double along, double* q) const;
    // How far each entry of q goes in a share of the way.
    void motion(double share, double* by) const;
    // Whether all of it is as near to 0 as this.
    bool within(const std::vector<double>& travel) const;

  private:
    std::vector<double> a_, b_;
    bool forward_;
    int ends_;
    bool first_end_is_a_;
    int segments_;
};

// What is known of a configuration or an edge. Refused: it is not in the form that is taken, or outside the limits.
// Undecided: some pairs are neither proven apart nor proven to overlap, or not all rows were checked.
enum class Status { refused, free, colliding, undecided };

// The first row that is not free: it collides in its first pair, or that is not decided. Of a free one no row.
struct RowCheck {
    Status status = Status::free;
    int row = 0;
    double fraction = 0.0;
    std::vector<double> q;
    std::vector<int> pairs;  // in their order: those that may collide, up to the first that surely does
};

// How far an edge was checked: ``judged`` rows, of which the last collides if any does. Of an edge that is undecided
// the rows from ``next`` on are left.
struct EdgeCheck {
    Status status = Status::refused;
    int judged = 0;
    double fraction = 0.0;  // where it collides, and the pair that does
    int pair = -1;
    int ends = 0, segments = 0, rows = 0, next = 0;
};

// All rows and pairs of configurations Q (m, dof) that are not proven apart, sorted.
std::vector<std::pair<int, int>> candidates(const Model& model, const Variant& variant, const double* Q, int m);

// Of rows [start, stop) of Q.
RowCheck check_rows(const Model& model, const Variant& variant, const double* Q, int start, int stop);

// Of rows [start, stop) of an edge.
RowCheck check_rows(const Model& model, const Variant& variant, const Edge& edge, int start, int stop);

}  // namespace collision
