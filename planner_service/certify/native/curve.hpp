// The curve q(s) of a proof, and how far each joint has travelled: joint_path.py and corner_blend.py, to the last bit.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace proof {

// Tables of a JointPath; see there. All are the caller's and outlive this.
struct PathTables {
    std::size_t waypoint_count, pieces;
    const double *waypoints, *knots, *tangents, *breaks;
    const std::int64_t *lines, *rows;  // of each piece between breaks: its line, and its blend or -1
    const double* blends;  // of each blend s, width; corner, before, after, n numbers each
};

class Curve {
  public:
    Curve(std::size_t dof, const PathTables& tables);
    double length() const { return t_.knots[t_.waypoint_count - 1]; }

    // q and travel, n numbers each, at s.
    void at(double s, double* q, double* travel) const;

    // How far each joint strays at most, between two places, from going evenly from the one to the other; false if there is
    // more than one corner in between.
    bool strays(double start, double end, double* out) const;

  private:
    std::size_t n_;
    PathTables t_;
    std::vector<double> turnings_;   // of each blend and joint: y where the joint turns back; 1 if it does not
    std::vector<double> travelled_;  // how far each joint has moved where each piece starts

    // ``moved``: how far each joint moves from the start of the piece to s.
    void on_piece(std::size_t piece, double s, double* q, double* moved) const;
    double turned(std::size_t piece, double s) const;  // on a blend, which share of its turn is made
    void on_line(std::size_t line, double s, double* q) const;
    void on_blend(std::size_t row, double s, double* q, double* moved) const;
};

}  // namespace proof
