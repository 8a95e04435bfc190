// TOPP-RA's two passes over a grid (Pham & Pham, IEEE T-RO 34(3), 2018), each linear program solved in closed form.
#pragma once

#include <cstddef>
#include <vector>

namespace timing {

// The limits at N + 1 points of a path. Time and length are scaled so that numbers are about 1.
struct Grid {
    std::size_t rows, count;                  // count is N + 1
    const double *first, *second, *constant;  // abs(a u + b x + c) <= limit; no constants where all are 0
    const double* limit;                      // of each row
    const double* squares;         // the largest squared speed at each point
    const double* points;          // s, increasing
};

// Speeds at the points, from ``entry`` to rest; none if there is no solution.
std::vector<double> two_passes(const Grid& grid, double entry);

}  // namespace timing
