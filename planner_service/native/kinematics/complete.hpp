// Every configuration of an arm for a pose of its tool, each in a box proven to hold exactly one, or the boxes left in doubt.
#pragma once

#include <vector>

#include "enclosure.hpp"
#include "loop.hpp"

namespace kinematics {

using Box = std::vector<Span>;  // a span of each joint

// Exactly one configuration of ``lone`` has its tool at any given pose within the errors of the target, and it is in ``box``.
struct Solution {
    std::vector<double> q;
    Box box, lone;
};

struct Complete {
    std::vector<Solution> solutions;
    std::vector<Box> unresolved;  // together they hold all others
    int boxes = 0;                // that were looked at
};

// How far beyond the domain a sliding joint's proof may reach, in metres (radians if it also turns a body).
constexpr double slide_room = 0.05;

// All within ``domain``, and maybe some beyond; gives up after so many boxes.
Complete solve_complete(const Loop& loop, const Target& target, const Box& domain, int most_boxes);

}  // namespace kinematics
