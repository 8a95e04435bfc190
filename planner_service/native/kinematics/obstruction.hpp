// Boxes of joint ranges in which an arm collides wherever it is, given where its tool is (docs/design/reachability-maps.md).
//
// At the middle of a box a ball inside one solid reaches into another one by some depth. For as long as no configuration of the
// box moves the ball farther than that against the other solid, all of them collide. How far a ball moves is bounded twice: by
// the joints between the base and it, and by where the tool is and the joints between the tool and it.
#pragma once

#include <cstddef>
#include <vector>

#include "enclosure.hpp"
#include "loop.hpp"

namespace kinematics {

using Box = std::vector<Span>;  // a span of each joint

// A convex solid, as it stands at q = 0, and balls inside of it.
struct Solid {
    enum class Kind { SPHERE, CAPSULE, CYLINDER, BOX, PLANES };
    struct Ball {
        Vector centre;
        double radius;
    };
    struct Plane {
        Vector normal;  // a unit vector
        double offset;
    };
    std::size_t link = 0;  // the number of joints of the chain that move it; 0 stands in the world
    Kind kind = Kind::SPHERE;
    double size[3] = {};      // of a sphere the radius; of a capsule and a cylinder that and half the length; of a box half its sides
    double rows[12] = {};     // its frame in that of the base
    Vector middle{};          // of the ball around it
    double radius = 0.0;      // of that
    std::vector<Ball> balls;
    std::vector<Plane> planes;  // with PLANES, in the base frame: all points of the solid are behind each
};

class Obstruction {
  public:
    // ``pairs`` of solids that must not overlap, each of which at least one joint between them moves.
    Obstruction(std::vector<Solid> solids, std::vector<std::pair<std::size_t, std::size_t>> pairs)
        : solids_(std::move(solids)), pairs_(std::move(pairs)) {}

    // Whether every configuration of the box whose tool is at the target, within its errors, collides.
    bool blocks(const Loop& loop, const Target& target, const Box& box) const;

  private:
    std::vector<Solid> solids_;
    std::vector<std::pair<std::size_t, std::size_t>> pairs_;
};

}  // namespace kinematics
