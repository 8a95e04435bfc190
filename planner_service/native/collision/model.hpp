// What can collide with what, as plain numbers: a robot's moving bodies, the convex pieces that ride on them, the pieces
// that stand in the world, and the pairs that must stay apart. Built once, then only read, from any thread.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

namespace collision {

constexpr int LANES = 8;  // configurations looked at side by side

enum class Motion { turn_x, turn_y, turn_z, slide, turn };

// One body's move relative to its parent: a constant placement, then a turn or a slide by a multiple of one entry of q.
struct Joint {
    int parent;
    int q_index;
    Motion motion;
    bool turned;         // the placement's rotation is not the identity
    double rotation[9];  // row by row
    double offset[3];
    double axis[3];
    double multiplier;
};

// The Minkowski sum of a box, a ball and a disc about local z; of a hull the box around it, and the number of its
// corners. The box of a capsule or a cylinder is a segment.
struct Solid {
    double half[3];
    double ball;
    double disc;
    int hull;  // -1: none
};

constexpr double FARTHEST = 1e15;  // metres: products of two such lengths are numbers in single precision, too
constexpr std::size_t FLOATS = 2 * LANES;  // corners of a hull looked at side by side

// Corners about the centre of the box around them, x's then y's then z's; ``padded`` of each, the last repeated, so that
// they can be read in whole vectors.
struct Hull {
    std::size_t start;
    std::size_t padded;
    double radius;  // how far a corner is from the centre at most
    double blur;    // metres by which the corner that is farthest in single precision may be short of the farthest
};

// A box along the world's axes in single precision, rounded outwards; the fourth numbers are 0.
struct alignas(16) Bounds {
    float low[4];
    float high[4];
};

// Not below float's own rounding, 2^-24 of a number, nor below what its smallest numbers lose.
static inline float rounded_down(double x) {
    const auto near = static_cast<float>(x);
    return near - ((near < 0.0F ? -near : near) * 2.4e-7F + 1e-37F);
}

static inline float rounded_up(double x) { return -rounded_down(-x); }

static inline void round_outwards(const double* low, const double* high, Bounds& out) {
    for (int k = 0; k < 3; ++k) {
        out.low[k] = rounded_down(low[k]);
        out.high[k] = rounded_up(high[k]);
    }
    out.low[3] = out.high[3] = 0.0F;
}

struct Rider {
    Solid solid;
    int body;
    bool turned;
    bool meets_world;
    double rotation[9];
    double position[3];
};

// How something stands in the world.
struct Turn {
    double rotation[9];
    bool turned;
};

// There may be a million: what many have in common is kept once.
struct Stander {
    int solid, turn;  // which of these it has
    int part;         // its number among those that stand
    int run;          // the obstacle
    double position[3];
    Bounds bounds;  // the box around it along the world's axes
};

// A box around pieces that stand together. The standers of a node are neighbours: [first, first + count).
struct Node {
    Bounds bounds;
    int first, count;
    int other;  // the second of two nodes below, the first being the next in the list; -1: no node below
};

struct OwnPair {
    int first, second, number;
    int table;  // -1: none
};

// Riders of one body that follow each other, [first, end), and a box around them that rides as they do. What is apart
// from the box is apart from all of them.
struct Group {
    int first, end;
    Rider cover;
    bool alone() const { return end - first == 1; }  // then the rider is its own cover
};

// Own pairs of one rider that follow each other, [first, end), whose second is of one group.
struct OwnRun {
    int first, end, group;
};

// Where an own pair is proven apart, by the two joints that move its solids to each other.
struct Table {
    int joint[2], cells[2];
    double low[2], per[2];  // where the cells begin, and how many there are per unit
    double motion;          // metres that the solids move to each other at most from the middle of a cell to its rim
    std::shared_ptr<std::vector<unsigned char>> proofs;  // filled as cells are asked for, by any thread
};

struct Model {
    int dof = 0;  // entries of q; several joints may move by the same one
    int pairs = 0;
    double margin = 0.0;
    std::vector<Joint> joints;  // of body 1, 2, ...; body 0 is the fixed base
    std::vector<Solid> solids;
    std::vector<Turn> turns;
    std::vector<Rider> riders;
    std::vector<Stander> standers;  // in the order of the nodes
    std::vector<Node> nodes;        // the first is around everything
    std::vector<Hull> hulls;
    std::vector<double> corners;
    std::vector<float> rounded_corners;
    std::vector<OwnPair> own_pairs;  // by their first
    std::vector<int> own_from;       // of a rider: where those begin of which it is the first; and where all end
    std::vector<Group> groups;       // of all riders, in their order
    std::vector<OwnRun> own_runs;    // of all own pairs, in their order
    std::vector<int> run_from;       // of a rider: where its own runs begin; and where all end
    std::vector<Table> tables;
    std::vector<double> reach;   // riders x joints: metres that a joint moves any point of a rider per unit of q; 0: none
    std::vector<double> travel;  // of each entry of q: how far from 0 it may be for that to hold
    std::vector<int> run_first;    // of an obstacle: its first part
    std::vector<int> first_pair;   // riders x obstacles: the number of the pair with its first part, -1: not checked

