#include "model.hpp"

#include <algorithm>
#include <cmath>
#include <new>
#include <numeric>

namespace collision {

namespace {

constexpr int LEAF = 4;
constexpr std::align_val_t ALIGNED{64};
constexpr double ORTHONORMAL = 1.0 + 1e-5;  // what rotations that are not quite may add to a length, and more

struct Leaf {
    double sum[3];  // of the lower and the upper corner
    Bounds bounds;
    int part;
};

void around(const std::vector<Leaf>& leaves, Node& node) {
    node.bounds = leaves[static_cast<std::size_t>(node.first)].bounds;
    for (int i = node.first + 1; i < node.first + node.count; ++i) {
        const Bounds& bounds = leaves[static_cast<std::size_t>(i)].bounds;
        for (int k = 0; k < 3; ++k) {
            node.bounds.low[k] = std::min(node.bounds.low[k], bounds.low[k]);
            node.bounds.high[k] = std::max(node.bounds.high[k], bounds.high[k]);
        }
    }
}

// Halves at the median along the longest side, as most bounding volume hierarchies are built (Ericson, Real-Time
// Collision Detection, 2005, 6.2.1).
void split(std::vector<Node>& nodes, std::vector<Leaf>& leaves, int first, int count) {
    const auto index = nodes.size();
    nodes.push_back(Node{{}, first, count, -1});
    Node& node = nodes[index];
    around(leaves, node);
    if (count <= LEAF) return;
    int axis = 0;
    float longest = -1.0F;
    for (int k = 0; k < 3; ++k) {
        const float side = node.bounds.high[k] - node.bounds.low[k];
        if (side > longest) {
            longest = side;
            axis = k;
        }
    }
    const auto begin = leaves.begin() + first;
    const int half = count / 2;
    std::nth_element(begin, begin + half, begin + count, [axis](const Leaf& a, const Leaf& b) {
        const double x = a.sum[axis], y = b.sum[axis];
        return x != y ? x < y : a.part < b.part;
    });
    split(nodes, leaves, first, half);
    nodes[index].other = static_cast<int>(nodes.size());
    split(nodes, leaves, first + half, count - half);
}

}  // namespace

void box_around(const Model& model, const Stander& stander, double* low, double* high) {
    double reach[3];
    reach_of(model.solid_of(stander), model.turn_of(stander).rotation, reach);
    for (int k = 0; k < 3; ++k) {
        low[k] = stander.position[k] - reach[k];
        high[k] = stander.position[k] + reach[k];
    }
}

void build_nodes(Model& model) {
    model.nodes.clear();
    if (model.standers.empty()) return;
    std::vector<Leaf> leaves;
    leaves.reserve(model.standers.size());
    for (const Stander& stander : model.standers) {
        double low[3], high[3];
        box_around(model, stander, low, high);
        leaves.push_back(Leaf{{low[0] + high[0], low[1] + high[1], low[2] + high[2]}, stander.bounds, stander.part});
    }
    model.nodes.reserve(leaves.size());
    split(model.nodes, leaves, 0, static_cast<int>(leaves.size()));
    std::vector<Stander> sorted;
    sorted.reserve(leaves.size());
    for (const Leaf& leaf : leaves) sorted.push_back(model.standers[static_cast<std::size_t>(leaf.part)]);
    model.standers = std::move(sorted);
}

void reach_of(const Solid& s, const double* R, double* out) {
    for (int i = 0; i < 3; ++i) {
        const double* row = R + 3 * i;
        out[i] = s.ball + s.disc * std::sqrt(row[0] * row[0] + row[1] * row[1]);
        for (int k = 0; k < 3; ++k) out[i] += std::fabs(row[k]) * s.half[k];
    }
}

namespace {

// A box along the axes of the body around riders of it. The slack is for rounding, and for a ball, which a rotation that
// is not quite orthonormal leaves as it is, but not the box around it.
Rider cover_of(const std::vector<Rider>& riders, std::size_t first, std::size_t end) {
    Rider out{};
    out.solid.hull = -1;
    out.body = riders[first].body;
    for (int k = 0; k < 9; ++k) out.rotation[k] = k % 4 == 0 ? 1.0 : 0.0;
    double low[3] = {1e300, 1e300, 1e300}, high[3] = {-1e300, -1e300, -1e300};
    for (std::size_t i = first; i < end; ++i) {
        const Rider& rider = riders[i];
        double reach[3];
        reach_of(rider.solid, rider.rotation, reach);
        for (int k = 0; k < 3; ++k) {
            const double half = reach[k] + MOTION_SLACK + (ORTHONORMAL - 1.0) * rider.solid.ball;
            low[k] = std::min(low[k], rider.position[k] - half);
            high[k] = std::max(high[k], rider.position[k] + half);
        }
        out.meets_world = out.meets_world || rider.meets_world;
    }
    for (int k = 0; k < 3; ++k) {
        out.position[k] = 0.5 * (low[k] + high[k]);
        out.solid.half[k] = 0.5 * (high[k] - low[k]);
    }
    return out;
}

}  // namespace

void build_groups(Model& model) {
    const auto& riders = model.riders;
    std::vector<int> group_of;
    for (std::size_t first = 0, end = 0; first < riders.size(); first = end) {
        while (end < riders.size() && riders[end].body == riders[first].body) ++end;
        group_of.resize(end, static_cast<int>(model.groups.size()));
        model.groups.push_back({static_cast<int>(first), static_cast<int>(end), cover_of(riders, first, end)});
    }
    for (std::size_t i = 0; i < riders.size(); ++i) {
        model.run_from.push_back(static_cast<int>(model.own_runs.size()));
        for (int k = model.own_from[i]; k < model.own_from[i + 1]; ++k) {
            const int group = group_of[static_cast<std::size_t>(model.own_pairs[static_cast<std::size_t>(k)].second)];
            if (k == model.own_from[i] || model.own_runs.back().group != group) model.own_runs.push_back({k, k, group});
            model.own_runs.back().end = k + 1;
        }
    }
    model.run_from.push_back(static_cast<int>(model.own_runs.size()));
}

// A turn moves no point of a rider farther than that is from the axis, which goes through the origin of the joint's own
// body; a slide moves all points alike.
void bound_motion(Model& model, const std::vector<double>& lower, const std::vector<double>& upper) {
    const auto length = [](const double* v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); };
    model.travel.clear();
    for (std::size_t k = 0; k < lower.size(); ++k)
        model.travel.push_back(std::max(std::fabs(lower[k]), std::fabs(upper[k])));
    model.reach.assign(model.riders.size() * model.joints.size(), 0.0);
    for (std::size_t i = 0; i < model.riders.size(); ++i) {
        const Rider& rider = model.riders[i];
        const Solid& s = rider.solid;
        const double corner[3] = {s.half[0] + s.disc, s.half[1] + s.disc, s.half[2]};
        const double radius = s.hull >= 0 ? model.hulls[static_cast<std::size_t>(s.hull)].radius : length(corner);
        double far = length(rider.position) + s.ball + radius + MOTION_SLACK;
        for (int body = rider.body; body > 0;) {
            const auto k = static_cast<std::size_t>(body - 1);
            const Joint& joint = model.joints[k];
            const bool slides = joint.motion == Motion::slide;
            const double times = std::fabs(joint.multiplier);
            model.reach[i * model.joints.size() + k] = times * (slides ? length(joint.axis) : far) * ORTHONORMAL;
            far += length(joint.offset);
            if (slides) far += times * length(joint.axis) * model.travel[static_cast<std::size_t>(joint.q_index)];
            body = joint.parent;
        }
    }
}

