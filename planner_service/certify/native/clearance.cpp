#include "clearance.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace proof {

Clearance::Clearance(const Model& model, const Variant& variant)
    : model_(model), variant_(variant), places_(model, variant), still_(static_cast<std::size_t>(model.dof), 0.0) {}

double Clearance::at(const double* q, const std::vector<int>& roots) {
    places_.clear();
    places_.add(0.0, q, still_.data());
    best_ = std::numeric_limits<double>::infinity();
    for (int k = 0; k < model_.dof; ++k)
        if (!std::isfinite(q[k])) return -best_;
    asks_.clear();
    std::size_t nearest = 0;
    for (const int number : roots) {
        const double apart = places_.spheres_apart(model_.pair(number), 0);
        if (!asks_.empty() && apart < asks_[nearest].known) nearest = asks_.size();
        asks_.push_back({number, apart});
    }
    if (asks_.empty()) return best_;
    std::swap(asks_[0], asks_[nearest]);  // what is found first spares the others
    for (std::size_t k = 0; k < asks_.size(); ++k) look(asks_[k]);
    return best_;
}

// What one pair says, or those that stand for it; nothing if it cannot be the smallest.
void Clearance::look(const Ask& asked) {
    const Ask ask = asked;  // the list grows
    if (ask.known >= best_) return;
    const Pair pair = model_.pair(ask.pair);
    const Facing facing = places_.facing(pair, 0);
    Bound bound;
    variant_.rough(model_.terms, facing, nullptr, 0, bound);
    const double known = std::max(ask.known, bound.gap);
    if (known >= best_) return;
    if (pair.leaf()) {
        variant_.refined(model_.terms, facing, static_cast<int>(model_.terms.clearance_rounds), bound);
        const double gap = std::max(known, bound.gap);
        best_ = std::isnan(gap) ? -std::numeric_limits<double>::infinity() : std::min(best_, gap);
        return;
    }
    for (int child = 0; child < pair.children; ++child) {
        const int number = pair.child + child;
        const double apart = places_.spheres_apart(model_.pair(number), 0);
        asks_.push_back({number, std::max(known, apart)});
    }
}

void Clearance::near(const double* q, double row, std::vector<int> pairs, double within, std::vector<double>& out) {
    places_.clear();
    places_.add(0.0, q, still_.data());
    for (std::size_t k = 0; k < pairs.size(); ++k) {  // those of bundles are added at the end
        const int number = pairs[k];
        const Pair pair = model_.pair(number);
        if (!(places_.spheres_apart(pair, 0) < within)) continue;
        const Facing facing = places_.facing(pair, 0);
        Bound bound;
        variant_.rough(model_.terms, facing, nullptr, 0, bound);
        if (!(bound.gap < within)) continue;
        for (int child = 0; child < pair.children; ++child) pairs.push_back(pair.child + child);
        if (!pair.leaf()) continue;
        variant_.refined(model_.terms, facing, static_cast<int>(model_.terms.clearance_rounds), bound);
        if (bound.gap < 0.0) variant_.drawn_apart(model_.terms, facing, static_cast<int>(model_.terms.rounds), bound);
        if (bound.gap < within) out.insert(out.end(), {row, static_cast<double>(number), bound.gap, bound.n[0], bound.n[1], bound.n[2]});
    }
}

}  // namespace proof
