// Where pieces are at the nodes of a proof, and how far they move between two of them: motion_bounds.py. Worked out when first
// asked for, so that a piece that is proven apart costs nothing more.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "model.hpp"

namespace proof {

// Room for so many doubles at a time, which stays where it is, and is used again.
class Shelf {
  public:
    explicit Shelf(std::size_t each) : each_(each) {}
    double* take();
    void give(double* room) { free_.push_back(room); }

  private:
    static constexpr std::size_t AT_ONCE = 64;
    std::size_t each_, left_ = 0;
    std::vector<std::unique_ptr<double[]>> blocks_;
    std::vector<double*> free_;
};

class Places {
  public:
    // ``plain``: whatever the configuration, the largest distances from the axes count. ``room`` (the caller's, nullptr: none): how
    // far each joint may be off the curve. Where q(s) is a node and q' at most that far off q(x), the robot gets from the one to the
    // other along the curve and then straight to q': each joint travels what it does from s to x, and its room. So motions from a
    // node are of travel and room, and those from both ends of a stretch to one q' together of the stretch's travel and twice the
    // room, which is what ``pair_motion`` gives. Slides may leave their limits by their room.
    Places(const Model& model, const Variant& variant, bool plain = false, const double* room = nullptr);
    void leave_room(const double* room);

    // A node at configuration q, reached after ``travel`` of each joint; its number.
    std::size_t add(double s, const double* q, const double* travel);
    double s(std::size_t node) const { return s_[node]; }
    const double* travel(std::size_t node) const { return travel_.data() + node * static_cast<std::size_t>(model_.dof); }
    std::size_t count() const { return s_.size(); }

    // Forget all nodes but these, which are numbered anew in their order.
    void keep(const std::vector<std::size_t>& nodes);
    void clear();

    Facing facing(const Pair& pair, std::size_t node);
    double spheres_apart(const Pair& pair, std::size_t node);
    // A cheap bound: of the sphere around the first piece against the second, or the sphere around a hull.
    Bound sphere_apart(const Pair& pair, std::size_t node);

    // How far the pieces of a pair move against each other from node a to node b, at most; that stretch has a number
    // below the count with which stretches were last begun.
    void begin_stretches(std::size_t count);
    double pair_motion(const Pair& pair, std::size_t stretch, std::size_t a, std::size_t b);

    // How much closer the pieces of a pair come along a fixed direction than they are along it at both ends, at most; a
    // stretch as above, between whose ends no joint strays farther than ``strays`` says (bends in motion_bounds.py).
    double pair_bend(const Pair& pair, std::size_t stretch, std::size_t a, std::size_t b, const double* strays);
    // A bound that holds all along that stretch: along a direction that stays as it is for the last body that carries both
    // pieces. ``known`` is what is known at ``from``, one end of it, ``bend`` what ``pair_bend`` says.
    double steady(const Pair& pair, std::size_t from, std::size_t to, const Bound& known, double bend);

    // How far the pieces of a pair move against each other, at most, while each joint travels so far from a node, in
    // whatever direction; the node and the travel (the caller's) are set first.
    void begin_about(std::size_t node, const double* travel);
    double motion_about(const Pair& pair);
    // The same of the room alone.
    double room_motion(const Pair& pair, std::size_t node);
    // How much closer the pieces of a pair come along n, at most, while each joint travels so far from a node (nullptr: not at all),
    // and its room: n, in the axes of the second piece there, stays as it is for the last body that carries both. ``slope`` is what
    // comes of where each point begins to go, ``rest`` what else. Along n a point begins to go with joint k as fast as its distance
    // from the axis lets it across n; its second derivative by joints k and j is no longer than its distance from the axis of the
    // outer one, nor is the third by those and i. ``bent``: what the second ones are along n counts as ``slope``, the third ones are
    // the rest; which is less where not much is left.
    struct Approach {
        double slope = 0.0, rest = 0.0;
    };
    Approach approach(const Pair& pair, std::size_t node, const double* n, const double* travel, bool bent);
    // The box along the axes of the base frame that a riding piece does not leave meanwhile: low corner and high corner.
    void box_about(std::size_t piece, double* out);
    // Whether their bounding spheres are farther apart there than they move, and than ``enough``.
    bool spheres_clear(const Pair& pair, double enough);

  private:
    const Model& model_;
    const Variant& variant_;
    bool plain_;
    const double* room_ = nullptr;
    double slid_ = 0.0;           // what all slides together may be off
    std::vector<double> beside_;  // room for motions by the room
    std::vector<Affine> turns_;   // room for what joints give corners
    struct Turn {                 // of a joint: its axis and a point on it, how far it goes, and its axis along n
        double z[3], o[3], moved, along;
        bool slides;
    };
    std::vector<Turn> joints_;
    std::size_t per_bodies_;
    std::vector<double> s_, q_, travel_, bodies_;
    std::vector<double*> poses_, radii_;  // of each node and riding piece; nullptr: not known yet
    Shelf of_poses_, of_radii_;
    std::vector<double> motions_;      // of stretches and riding pieces, depth + 1 each
    std::vector<std::int32_t> moved_;  // where in these; -1: not yet
    std::vector<double> bends_;        // the same
    std::vector<std::int32_t> bent_;

    std::size_t about_node_ = 0;
    const double* about_travel_ = nullptr;
    std::vector<double> about_;         // of riding pieces, depth + 1 each
    std::vector<std::uint8_t> abouts_;  // which of these are known

    struct Sphere {
        double centre[3], radius;
    };

    const double* pose(std::size_t rider, std::size_t node);
    // The pose of any piece; that of one that stands is written to ``room``, 12 numbers.
    const double* pose_of(int piece, std::size_t node, double* room);
    Sphere sphere(int piece, std::size_t node);
    const double* radii(std::size_t piece, std::size_t node);
    void find_radii(std::size_t piece, std::size_t node, double* out);
    double room(int column) const { return room_ == nullptr ? 0.0 : room_[column]; }
    const double* motions_about(std::size_t piece);
    Approach approach_of(std::size_t piece, std::size_t count, std::size_t node, const double* n, const double* travel, bool bent);
    // A row of ``turns_``: ``share`` times what (v, p - o) is at each point p of a piece at P.
    void turn_by(double share, const double* v, const double* o, const double* P);
    void bend_by(const Turn& turn, const double* n, const double* P, Approach& out);
    double nearest_corner(const Solid& solid, const double* local);
    void add_motions(std::size_t piece, std::size_t node, const double* travel, double* out);
    const double* motions(std::size_t piece, std::size_t stretch, std::size_t a, std::size_t b);
    // A direction in the axes of the second piece at one node, as it is in them at another, if it stays as it is for the last
    // body that carries both pieces.
    void turned(const Pair& pair, std::size_t from, std::size_t to, const double* n, double* out);
    const double* bends(std::size_t piece, std::size_t stretch, std::size_t a, std::size_t b, const double* strays);
};

}  // namespace proof
