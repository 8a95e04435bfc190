#include "tree.hpp"

#include <algorithm>

namespace search {

namespace {

constexpr double FAR_AWAY = 1e100;  // farther than any node
constexpr std::size_t SIDE_BY_SIDE = 8;

}  // namespace

void Tree::widen(std::size_t capacity) {
    std::vector<double> wider(capacity * dof_, FAR_AWAY);
    for (std::size_t k = 0; k < dof_ && capacity_ > 0; ++k)
        std::copy(column(k), column(k) + parents_.size(), wider.data() + k * capacity);
    values_.swap(wider);
    capacity_ = capacity;
}

int Tree::add(const Configuration& q, int parent, bool confirmed) {
    if (parents_.size() == capacity_) widen(2 * capacity_);
    for (std::size_t k = 0; k < dof_; ++k) column(k)[parents_.size()] = q[k];
    parents_.push_back(parent);
    confirmed_.push_back(confirmed ? 1 : 0);
    cut_off_.push_back(0);
    blocked_.push_back(0);
    return size() - 1;
}

void Tree::get(int node, Configuration& q) const {
    for (std::size_t k = 0; k < dof_; ++k) q[k] = column(k)[index(node)];
}

int Tree::nearest(const Configuration& q, double& squared) const {
    squared = std::numeric_limits<double>::infinity();
    std::size_t found = 0;
    for (std::size_t first = 0; first < parents_.size(); first += SIDE_BY_SIDE) {
        double distances[SIDE_BY_SIDE] = {};
        for (std::size_t k = 0; k < dof_; ++k) {
            const double* values = column(k) + first;
            const double weight = space_.weight(k);
            for (std::size_t i = 0; i < SIDE_BY_SIDE; ++i) distances[i] += weight * ((q[k] - values[i]) * (q[k] - values[i]));
        }
        double least = distances[0];
        for (std::size_t i = 1; i < SIDE_BY_SIDE; ++i) least = distances[i] < least ? distances[i] : least;
        if (!(least < squared)) continue;
        for (std::size_t i = 0; i < SIDE_BY_SIDE; ++i)
            if (distances[i] < squared) {
                squared = distances[i];
                found = first + i;
            }
    }
    return static_cast<int>(found);
}

void Tree::cut(int node) {
    for (int k = node; k < size(); ++k) {  // whatever grew from a node comes after it
        if (k != node && (parent(k) < 0 || !cut_off(parent(k)))) continue;
        cut_off_[index(k)] = 1;
        for (std::size_t j = 0; j < dof_; ++j) column(j)[index(k)] = FAR_AWAY;
    }
}

}  // namespace search
