// What can collide with what, as plain numbers: a robot's moving bodies, the convex pieces that ride on them, the pieces
// that stand in the world, and the pairs that must stay apart. Built once, then only read, from any thread.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace collision {

constexpr int LANES = 8;  // configurations looked at side by side

enum class Motion { turn_x, turn_y, turn_z, slide, turn };

// One body's move relative to its parent: a constant placement, then a turn or a slide by one entry of q.
struct Joint {
    int parent;
    int q_index;
    Motion motion;
    bool turned;         // the placement's rotation is not the identity
    double rotation[9];  // row by row
    double offset[3];
    double axis[3];
};

// The Minkowski sum of a box, a ball and a disc about local z; of a hull the box around it, and the number of its
// corners. The box of a capsule or a cylinder is a segment.
struct Solid {
    double half[3];
    double ball;
    double disc;
    int hull;  // -1: none
};

// Corners about the centre of the box around them, x's then y's then z's; ``padded`` of each, the last repeated, so that
// they can be read in whole vectors.
struct Hull {
    std::size_t start;
    std::size_t padded;
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

struct Stander {
    Solid solid;
    bool turned;
    int part;  // its number among those that stand
    double rotation[9];
    double position[3];
    double low[3], high[3];  // the box around it along the world's axes
    Bounds bounds;           // the same
};

// A box around pieces that stand together. The standers of a node are neighbours: [first, first + count).
struct Node {
    double low[3], high[3];
    Bounds bounds;  // the same
    int first, count;
    int other;  // the second of two nodes below, the first being the next in the list; -1: no node below
};

struct OwnPair {
    int first, second, number;
};

struct Model {
    int dof = 0;
    double margin = 0.0;
    std::vector<Joint> joints;  // of body 1, 2, ...; body 0 is the fixed base
    std::vector<Rider> riders;
    std::vector<Stander> standers;  // in the order of the nodes
    std::vector<Node> nodes;        // the first is around everything
    std::vector<Hull> hulls;
    std::vector<double> corners;
    std::vector<OwnPair> own_pairs;  // by their first
    std::vector<int> run_of;       // of a part that stands, by its number: the obstacle
    std::vector<int> run_first;    // of an obstacle: its first part
    std::vector<int> first_pair;   // riders x obstacles: the number of the pair with its first part, -1: not checked

    int pair_number(std::size_t rider, const Stander& b) const {
        const auto part = static_cast<std::size_t>(b.part);
        const auto run = static_cast<std::size_t>(run_of[part]);
        const int first = first_pair[rider * run_first.size() + run];
        return first < 0 ? -1 : first + b.part - run_first[run];
    }
};

// Sorts ``standers`` into ``nodes``.
void build_nodes(Model& model);

// Pairs that are not proven apart, each with the lanes (bits) in which it is not, and in which it surely overlaps.
struct Candidates {
    struct Entry {
        int pair;
        unsigned lanes, deep;
    };
    std::vector<Entry> entries;
};

// Not inlined: what is compiled for wider instructions must not share a template's code with the rest of the program.
void add(Candidates& candidates, int pair, unsigned lanes, unsigned deep);

// Memory one call works in.
class Workspace {
  public:
    explicit Workspace(std::size_t bytes);
    ~Workspace();
    Workspace(const Workspace&) = delete;
    Workspace& operator=(const Workspace&) = delete;
    void* data() const { return data_; }

  private:
    void* data_;
};

// One variant of the code that checks a block of up to LANES configurations.
struct Variant {
    const char* name;
    std::size_t (*bytes)(const Model& model);
    // q: LANES values of the first joint, then of the second, ...; lanes: those that count; candidates: added to. Unless
    // ``every`` pair is asked for, a lane is left alone after the first rider that has a pair in doubt there.
    void (*check)(const Model& model, const double* q, unsigned lanes, bool every, void* workspace, Candidates& candidates);
};

extern const Variant baseline;
#ifdef KERNEL_X86
extern const Variant avx2;
extern const Variant avx512;
#endif

// The variants this processor can run, the fastest last.
std::vector<const Variant*> variants();

}  // namespace collision
