// The verdict on a straight edge; interval_proof.py says how it is found. As soon as a pair is proven to overlap, it is over.
#pragma once

#include <vector>

#include "curve.hpp"
#include "places.hpp"

namespace proof {

enum class Verdict { free, colliding, undecided };

struct EdgeResult {
    Verdict verdict = Verdict::free;
    int pair = -1;
    double s = 0.0;
};

struct Lost {
    int pair;
    double s;
    Bound bound;  // there; none where too many were asked
};

struct LineVerdict {
    bool taken = false;  // or the edge is too long for numbers
    EdgeResult result;
    double asked = 0.0;
    bool whole = true;          // all pairs were looked at; not where there was no end to it
    std::vector<Lost> lost;     // with room: of these it cannot be told
};

// The verdict on the straight edge from q1 to q2, n numbers each; the rest is as for ``Edge``. ``hint``: a direction in which pairs may
// be apart.
LineVerdict judge_line(const Model& model, const Variant& variant, const double* q1, const double* q2, double enough, double nearer,
                       const double* room, const std::vector<int>& roots, const Bound& hint = {});

class Edge {
  public:
    // Every pair is to be farther apart than ``enough``; one that is nearer than ``nearer`` collides. ``room``: see Places; what is
    // not sure to be far enough apart for all of it is undecided.
    Edge(const Model& model, const Variant& variant, const Curve& curve, double enough, double nearer, const double* room = nullptr);

    EdgeResult run(const std::vector<int>& roots, const Bound& hint = {});
    double asked() const { return asked_; }
    bool whole() const { return whole_; }
    const std::vector<Lost>& lost() const { return lost_; }

  private:
    struct Stretch {
        std::size_t left, right;
    };
    struct Row {
        int pair;
        std::size_t stretch;
        double motion;
        Bound before, after;
    };
    struct Middle {  // a pair in the middle of the edge
        int pair;
        Bound bound;
    };
    enum class Found { closed, open, over, lost };

    const Model& model_;
    const Variant& variant_;
    const Curve& curve_;
    const Terms& terms_;
    double enough_, nearer_;
    bool roomy_;
    std::vector<double> share_;
    Places places_;
    EdgeResult out_;
    double asked_ = 0.0;
    bool whole_ = true;
    std::vector<Lost> lost_;
    std::vector<double> q_, travel_;
    std::vector<Stretch> stretches_;
    std::vector<Row> rows_;

    Pair pair_of(int number) const { return model_.pair(number); }
    // Bundles that are larger than the motion give way to what is in them; with room all do, since no halving takes it away.
    bool stays_whole(const Pair& pair, double motion) const {
        return pair.leaf() || (!roomy_ && model_.solid(pair.second).radius < motion);
    }
    std::size_t place(double s);
    bool charge(std::size_t count, int pair, double s);
    void lose(int pair, double s, const Bound& bound = {});
    bool leaves_room(int pair, std::size_t node, const Bound& bound);
    bool apart_about(const Pair& pair, std::size_t node, const Bound& bound, const double* travel);
    bool apart_between(const Pair& pair, std::size_t left, const Bound& one, std::size_t right, const Bound& two);
    // ``directed``: as ``closes``, by a bound that has a direction.
    template <class Closes, class Directed>
    Found judge(int pair, std::size_t node, const double* hints, int count, Bound& bound, const Closes& closes,
                const Directed& directed);
    bool middle(const std::vector<int>& roots, const Bound& hint, std::vector<Middle>& open);
    bool ends(const std::vector<Middle>& open);
    bool split();
    bool halve();
    // By the gaps at both ends, and what moves in between.
    bool closed(const Bound& one, const Bound& two, double motion) const;
};

}  // namespace proof
