#include "model.hpp"

#include <algorithm>
#include <new>

namespace collision {

namespace {

constexpr int LEAF = 4;
constexpr std::align_val_t ALIGNED{64};

void around(const std::vector<Stander>& standers, Node& node) {
    for (int k = 0; k < 3; ++k) {
        double low = 1e300, high = -1e300;
        for (int i = node.first; i < node.first + node.count; ++i) {
            low = std::min(low, standers[static_cast<std::size_t>(i)].low[k]);
            high = std::max(high, standers[static_cast<std::size_t>(i)].high[k]);
        }
        node.low[k] = low;
        node.high[k] = high;
    }
    round_outwards(node.low, node.high, node.bounds);
}

// Halves at the median along the longest side, as most bounding volume hierarchies are built (Ericson, Real-Time
// Collision Detection, 2005, 6.2.1).
void split(Model& model, int first, int count) {
    const auto index = model.nodes.size();
    model.nodes.push_back(Node{{}, {}, {}, first, count, -1});
    around(model.standers, model.nodes[index]);
    if (count <= LEAF) return;
    int axis = 0;
    double longest = -1.0;
    for (int k = 0; k < 3; ++k) {
        const double side = model.nodes[index].high[k] - model.nodes[index].low[k];
        if (side > longest) {
            longest = side;
            axis = k;
        }
    }
    const auto begin = model.standers.begin() + first;
    const int half = count / 2;
    std::nth_element(begin, begin + half, begin + count, [axis](const Stander& a, const Stander& b) {
        const double x = a.low[axis] + a.high[axis], y = b.low[axis] + b.high[axis];
        return x != y ? x < y : a.part < b.part;
    });
    split(model, first, half);
    model.nodes[index].other = static_cast<int>(model.nodes.size());
    split(model, first + half, count - half);
}

}  // namespace

void build_nodes(Model& model) {
    model.nodes.clear();
    if (!model.standers.empty()) split(model, 0, static_cast<int>(model.standers.size()));
}

void add(Candidates& candidates, int pair, unsigned lanes, unsigned deep) { candidates.entries.push_back({pair, lanes, deep}); }

Workspace::Workspace(std::size_t bytes) : data_(::operator new(bytes, ALIGNED)) {}
Workspace::~Workspace() { ::operator delete(data_, ALIGNED); }

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
