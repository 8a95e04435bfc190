// How far a configuration is from keeping constraints, the nearest one that keeps them, and whether an edge does:
// kinematics/constraint_set.py, with the same bits.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "../kinematics/arm.hpp"

namespace constraints {

using Configuration = std::vector<double>;

// Of the tolerance of each bounded quantity, the share that is used: 1 at a bound, more beyond it.
using Shares = std::vector<double>;

// A frame on one body that stays in a region on another, as ``ConstraintSet`` has it.
struct Region {
    std::size_t body, base;
    kinematics::Frame at, frame;   // in these bodies
    double lower[3], upper[3];     // infinite where there is no bound
    double room[3];                // metres over which the share of a coordinate falls from 1 to 0
    double chord, sine;            // of the tilt and of half the turn; infinite where there is no bound
    std::vector<double> reach;     // metres per unit of each joint that moves one of them against the other, else 0
    std::vector<double> turns;     // radians per unit of each of these joints, else 0
};

// How the joints move the bodies.
struct Joints {
    std::vector<int> parent;               // body that carries each body, -1 for the base
    std::vector<std::size_t> index;        // joint of each body
    std::vector<bool> slides;
    std::vector<std::array<double, 3>> axis;  // in the body
    std::vector<double> multiplier;           // it moves by so many times the joint
};

class Projector {
  public:
    Projector(kinematics::Arm arm, Joints joints, std::vector<Region> regions);

    std::size_t dof() const { return arm_.joints; }

    // The largest share at q.
    double share(const double* q);

    // Whether q keeps them with the room that samples of an edge have.
    bool has_room(const double* q);

    // Moves q to where it keeps all constraints with some room; false if that was not found. Counted.
    bool project(Configuration& q);

    // Whether the straight edge keeps them, with a little room, or as much as its ends have.
    bool keeps(const Configuration& a, const Configuration& b);

    // A step that is not halved any more if it does not keep the constraints.
    static constexpr double LEAST_STRIDE = 2e-3;

    // Moves ``to``, which is ``step`` from ``from`` on the way to a target ``distance`` from there, to where the constraints
    // are kept; whether it is then nearer to the target, and the edge keeps them, too. ``fixed``: it is the target, which
    // keeps them.
    bool step(const Configuration& from, Configuration& to, const Configuration& target, double distance, double step, bool fixed);

    // How often it was asked to project since the last time this was asked.
    long take();

  private:
    struct Measured {
        double rotation[9];      // of A, in the world
        double rows[9];          // of the constrained frame in A
        double origin[3];        // of the constrained frame, in the world
        double at[3];            // the same in A
    };

    static constexpr int MAX_DEPTH = 8;  // how often an edge is halved

    void place(const double* q);
    void measure(const double* q, Shares& shares);
    // project, with the shares where it ends; keeps, with the shares at both ends.
    bool project(Configuration& q, Shares& shares);
    bool keeps(const Configuration& a, const Configuration& b, const Shares& first, const Shares& last);
    void gradients(const std::vector<std::size_t>& rows, std::vector<double>& out) const;
    bool part_is_kept(double from, double to, const Shares& first, const Shares& last, int depth);

    kinematics::Arm arm_;
    Joints joints_;
    std::vector<Region> regions_;
    std::vector<std::pair<std::size_t, int>> rows_;       // region, and coordinate 0 to 2, tilt 3 or turn 4
    std::vector<std::vector<int>> moves_;                 // of each region: 1, -1 or 0 as a body's joint moves the one, the other or both
    std::vector<kinematics::Frame> frames_;
    std::vector<Measured> measured_;
    long projections_ = 0;
    // of the edge that is judged
    Configuration from_, difference_, on_;
    std::vector<double> bend_, allowed_;
    std::array<Shares, MAX_DEPTH> between_;
    // where the last step began, or ended if it was kept, and the shares there and at its other end
    Configuration reached_;
    Shares first_, last_;
    // of a projection
    std::vector<double> J_, A_, y_;
    std::vector<std::size_t> used_;
};

}  // namespace constraints
