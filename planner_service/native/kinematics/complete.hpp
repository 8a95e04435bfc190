// Every configuration of an arm for a pose of its tool, each in a box proven to hold exactly one, or the boxes left in doubt.
#pragma once

#include <optional>
#include <vector>

#include "enclosure.hpp"
#include "loop.hpp"
#include "obstruction.hpp"

namespace kinematics {

// Exactly one configuration of ``lone`` has its tool at any given pose within the errors of the target, and it is in ``box``.
struct Solution {
    std::vector<double> q;
    Box box, lone;
};

// For each value of one joint within ``reach`` of q's, and each pose within the errors of the target, exactly one configuration
// of ``lone`` has its tool there, and it is in ``box``: half widths about q + (value - q[joint]) along.
struct Arc {
    std::size_t joint;
    double reach;
    std::vector<double> q, along, box, lone;
};

struct Complete {
    std::vector<Solution> solutions;
    std::vector<Arc> arcs;  // of an arm with one joint more than equations, instead
    std::vector<Box> unresolved;  // together they hold all others
    std::vector<std::vector<double>> near;  // configurations of theirs whose tool is at the target
    int boxes = 0;                // that were looked at
};

// What shows that the solutions are all, step by step, for those who check it (``Step`` says what each is).
struct Trail {
    std::vector<double> steps;      // rows of a step, two numbers of it, the low and the high end of a span, and another number
    std::vector<double> sums;       // rows of up to seven pairs of an equation's number and a factor; -1 and 0 for none
    std::vector<double> equations;  // rows of pair, cut, kind and the direction (Origin)
    std::vector<double> followed;   // rows of still, point and where (Followed)
};

enum class Step {
    CUT,        // by equation, the span of a joint of the chain
    SUM_CUT,    // by a sum of equations, the span of an entry of q, with derivatives over the box as it was MARKED
    NONE,       // for an equation has no zero in the box
    NONE_OF,    // ... no zero in the box whatever a joint of the chain
    SUM_NONE,   // for a sum has no zero in the box as it was MARKED, and where an entry of q (-1: none) is now
    KNOWN,      // for the box is where a solution is alone
    TURNED,     // for the tool is turned away
    SPLIT,      // an entry of q, at a hole that an equation (-1: no hole) has for a joint of the chain; low side first
    MARKED,
};

// How far beyond the domain a sliding joint's proof may reach, in metres (radians if it also turns a body).
constexpr double slide_room = 0.05;

// All within ``domain``, and maybe some beyond; gives up after so many boxes.
Complete solve_complete(const Loop& loop, const Target& target, const Box& domain, int most_boxes, Trail* trail = nullptr);

// A configuration of a box whose tool is at the target, if steps from its middle lead to one.
std::optional<std::vector<double>> reached_in(const Loop& loop, const Target& target, const Box& domain, const Box& box);

// What of a domain may bring the tool to the target.
struct CoverLimits {
    double width = 0.0;         // of boxes that are not split (rad)
    std::size_t most = 0;       // boxes from which on none is split
    int most_seen = 0;          // boxes looked at, likewise
    std::size_t most_near = 0;  // configurations at the target that are looked for
};

struct Cover {
    std::vector<Box> boxes;                // hold all configurations whose tool is within the errors of the target, but those
    bool obstructed = false;               // of boxes that collide wherever the arm is in them
    std::vector<std::vector<double>> near;  // some at the target
};

Cover cover(const Loop& loop, const Target& target, const Box& domain, const std::vector<Box>& from, const Obstruction* obstruction,
            const CoverLimits& limits);

}  // namespace kinematics
