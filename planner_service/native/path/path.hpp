// Lays out polylines and their blends: path/joint_path.py says what its tables are. tests/reference/joint_path.py has the same bits.
#pragma once

#include <nanobind/nanobind.h>

#include <cstddef>
#include <vector>

#include "../arithmetic.hpp"

namespace path {

// The least abs(u + v) of the tangents at a blended corner; joint_path.MIN_FORWARD.
constexpr double min_forward = 0.2;

// Whether a corner with these unit tangents almost turns back.
inline bool turns_back(const double* before, const double* after, std::size_t joints) {
    std::vector<double> squares;
    for (std::size_t j = 0; j < joints; ++j) squares.push_back((before[j] + after[j]) * (before[j] + after[j]));
    return arithmetic::exact_sum(squares) < min_forward * min_forward;
}

// Adds the functions.
void bind(nanobind::module_& m);

}  // namespace path