void add(Candidates& candidates, const Candidate& candidate) { candidates.entries.push_back(candidate); }

void add_doubted(Candidates& candidates, int pair) { candidates.doubted.push_back(pair); }

void sort_by_pair(Candidates& candidates) {
    const auto before = [](const Candidate& a, const Candidate& b) { return a.pair < b.pair; };
    std::sort(candidates.entries.begin(), candidates.entries.end(), before);
}

Workspace::~Workspace() { ::operator delete(data_, ALIGNED); }

void* Workspace::of(std::size_t bytes) {
    if (bytes > bytes_) {
        void* larger = ::operator new(bytes, ALIGNED);
        ::operator delete(data_, ALIGNED);
        data_ = larger;
        bytes_ = bytes;
    }
    return data_;
}

namespace {

std::size_t no_bytes(const Model& /*model*/) { return 1; }

void find_all(const Model& model, const double* /*q*/, unsigned lanes, const double* /*by*/, void* /*workspace*/,
              Candidates& candidates) {
    candidates.entries.clear();
    for (int pair = 0; pair < model.pairs; ++pair) {
        Candidate all{};
        all.pair = pair;
        all.lanes = lanes;
        candidates.entries.push_back(all);
    }
}

FirstDoubted doubt_all(const Model& model, const double* /*q*/, unsigned lanes, const std::vector<Candidate>* /*among*/,
                       void* /*workspace*/, Candidates& candidates) {
    candidates.doubted.resize(static_cast<std::size_t>(model.pairs));
    std::iota(candidates.doubted.begin(), candidates.doubted.end(), 0);
    FirstDoubted first;
    if (model.pairs > 0)
        for (first.lane = 0; (lanes >> first.lane & 1U) == 0U; ++first.lane) {}
    return first;
}

}  // namespace

const Variant doubter{"fcl", no_bytes, find_all, doubt_all};

std::vector<const Variant*> variants() {
    std::vector<const Variant*> out{&baseline};
#ifdef KERNEL_X86
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
        out.push_back(&avx2);
        if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
            __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw"))
            out.push_back(&avx512);
    }
#endif
    return out;
}

}  // namespace collision
