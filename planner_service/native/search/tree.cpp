#include "tree.hpp"

#include <algorithm>
#include <cstring>

namespace search {

namespace {

constexpr double FAR_AWAY = 1e100;  // farther than any node
constexpr std::size_t SIDE_BY_SIDE = 8;

// Configurations as ``Tree`` keeps them; behind the last are FAR_AWAY ones.
struct Columns {
    const double *values, *weights;
    std::size_t capacity, dof, count;
};

using Nearest = int (*)(const Columns& columns, const double* q, double& squared);

// ``Tree::nearest`` in registers of WIDTH numbers. Each distance is summed joint by joint, without fused operations, and
// the first of several that are nearest is found: the same bits and node whatever the width.
template <int WIDTH>
inline __attribute__((always_inline)) int nearest_in(const Columns& columns, const double* q, double& squared) {
    typedef double Register __attribute__((vector_size(8 * WIDTH)));
    constexpr std::size_t PARTS = SIDE_BY_SIDE / WIDTH;
    Register best[PARTS], where[PARTS];
    for (std::size_t p = 0; p < PARTS; ++p) {
        best[p] = Register{} + std::numeric_limits<double>::infinity();
        where[p] = Register{};
    }
    for (std::size_t first = 0; first < columns.count; first += SIDE_BY_SIDE) {
        Register total[PARTS] = {};
        for (std::size_t k = 0; k < columns.dof; ++k)
            for (std::size_t p = 0; p < PARTS; ++p) {
                Register values;
                std::memcpy(&values, columns.values + k * columns.capacity + first + p * WIDTH, sizeof values);
                const Register difference = q[k] - values;
                total[p] = total[p] + columns.weights[k] * (difference * difference);
            }
        for (std::size_t p = 0; p < PARTS; ++p) {
            const auto nearer = total[p] < best[p];
            best[p] = nearer ? total[p] : best[p];
            where[p] = nearer ? Register{} + static_cast<double>(first) : where[p];
        }
    }
    double distances[SIDE_BY_SIDE], firsts[SIDE_BY_SIDE];
    std::memcpy(distances, best, sizeof distances);
    std::memcpy(firsts, where, sizeof firsts);
    int found = 0;
    squared = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < SIDE_BY_SIDE; ++i) {
        const int node = static_cast<int>(firsts[i]) + static_cast<int>(i);
        if (!(distances[i] < squared || (distances[i] == squared && node < found))) continue;
        squared = distances[i];
        found = node;
    }
    return found;
}

int nearest_baseline(const Columns& columns, const double* q, double& squared) { return nearest_in<2>(columns, q, squared); }

#ifdef KERNEL_X86
__attribute__((target("avx2"))) int nearest_avx2(const Columns& columns, const double* q, double& squared) {
    return nearest_in<4>(columns, q, squared);
}

__attribute__((target("avx512f"))) int nearest_avx512(const Columns& columns, const double* q, double& squared) {
    return nearest_in<8>(columns, q, squared);
}
#endif

// The one for the widest registers of this processor.
Nearest fastest() {
#ifdef KERNEL_X86
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f")) return nearest_avx512;
    if (__builtin_cpu_supports("avx2")) return nearest_avx2;
#endif
    return nearest_baseline;
}

}  // namespace

void Tree::widen(std::size_t capacity) {
    std::vector<double> wider(capacity * dof_, FAR_AWAY);
    for (std::size_t k = 0; k < dof_ && capacity_ > 0; ++k)
        std::copy(column(k), column(k) + parents_.size(), wider.data() + k * capacity);
    values_.swap(wider);
    capacity_ = capacity;
}

int Tree::add(const Configuration& q, int parent, bool confirmed, double cost) {
    if (parents_.size() == capacity_) widen(2 * capacity_);
    for (std::size_t k = 0; k < dof_; ++k) column(k)[parents_.size()] = q[k];
    parents_.push_back(parent);
    costs_.push_back(cost);
    confirmed_.push_back(confirmed ? 1 : 0);
    cut_off_.push_back(0);
    blocked_.push_back(0);
    return size() - 1;
}

void Tree::get(int node, Configuration& q) const {
    for (std::size_t k = 0; k < dof_; ++k) q[k] = column(k)[index(node)];
}

int Tree::nearest(const Configuration& q, double& squared) const {
    static const Nearest nearest_of = fastest();
    return nearest_of(Columns{values_.data(), space_.weights().data(), capacity_, dof_, parents_.size()}, q.data(), squared);
}

int Tree::nearest_within(const Configuration& q, double most, double& squared) const {
    const int any = nearest(q, squared);
    Configuration at(dof_);
    get(any, at);
    if (cost(any) + space_.length(at.data(), q.data()) <= most) return any;
    const Configuration& weights = space_.weights();
    int found = -1;
    squared = std::numeric_limits<double>::infinity();
    for (std::size_t first = 0; first < parents_.size(); first += SIDE_BY_SIDE) {
        double weighted[SIDE_BY_SIDE] = {}, plain[SIDE_BY_SIDE] = {};
        for (std::size_t k = 0; k < dof_; ++k) {
            const double* values = column(k) + first;
            for (std::size_t i = 0; i < SIDE_BY_SIDE; ++i) {
                const double difference = q[k] - values[i], square = difference * difference;
                weighted[i] += weights[k] * square;
                plain[i] += square;
            }
        }
        for (std::size_t i = 0; i < SIDE_BY_SIDE && first + i < parents_.size(); ++i) {
            if (!(weighted[i] < squared) || !(costs_[first + i] + std::sqrt(plain[i]) <= most)) continue;
            squared = weighted[i];
            found = static_cast<int>(first + i);
        }
    }
    return found;
}

void Tree::cut(int node) {
    for (int k = node; k < size(); ++k) {  // whatever grew from a node comes after it
        if (k != node && (parent(k) < 0 || !cut_off(parent(k)))) continue;
        cut_off_[index(k)] = 1;
        for (std::size_t j = 0; j < dof_; ++j) column(j)[index(k)] = FAR_AWAY;
    }
}

}  // namespace search
