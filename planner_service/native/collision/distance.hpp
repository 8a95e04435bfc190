// How far pairs that are near are apart, where, and how that changes with each joint: for trajectory optimisation.
//
// Compiled without wide instructions and without fused multiply-adds: equal bits on every processor.
#pragma once

#include <cstdint>
#include <vector>

#include "model.hpp"

namespace collision {

// Pairs nearer than asked, by row, in the order of the riders; ``measured`` of them had to be measured to find these.
struct Near {
    std::vector<std::int64_t> rows, pairs;
    std::vector<double> distances;  // signed; never above the true one but for rounding
    std::vector<double> points;     // on the first of the pair, then on the second: six numbers each
    std::vector<double> gradients;  // of the distance, dof numbers each
    std::int64_t measured = 0;
};

// Of configurations Q (m, dof) all pairs nearer than ``within`` metres.
Near near(const Model& model, const double* Q, int m, double within);

}  // namespace collision
