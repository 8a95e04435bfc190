// The configurations of an edge, and which of a list of configurations is the first in doubt.
#pragma once

#include <optional>
#include <utility>
#include <vector>

#include "model.hpp"

namespace kernel {

// Numbers k of the samples k / segments inside an edge in bisection order, the first ``count`` of them.
std::vector<int> bisection_order(int segments, int count);

// How finely an edge is sampled (edges.py), in the same arithmetic.
struct Rule {
    bool motion;  // MotionStep: reach-weighted; else JointStep: the L2 norm
    double step;
};

// What a user's configurations and edges are held against before they are judged.
struct Terms {
    std::vector<double> lower, upper, reach;
    std::vector<Rule> rules;
};

constexpr int MAX_SEGMENTS = 1'000'000;

bool within(const Terms& terms, const std::vector<double>& q);

// Equal parts of the edge from a to b; 0 if there would be more than MAX_SEGMENTS.
int segments_of(const Terms& terms, const std::vector<double>& a, const std::vector<double>& b);

// How many interior samples come first that split an edge into about ``glance`` segments each (edges.py); 0: none.
int first_samples(int segments, int glance);

// The straight line from a to b as it is judged: the ends that are asked for, then the samples between them in
// bisection order, computed from the lexicographically smaller end. Compiled without fused multiply-adds: the bits are
// those of numpy.
class Edge {
  public:
    Edge(std::vector<double> a, std::vector<double> b, bool judge_a, bool judge_b, int segments);
    int rows() const { return ends_ + segments_ - 1; }
    int ends() const { return ends_; }
    int segments() const { return segments_; }
    // Fraction of the way from a to b; ``k`` of segments for a row that is no end.
    double fraction(int row, int k) const;
    void sample(int row, int k, double* q) const;

  private:
    std::vector<double> a_, b_;
    bool forward_;
    int ends_;
    bool first_end_is_a_;
    int segments_;
};

// The first row in doubt, where it is, and pairs in doubt there in their order: the first of them and some more.
struct Doubt {
    int row;
    double fraction;
    std::vector<double> q;
    std::vector<int> pairs;
    bool deep;  // the first of them surely overlaps
};

// All rows and pairs of configurations Q (m, dof) in doubt, sorted.
std::vector<std::pair<int, int>> candidates(const Model& model, const Variant& variant, const double* Q, int m);

// Of rows [start, stop) of Q.
std::optional<Doubt> first_in_doubt(const Model& model, const Variant& variant, const double* Q, int start, int stop);

// Of rows [start, stop) of an edge.
std::optional<Doubt> first_in_doubt(const Model& model, const Variant& variant, const Edge& edge, int start, int stop);

}  // namespace kernel
