// A motion under way that another is to follow: what is left of it, and the stop along it. replanning/splice.py asks for it.
#pragma once

#include <optional>
#include <vector>

#include "curve.hpp"

namespace timing {

// A piece of s(t): seconds, and four coefficients.
struct Row {
    double seconds, c0, c1, c2, c3;
};

// Where a motion is: s on what is left of its path, and ds/dt.
struct State {
    double s, rate;
};

// A stop along a path: its rows, and where it ends.
struct Braking {
    std::vector<Row> rows;
    double end;
};

struct Underway {
    Path left;      // what is left of the path
    Motion law;     // on all of the path; ``geometry`` is not needed
    double begin;   // where what is left begins on all of it
    double end;     // where the law ends on all of it
    double splice;  // seconds on its clock at which the next motion begins

    // An arc length of the old path on what is left of it: at a break of that, exactly there.
    double moved(double s) const;

    // As Trajectory.s says, of order 0 and 1.
    State at(double t) const;

    // The old law from the splice on, up to an instant.
    std::vector<Row> rows(double until) const;

    // The stop within these accelerations that begins there and leaves a share of the possible braking; none if there is none
    // before ``rest``.
    std::optional<Braking> braking(const State& from, double rest, const double* acceleration, double margin) const;
};

}  // namespace timing
