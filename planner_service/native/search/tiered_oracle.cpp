#include "tiered_oracle.hpp"

#include <algorithm>
#include <cmath>

namespace search {

namespace {

Configuration between(const Configuration& a, const Configuration& b, double share) {
    Configuration out(a.size());
    for (std::size_t k = 0; k < a.size(); ++k) out[k] = a[k] + (b[k] - a[k]) * share;
    return out;
}

double distance(const Configuration& a, const Configuration& b) {
    double total = 0.0;
    for (std::size_t k = 0; k < a.size(); ++k) total += (b[k] - a[k]) * (b[k] - a[k]);
    return std::sqrt(total);
}

}  // namespace

TieredOracle::TieredOracle(EdgeOracle& roomy, std::vector<std::pair<Configuration, EdgeOracle*>> tight, double near_end)
    : roomy_(roomy), tight_(std::move(tight)), near_end_(near_end) {
    for (auto& [q, oracle] : tight_) oracle->share(roomy);
}

EdgeOracle* TieredOracle::tight_at(const Configuration& q) const {
    const auto found = std::find_if(tight_.begin(), tight_.end(), [&](const auto& each) { return each.first == q; });
    return found == tight_.end() ? nullptr : found->second;
}

// Whether ``judge(oracle, a, b, known)`` is true of all parts of an edge, each with its oracle.
template <class Judge>
bool TieredOracle::parts_are_free(const Configuration& a, const Configuration& b, int known, const Judge& judge) const {
    EdgeOracle *first = tight_at(a), *second = tight_at(b);
    const double length = distance(a, b);
    if (length == 0.0 || (first == nullptr && second == nullptr))
        return judge(first != nullptr ? *first : second != nullptr ? *second : roomy_, a, b, known);
    const double share = std::min(near_end_ / length, first == nullptr || second == nullptr ? 1.0 : 0.5);
    std::vector<Configuration> points{a};
    std::vector<EdgeOracle*> judges;
    if (first != nullptr) {
        points.push_back(between(a, b, share));
        judges.push_back(first);
    }
    judges.push_back(&roomy_);
    if (second != nullptr) {
        points.push_back(between(a, b, 1.0 - share));
        judges.push_back(second);
    }
    points.push_back(b);
    bool begun = false;
    for (std::size_t k = 0; k < judges.size(); ++k) {
        if (points[k] == points[k + 1]) continue;
        const int ends = (points[k + 1] == b ? known & END : 0) | (begun ? 0 : known & START);
        if (!judge(*judges[k], points[k], points[k + 1], ends)) return false;
        begun = true;
    }
    return true;
}

bool TieredOracle::state_is_free(const Configuration& q) {
    EdgeOracle* tight = tight_at(q);
    return (tight != nullptr ? *tight : roomy_).state_is_free(q);
}

bool TieredOracle::edge_is_free(const Configuration& a, const Configuration& b, int known) {
    return parts_are_free(a, b, known, [](EdgeOracle& oracle, const Configuration& p, const Configuration& q, int ends) {
        return oracle.edge_is_free(p, q, ends);
    });
}

bool TieredOracle::edge_is_free_coarse(const Configuration& a, const Configuration& b, int known) {
    return parts_are_free(a, b, known, [](EdgeOracle& oracle, const Configuration& p, const Configuration& q, int ends) {
        return oracle.edge_is_free_coarse(p, q, ends);
    });
}

}  // namespace search
