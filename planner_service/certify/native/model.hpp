// What a proof is about, as plain numbers: a robot's bodies, the convex pieces that ride on them or stand in the world,
// and the pairs to prove apart. Built once from the tables of motion_bounds.py, then only read, from any thread.
//
// Everything here repeats the arithmetic of the Python modules of this folder, operation by operation, so that both
// give equal bits, but that around a hull a box is measured where these measure its corners; what it means and why it is
// right is said there. It shares no code with the search.
#pragma once

#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <vector>

namespace proof {

constexpr std::size_t LANES = 8;  // corners are padded to a multiple of this

// Numbers that the Python modules name and explain, in the order in which certifier.py hands them over.
struct Terms {
    double rounding;                               // motion_bounds.py
    double tiny, shift, steps_per_round, draws;    // separation.py
    double gain, share, thin, none;                // hulls.py
    double fraction, most, far, batch, near, close, rounds, last_rounds;  // interval_proof.py
    double edge_most, steps, certain;                                     // interval_proof.py
    double clearance_rounds;                                              // motion_bounds.py
};

// Corners about the centre: x's, y's and z's, the first corner repeated at the end of each; then those of a few corners
// that lie outermost in some direction.
struct Hull {
    std::size_t padded, outer_padded;
    const double *corners, *outer;
    double half[3];  // of the box around them
};

struct Solid {
    double half[3];
    double disc, ball;
    double radius;
    const Hull* hull;  // nullptr: none
};

// A body's move relative to its parent: ``still + with_cos cos x + with_sin sin x + with_q x``, 3 x 4 each, row by row,
// where x is ``multiplier`` times an entry of q.
struct Body {
    int parent;
    int column;  // -1: no entry of q moves it
    bool slides;
    double axis[3];
    double multiplier;
    double still[12], with_cos[12], with_sin[12], with_q[12];
};

struct Link {  // one body of the chain that carries a piece
    int body;
    double far;  // no configuration within the limits brings the piece farther from its axis
};

struct Rider {
    int body;
    double frame[12];          // in that body
    std::size_t first, count;  // its chain in ``links``, its own body's first
};

// What stands in the world. There may be a million: what many have in common is kept once.
struct Stander {
    int turn;
    double position[3];
};

struct Pair {
    int first, second;
    std::uint16_t own, other;  // of the joints of each, how many do not move the other piece too
    int child, children;       // pairs that stand for one with a bundle
    bool leaf() const { return children == 0; }
};

// Pieces of obstacles that follow each other, and the bundles of these, which follow each other too: the members of the
// tree, in this order.
struct BundleTree {
    int leaf, leaves, bundle, bundles;
    std::size_t children;  // of the bundles, in ``Model::children``
    int size() const { return leaves + bundles; }
};

// Members of a tree, the first of them and how many follow each other.
struct Children {
    int first, count;
};

// The pairs of a rider with all members of a tree: not one of them is listed.
struct Block {
    int begin;  // the number of the first
    int rider;
    int tree;
    std::uint16_t own;
};

struct Model {
    Terms terms{};
    int dof = 0;
    std::size_t riding = 0, depth = 0;
    bool hulls = false;  // whether any piece is one
    std::vector<Hull> shapes;
    std::vector<std::vector<double>> corners;  // of these
    std::vector<Body> bodies;
    std::vector<Solid> solids;
    std::vector<int> solid_of;  // of a piece
    std::vector<Rider> riders;
    std::vector<double> turns;  // rotations, 9 each
    std::vector<Stander> standers;
    std::vector<Link> links;
    std::vector<Pair> pairs;  // those with no tree, which come first
    std::vector<BundleTree> trees;
    std::vector<Children> children;
    std::vector<Block> blocks;
    int count = 0;           // of all pairs
    std::size_t judged = 0;  // of these, without bundles
    // Spheres around all that rides on a body are pieces, too, behind the others that ride. Pairs of these stand for several
    // roots; which one for each plain pair, or -1, and for roots with trees.
    std::vector<Pair> crowds;
    std::vector<int> crowd_of;
    std::unordered_map<int, int> crowd_of_tree;

    const Solid& solid(int piece) const {
        return solids[static_cast<std::size_t>(solid_of[static_cast<std::size_t>(piece)])];
    }

    // Of a root; -1: none.
    int crowd(int number) const {
        if (static_cast<std::size_t>(number) < pairs.size()) return crowd_of[static_cast<std::size_t>(number)];
        const auto found = crowd_of_tree.find(number);
        return found == crowd_of_tree.end() ? -1 : found->second;
    }

    Pair pair(int number) const {
        if (static_cast<std::size_t>(number) < pairs.size()) return pairs[static_cast<std::size_t>(number)];
        std::size_t low = 0, high = blocks.size();
        while (high - low > 1) {
            const std::size_t middle = (low + high) / 2;
            (blocks[middle].begin <= number ? low : high) = middle;
        }
        const Block& block = blocks[low];
        const BundleTree& tree = trees[static_cast<std::size_t>(block.tree)];
        const int member = number - block.begin;
        if (member < tree.leaves) return {block.rider, tree.leaf + member, block.own, 0, 0, 0};
        const int bundle = member - tree.leaves;
        const Children& held = children[tree.children + static_cast<std::size_t>(bundle)];
        return {block.rider, tree.bundle + bundle, block.own, 0, block.begin + held.first, held.count};
    }
};

// A lower bound of the signed gap of a pair, and the unit direction, in the axes of its second piece, that proves it.
struct Bound {
    double gap;
    double n[3];
};

// ``x p + y q + z r + one`` at a point (p, q, r).
struct Affine {
    double x, y, z, one;
};

// A pair as it stands: ``R`` turns a's axes into b's, row by row, ``x`` is a's centre, both seen from b.
struct Facing {
    const Solid *a, *b;
    double R[9];
    double x[3];
};

enum class Contact { apart, overlap, unclear };

// The arithmetic on one pair, compiled for one instruction set; all give equal bits.
struct Variant {
    const char* name;
    // A cheap bound, no larger than that of ``rough``.
    double (*glance)(const Facing& facing);
    // The bound along one vector of any length; -infinity if that is none.
    void (*along)(const Terms& terms, const Facing& facing, const double* vector, Bound& out);
    // The best along the centres' line and along hints, as of ``rough``.
    void (*hinted)(const Terms& terms, const Facing& facing, const double* hints, int count, Bound& out);
    // hints: directions to try besides, xyz each, at most three.
    void (*rough)(const Terms& terms, const Facing& facing, const double* hints, int count, Bound& out);
    void (*refined)(const Terms& terms, const Facing& facing, int rounds, Bound& bound);
    // A better bound of an overlap with a hull; others stay.
    void (*drawn_apart)(const Terms& terms, const Facing& facing, int rounds, Bound& bound);
    // Whether the pair is farther apart than ``enough`` or nearer than ``nearer``; the bound is improved on the way.
    Contact (*settled)(const Terms& terms, const Facing& facing, double enough, double nearer, Bound& bound);
    // The largest of the heights of a hull's corners along u, v, w.
    double (*height)(const Hull& hull, double u, double v, double w);
    // How much lower along ``up`` than the lowest corner any gets, if each sinks by the sum of the absolute values of ``moves`` there.
    // ``corners``: ``padded`` numbers for each axis.
    double (*lowered)(const double* corners, std::size_t padded, const double* up, const Affine* moves, std::size_t count);
};

extern const Variant baseline;
#ifdef PROOF_X86
extern const Variant avx2;
#endif

}  // namespace proof
