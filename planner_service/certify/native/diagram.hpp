// Two motions whose clocks run each for itself: at which places on both some pairs are proven apart. The plane of both clocks is
// quartered where that takes it, and only where somebody asks; what is proven apart on a rectangle is not asked of its quarters.
//
// Lemma. Let s be a stretch of the first motion and u one of the second. Of each joint let m be the middle between its values at both
// ends of the stretch of its motion, and r half of the way that it travels there. Then wherever both are, every joint is within r of
// m: from one end to any place, and from there to the other, it travels 2 r in all, so its values at both ends differ from that at
// the place by no more than 2 r together, and their mean by no more than r. So what is apart at m with room r is apart on s x u.
#pragma once

#include <cstdint>
#include <vector>

#include "places.hpp"

namespace proof {

// Of some joints of the robot: values at 2^LAST + 1 times, evenly from start to end, and how far each has travelled by then.
struct Motion {
    std::vector<int> columns;
    std::vector<double> q, travel;
    double duration;
};

class Diagram {
  public:
    // How often both motions are halved: before bounds are refined; before a rectangle is given up in whose middle a pair is not
    // apart; and at most.
    static constexpr int FIRST = 3, SMALL = 6, LAST = 9;

    // ``still``: values of joints that neither moves. Every pair of ``roots`` is to be farther apart than ``enough`` metres.
    Diagram(const Model& model, const Variant& variant, Motion first, Motion second, std::vector<double> still, double enough,
            const std::vector<int>& roots);
    Diagram(const Diagram&) = delete;
    Diagram(Diagram&&) = default;

    // Leads (seconds by which the second starts later) that are not proven, from where to where, of rectangles that are passed where
    // the lead is within ``delay`` of this one; none if all are proven. No rectangle is smaller than those of ``finest`` halvings.
    std::vector<double> blocked(double lead, double delay, int finest);
    // Of each of 2^level x 2^level rectangles whether it is proven, row by row, the first motion's first.
    void proven(int level, bool* out);

    double asked() const { return asked_; }
    double rectangles() const { return rectangles_; }

  private:
    enum class State : std::uint8_t { unknown, proven, open, given_up };
    struct Ask {
        int pair;
        bool hinted;
        double n[3];  // a direction along which it was apart nearby
    };
    struct Node {
        State state = State::unknown;
        int quarters = -1;  // the first of them
        std::vector<Ask> left;
    };
    struct Cell {
        int node, above, level, i, j;
    };

    const Model& model_;
    const Variant& variant_;
    Motion motions_[2];
    double enough_, asked_ = 0.0, rectangles_ = 0.0;
    Places places_;
    std::vector<Node> nodes_;
    std::vector<double> q_, room_, still_;

    State look(const Cell& cell);
    State judge(const Cell& cell, std::vector<Ask>& left);
    bool met(const Cell& cell, double low, double high, std::vector<double>* out) const;
    void push_quarters(const Cell& cell, std::vector<Cell>& stack);
    bool apart_about(const Pair& pair, const Bound& bound);
};

}  // namespace proof
