// TOPP-RA's two passes over a grid (Pham & Pham, IEEE T-RO 34(3), 2018), each linear program solved in closed form.
#pragma once

#include <cstddef>
#include <vector>

namespace timing {

// The limits at N + 1 points of a path. Time and length are scaled so that numbers are about 1.
struct Grid {
    std::size_t joints, count;   // count is N + 1
    const double *first, *second;  // dq/ds and d2q/ds2, a row for each point
    const double* acceleration;    // the limit of each joint
    const double* squares;         // the largest squared speed at each point
    const double* points;          // s, increasing
};

// Speeds at the points, from ``entry`` to rest; none if there is no solution. Bit for bit time_optimal.py.
std::vector<double> two_passes(const Grid& grid, double entry);

}  // namespace timing
