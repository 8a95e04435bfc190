// Tables of the robot's own pairs that two joints move to each other at most: the cells of their values in which a pair
// is proven apart. What is proven depends on nothing else, so that all kernels share the tables: other scenes, too.
#pragma once

#include <vector>

#include "model.hpp"

namespace collision {

// Gives the own pairs of a model, whose motion is bounded within these limits, their tables. Not for two threads at once.
void add_tables(Model& model, const std::vector<double>& lower, const std::vector<double>& upper);

}  // namespace collision