    // Whether there are so many pieces that a look at nodes lane by lane pays, and at riders one by one, for one of
    // them may collide with many; and that none pays at windows of samples.
    bool crowded() const { return standers.size() > 64; }

    int pair_number(std::size_t rider, const Stander& b) const {
        const auto run = static_cast<std::size_t>(b.run);
        const int first = first_pair[rider * run_first.size() + run];
        return first < 0 ? -1 : first + b.part - run_first[run];
    }

    const Solid& solid_of(const Stander& b) const { return solids[static_cast<std::size_t>(b.solid)]; }
    const Turn& turn_of(const Stander& b) const { return turns[static_cast<std::size_t>(b.turn)]; }
};

// Half lengths of the box around a solid along the axes in which its rotation is given.
void reach_of(const Solid& solid, const double* rotation, double* out);

// The box around what stands along the world's axes.
void box_around(const Model& model, const Stander& stander, double* low, double* high);

// Sorts ``standers`` into ``nodes``.
void build_nodes(Model& model);

// Finds the groups of ``riders``, and the runs of ``own_pairs``.
void build_groups(Model& model);

constexpr double MOTION_SLACK = 1e-9;  // metres: what rounding does to places, and more

// Works out how far joints move riders within these limits.
void bound_motion(Model& model, const std::vector<double>& lower, const std::vector<double>& upper);

// A pair that is not proven apart.
struct Candidate {
    int pair;
    int rider, other;  // its first, and the number of its stander or, if it is one of the robot's own, of the pair
    bool own;
    unsigned lanes;    // in which it is not proven apart
    double margin;     // by which it was to be
    bool parted;       // in the lane looked at last, by the direction v: it often parts the next
    double v[3];
};

struct Candidates {
    std::vector<Candidate> entries;
    std::vector<int> doubted;  // pairs of a single lane
};

// Not inlined: what is compiled for wider instructions must not share a template's code with the rest of the program.
void add(Candidates& candidates, const Candidate& candidate);
void add_doubted(Candidates& candidates, int pair);
void sort_by_pair(Candidates& candidates);

// The first lane that is not free, and whether the last of its ``doubted`` pairs surely overlaps.
struct FirstDoubted {
    int lane = -1;
    bool certain = false;
};

// Memory that calls work in, one after the other: it grows as they need and is kept.
class Workspace {
  public:
    Workspace() = default;
    ~Workspace();
    Workspace(const Workspace&) = delete;
    Workspace& operator=(const Workspace&) = delete;
    void* of(std::size_t bytes);

  private:
    void* data_ = nullptr;
    std::size_t bytes_ = 0;
};

// One variant of the code that checks a block of up to LANES configurations.
struct Variant {
    const char* name;
    std::size_t (*bytes)(const Model& model);
    // q: LANES values of the first joint, then of the second, ...; lanes: those that count. Both set the candidates.
    // All pairs, in no order, each with all lanes in which it is not proven apart; or, unless ``by`` is null, not proven
    // to stay apart while each entry of q changes by so much.
    void (*find)(const Model& model, const double* q, unsigned lanes, const double* by, void* workspace,
                 Candidates& candidates);
    // The first of the lanes that is not proven free: ``doubted`` are its pairs in their order that are not proven
    // apart, up to the first that surely overlaps. Unless ``among`` is null, all others are known to be apart.
    FirstDoubted (*find_first)(const Model& model, const double* q, unsigned lanes, const std::vector<Candidate>* among,
                               void* workspace, Candidates& candidates);
};

// Proves nothing: all pairs of the first configuration are doubted, in their order.
extern const Variant doubter;
extern const Variant baseline;
#ifdef KERNEL_X86
extern const Variant avx2;
extern const Variant avx512;
#endif

// The variants this processor can run, the fastest last.
std::vector<const Variant*> variants();

}  // namespace collision
