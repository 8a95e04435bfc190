// An arm as inverse kinematics sees it, with the bits of the Python code: the same operations in the same order, and the C
// library's functions, which are Python's.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

namespace kinematics {

// Called through pointers: a compiler that knows the functions would join a sine and a cosine, whose bits then differ.
extern double (*const volatile sine)(double);
extern double (*const volatile cosine)(double);
extern double (*const volatile arc_tangent)(double, double);
extern double (*const volatile power)(double, double);

struct Frame {
    double R[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    double p[3] = {0.0, 0.0, 0.0};
};

// A body between base and tool.
struct Moved {
    std::size_t body, joint;
    bool slides;
    double axis[3];
    double multiplier;  // it moves by so many times the joint
};

struct Arm {
    static constexpr std::size_t width = 31;
    std::size_t joints = 0, bodies = 0, tool_body = 0;
    std::vector<double> table;  // BodyTree.table
    std::vector<Moved> chain;   // from the tool to the base
    double tool[12] = {};       // rows of T_body_tool
    double scale = 1.0;         // radians that a metre counts as
    std::vector<double> lower, upper;
};

double along(const double* row, const double* v);

// Whose sines: the C library's, as in BodyTree.poses, or those of arithmetic.hpp, the same on every processor, as in
// BodyTree.poses_batch(portable=True).
enum class Sines { LIBRARY, PORTABLE };

// The poses of all bodies; ``out`` has room for them.
void place(const Arm& arm, const double* q, std::vector<Frame>& out, Sines sines = Sines::LIBRARY);

// Robot.tool_rows: three rows of four.
void tool_rows(const Arm& arm, const double* q, std::vector<Frame>& frames, double* out);

}  // namespace kinematics
