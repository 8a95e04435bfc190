// The closed loop of an arm whose tool is at a pose, as equations between few joints each.
//
// The arm is a product of exponentials: M_1(q) ... M_m(q) H, where M_i turns about a fixed line or slides along it, and H is
// the pose of the tool at q = 0. With the tool at T and G = T inv(H), a point or direction x of the tool at q = 0 obeys
//
//     inv(M_k) ... inv(M_1) G x  =  M_{k+1} ... M_m x                                  for each cut k of the chain.
//
// Either side is affine in the cosine and sine of each of its joints. A component along the axis of joint k does not depend on
// that joint, nor does the distance from a point on the axis; joints beyond the last axis through x drop out. So arms with
// spherical wrists, parallel or crossing axes have equations between one, two and three joints, which nobody had to find.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

namespace kinematics {

using Vector = std::array<double, 3>;

struct Joint {
    bool slides;
    std::size_t q;      // the entry of q that moves it
    double multiplier;  // it moves by so many times that
    Vector axis, point;  // a unit vector, and a point on the axis, at q = 0
};

struct Loop {
    std::vector<Joint> joints;  // from the base to the tool
    std::size_t n = 0;          // entries of q
    double tool[12] = {};       // rows of the tool's pose at q = 0
    std::vector<double> strokes;  // metres that each joint slides at most
    double longest = 0.0;         // metres, of all offsets and strokes together
    double steepest = 1.0;        // the largest multiplier, at least 1
};

enum class Wanted { POSE, AXIS, POSITION };

struct Target {
    Wanted wanted = Wanted::POSE;
    double rows[12] = {};
    Vector axis{};                            // in the tool frame, with AXIS
    double position_error = 0.0, turn_error = 0.0;  // metres and radians within which a pose is the target
    Vector position_errors{1e300, 1e300, 1e300};    // metres along each axis of the base, likewise
};

// A sum of products of at most one number of each joint: 1, its cosine or its sine (1, its position or 0 if it slides). The codes
// of the first joint are the most significant of base 3.
struct Polynomial {
    static constexpr std::size_t most_joints = 4;
    std::vector<std::size_t> joints;
    std::vector<double> coefficients;
};

enum class Kind { COMPONENT, SQUARE, PRODUCT };

// What an equation says, for those who check a proof: of pair ``pair`` (pairs_of), at a cut of the chain.
struct Origin {
    std::size_t pair = 0, cut = 0;
    Kind kind = Kind::COMPONENT;
    Vector along{};  // with COMPONENT
};

struct Equation {  // the sum of both sides is 0, but for ``slack``
    Origin origin;
    Polynomial sides[2];
    double slack = 0.0;
    double rounding = 0.0;  // the part of the slack that bounds rounding errors, of derivatives too
    unsigned joints = 0;  // bits, of entries of q
};

// Equations that hold for each q whose tool is at a pose within the errors of the target (Lemma 3).
std::vector<Equation> equations_of(const Loop& loop, const Target& target);

// The points and directions that ``Origin.pair`` counts: whether they stand still rather than move with the tool, whether they
// are points, and where they are at q = 0.
struct Followed {
    bool still, point;
    Vector at;
};
std::vector<Followed> followed_by(const Loop& loop, const Target& target);

}  // namespace kinematics
