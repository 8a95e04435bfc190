#include "smoothing.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <utility>

#include "../arithmetic.hpp"
#include "../collision/samples.hpp"
#include "../path/path.hpp"
#include "../timing/curve.hpp"

namespace smoothing {

namespace {

using search::BOTH;
using search::Configuration;
using search::Oracle;
using search::START;

constexpr double min_gain = 0.02, min_pull = 0.005, short_piece = 0.1;
constexpr std::array<double, 2> pulls{1.0, 0.5};
constexpr int pull_rounds = 2;
constexpr double blend_share = 0.499;
constexpr int kept_samples = 8;

double distance(const Configuration& a, const Configuration& b) {
    double total = 0.0;
    for (std::size_t k = 0; k < a.size(); ++k) total += (b[k] - a[k]) * (b[k] - a[k]);
    return std::sqrt(total);
}

Configuration between(const Configuration& a, const Configuration& b, double share) {
    Configuration out(a.size());
    for (std::size_t k = 0; k < a.size(); ++k) out[k] = a[k] + (b[k] - a[k]) * share;
    return out;
}

std::vector<double> lengths_of(const Polyline& chain) {
    std::vector<double> lengths;
    for (std::size_t k = 0; k + 1 < chain.size(); ++k) lengths.push_back(distance(chain[k], chain[k + 1]));
    return lengths;
}

// Remembers the verdicts of an oracle on edges, and which configurations are free.
class Verdicts {
  public:
    Verdicts(Oracle& oracle, const Polyline& chain) : oracle_(oracle), free_(chain.begin(), chain.end()) {
        for (std::size_t k = 0; k + 1 < chain.size(); ++k) edges_[edge(chain[k], chain[k + 1])] = true;
    }

    bool edge_is_free(const Configuration& a, const Configuration& b) {
        auto key = edge(a, b);
        const auto found = edges_.find(key);
        if (found != edges_.end()) return found->second;
        const int known = (free_.count(a) != 0 ? search::START : 0) + (free_.count(b) != 0 ? search::END : 0);
        const bool free = oracle_.edge_is_free(a, b, known);
        edges_.emplace(std::move(key), free);
        if (free) free_.insert(a), free_.insert(b);
        return free;
    }

    bool path_is_free(const Polyline& path) {
        for (std::size_t k = 0; k + 1 < path.size(); ++k)
            if (!edge_is_free(path[k], path[k + 1])) return false;
        return true;
    }

  private:
    using Edge = std::pair<Configuration, Configuration>;
    static Edge edge(const Configuration& a, const Configuration& b) { return a <= b ? Edge(a, b) : Edge(b, a); }

    Oracle& oracle_;
    std::set<Configuration> free_;
    std::map<Edge, bool> edges_;
};

// From each vertex to the farthest one that a free edge reaches.
Polyline skip_vertices(const Polyline& chain, Verdicts& verdicts) {
    Polyline kept{chain.front()};
    for (std::size_t last = 0; last + 1 < chain.size();) {
        std::size_t next = chain.size() - 1;
        while (next > last + 1 && !verdicts.edge_is_free(chain[last], chain[next])) --next;
        kept.push_back(chain[next]);
        last = next;
    }
    return kept;
}

struct Place {
    std::size_t piece;
    Configuration q;
};

// The point at a distance along a chain.
Place point_at(const Polyline& chain, const std::vector<double>& lengths, double at) {
    double passed = 0.0;
    std::size_t k = 0;
    while (!(at <= passed + lengths[k]) && k + 1 < lengths.size()) passed += lengths[k++];
    const double share = (at - passed) / lengths[k];
    return {k, between(chain[k], chain[k + 1], share < 1.0 ? share : 1.0)};
}

struct Cut {
    Configuration a, b;
    Polyline chain;
};

// The edge that cuts from u to v (shares of the length), and the chain with it; none if it gains too little.
std::optional<Cut> cut(const Polyline& chain, double u, double v) {
    if (v < u) std::swap(u, v);
    const std::vector<double> lengths = lengths_of(chain);
    const double total = arithmetic::exact_sum(lengths), before = u * total, after = v * total;
    Place first = point_at(chain, lengths, before), second = point_at(chain, lengths, after);
    const std::size_t i = first.piece, j = second.piece;
    if (i == j || after - before - distance(first.q, second.q) < min_gain * total) return std::nullopt;
    Cut out{std::move(first.q), std::move(second.q), {}};
    const auto at = [&chain](std::size_t k) { return chain.begin() + static_cast<std::ptrdiff_t>(std::min(k, chain.size())); };
    out.chain.assign(chain.begin(), at(out.a != chain[i] ? i + 1 : i));
    out.chain.push_back(out.a);
    out.chain.push_back(out.b);
    out.chain.insert(out.chain.end(), at(out.b != chain[j + 1] ? j + 1 : j + 2), chain.end());
    return out;
}

Polyline cut_at_random(Polyline chain, Verdicts& verdicts, const std::vector<double>& draws, int misses) {
    std::vector<Polyline> history{std::move(chain)};
    int missed = 0;
    for (std::size_t k = 0; k + 1 < draws.size() && missed < misses && history.back().size() >= 3; k += 2) {
        ++missed;
        std::optional<Cut> shorter = cut(history.back(), draws[k], draws[k + 1]);
        if (!shorter || !verdicts.edge_is_free(shorter->a, shorter->b)) continue;
        missed = 0;
        history.push_back(std::move(shorter->chain));
    }
    // The rest of a piece that was cut is checked at other samples than the piece was: see smoothing.py.
    while (!verdicts.path_is_free(history.back())) history.pop_back();
    return history.back();
}

using Corner = std::array<Configuration, 3>;

// Where a corner, given between its neighbours, is pulled to; each pull must shorten the path by ``least``.
class Pulling {
  public:
    Pulling(const Corner& corner, Oracle& oracle, double least)
        : corner_(corner), oracle_(oracle), least_(least), places_{corner[1]}, tried_{corner[1]} {}

    Configuration pulled() {
        const Configuration &old = corner_[1], target = between(corner_[0], corner_[2], distance(corner_[0], old) / detour(old));
        std::vector<std::size_t> joints(old.size());
        std::iota(joints.begin(), joints.end(), std::size_t{0});
        std::stable_sort(joints.begin(), joints.end(), [&](std::size_t a, std::size_t b) {
            return std::fabs(target[a] - old[a]) > std::fabs(target[b] - old[b]);
        });
        pull(joints, target, 0.5);
        for (const double share : pulls)
            for (const std::size_t joint : joints) pull({joint}, target, share);
        while (places_.back() != old && !free(&Oracle::edge_is_free, places_.back())) places_.pop_back();
        return places_.back();
    }

  private:
    const Corner& corner_;
    Oracle& oracle_;
    double least_;
    Polyline places_;
    std::set<Configuration> tried_;

    double detour(const Configuration& q) const { return distance(corner_[0], q) + distance(q, corner_[2]); }

    bool free(bool (Oracle::*edge_is_free)(const Configuration&, const Configuration&, int), const Configuration& q) {
        return (oracle_.*edge_is_free)(corner_[0], q, START) && (oracle_.*edge_is_free)(q, corner_[2], BOTH);
    }

    void pull(const std::vector<std::size_t>& joints, const Configuration& target, double share) {
        Configuration moved = places_.back();
        for (const std::size_t joint : joints) moved[joint] += (target[joint] - moved[joint]) * share;
        if (tried_.count(moved) != 0 || !(detour(places_.back()) - detour(moved) >= least_)) return;
        tried_.insert(moved);
        if (free(&Oracle::edge_is_free_coarse, moved)) places_.push_back(std::move(moved));
    }
};

double length_of(const Polyline& chain) { return arithmetic::exact_sum(lengths_of(chain)); }

bool path_is_free(const Polyline& chain, std::size_t from, std::size_t to, Oracle& oracle) {
    for (std::size_t k = from; k < to; ++k)
        if (!oracle.edge_is_free(chain[k], chain[k + 1], search::NEITHER)) return false;
    return true;
}

// The straight way between two configurations, projected step by step onto the constraints; empty if it does not get there.
Polyline bridge(const Configuration& from, const Configuration& to, search::ConstrainedOracle& oracle, double longest) {
    constraints::Projector& projector = oracle.projector();
    Polyline out{from};
    for (double stride = longest;;) {
        oracle.poll();
        const double left = distance(out.back(), to);
        if (!(left > 0.0)) return out;
        const double step = std::min(stride, left);
        Configuration fresh = step == left ? to : between(out.back(), to, step / left);
        if (projector.step(out.back(), fresh, to, left, step, step == left)) {
            out.push_back(fresh);
            stride = std::min(2.0 * step, longest);
        } else if (step <= constraints::Projector::LEAST_STRIDE) {
            return {};
        } else {
            stride = step / 2.0;
        }
    }
}

// From each vertex by a bridge to the last, or half as far, and so on, if the bridge is free and shorter.
Polyline skip_by_bridges(const Polyline& chain, search::ConstrainedOracle& oracle, double longest) {
    Polyline kept{chain.front()};
    for (std::size_t last = 0; last + 1 < chain.size();) {
        std::size_t span = chain.size() - 1 - last;
        for (; span > 1; span /= 2) {
            const Polyline piece(chain.begin() + static_cast<std::ptrdiff_t>(last), chain.begin() + static_cast<std::ptrdiff_t>(last + span + 1));
            const Polyline way = bridge(piece.front(), piece.back(), oracle, longest);
            if (way.empty() || !(length_of(way) < length_of(piece)) || !path_is_free(way, 0, way.size() - 1, oracle)) continue;
            kept.insert(kept.end(), way.begin() + 1, way.end());
            break;
        }
        if (span == 1) kept.push_back(chain[last + 1]);
        last += span;
    }
    return kept;
}

// The chain with a bridge from u to v (shares of the length); none if it gains too little or is not free.
std::optional<Polyline> cut_by_bridge(const Polyline& chain, double u, double v, search::ConstrainedOracle& oracle, double longest) {
    if (v < u) std::swap(u, v);
    const std::vector<double> lengths = lengths_of(chain);
    const double total = arithmetic::exact_sum(lengths), before = u * total, after = v * total;
    const Place first = point_at(chain, lengths, before), second = point_at(chain, lengths, after);
    const std::size_t i = first.piece, j = second.piece;
    if (i == j || after - before - distance(first.q, second.q) < min_gain * total) return std::nullopt;
    const Polyline way = bridge(first.q, second.q, oracle, longest);
    if (way.empty() || after - before - length_of(way) < min_gain * total) return std::nullopt;
    const auto at = [&chain](std::size_t k) { return chain.begin() + static_cast<std::ptrdiff_t>(std::min(k, chain.size())); };
    Polyline out(chain.begin(), at(first.q != chain[i] ? i + 1 : i));
    const std::size_t begin = out.empty() ? 0 : out.size() - 1;
    out.insert(out.end(), way.begin(), way.end());
    const std::size_t end = out.size();
    out.insert(out.end(), at(second.q != chain[j + 1] ? j + 1 : j + 2), chain.end());
    if (!path_is_free(out, begin, std::min(end, out.size() - 1), oracle)) return std::nullopt;
    return out;
}

// From each vertex straight on to the last, or half as far, and so on, if that is free.
Polyline with_few_waypoints(const Polyline& chain, Oracle& oracle) {
    Polyline kept{chain.front()};
    for (std::size_t last = 0; last + 1 < chain.size();) {
        std::size_t span = chain.size() - 1 - last;
        while (span > 1 && !oracle.edge_is_free(chain[last], chain[last + span], search::NEITHER)) span /= 2;
        last += span;
        kept.push_back(chain[last]);
    }
    return kept;
}

// Whether a blend keeps the constraints at a few samples; smoothing.py has their number.
bool blend_is_kept(const timing::Blend& blend, Oracle& oracle) {
    Configuration q(blend.joints);
    for (int k = 1; k < kept_samples; ++k) {
        blend.position(blend.s - blend.width + 2.0 * blend.width * (k / static_cast<double>(kept_samples)), q.data());
        if (!oracle.is_kept(q.data())) return false;
    }
    return true;
}

// Whether a blend is free between its ends: CollisionChecker.blend_is_free, except that its ends are not compared with the joint
// limits; they lie on pieces that were found free.
bool blend_is_free(const timing::Blend& blend, Oracle& oracle) {
    if (oracle.constrained() && !blend_is_kept(blend, oracle)) return false;
    const std::size_t n = blend.joints;
    const double start = blend.s - blend.width, length = 2.0 * blend.width;
    Configuration fastest(n), last(n);
    blend.tangent(start, fastest.data());
    if (start + length >= blend.s + blend.width) last.assign(blend.after, blend.after + n);
    else blend.tangent(start + length, last.data());
    for (std::size_t k = 0; k < n; ++k) fastest[k] = std::max(std::fabs(fastest[k]), std::fabs(last[k])) * length;
    const int segments = oracle.segments(fastest);
    if (segments == 1) return true;
    std::vector<double> samples(static_cast<std::size_t>(segments - 1) * n);
    double* row = samples.data();
    for (const int k : collision::bisection_order(segments, segments - 1)) {
        blend.position(start + length * (static_cast<double>(k) / static_cast<double>(segments)), row);
        row += n;
    }
    return oracle.states_are_free(samples.data(), segments - 1);
}

}  // namespace

Polyline shortcut(const Polyline& waypoints, Oracle& oracle, const std::vector<double>& draws, int misses) {
    Polyline chain;
    for (const Configuration& q : waypoints)
        if (chain.empty() || q != chain.back()) chain.push_back(q);
    Verdicts verdicts(oracle, chain);
    return cut_at_random(skip_vertices(chain, verdicts), verdicts, draws, misses);
}

Polyline shortcut_on(const Polyline& waypoints, search::ConstrainedOracle& oracle, const std::vector<double>& draws, int misses,
                     double longest) {
    Polyline chain;
    for (const Configuration& q : waypoints)
        if (chain.empty() || q != chain.back()) chain.push_back(q);
    chain = skip_by_bridges(chain, oracle, longest);
    int missed = 0;
    for (std::size_t k = 0; k + 1 < draws.size() && missed < misses && chain.size() >= 3; k += 2) {
        ++missed;
        std::optional<Polyline> shorter = cut_by_bridge(chain, draws[k], draws[k + 1], oracle, longest);
        if (!shorter) continue;
        missed = 0;
        chain = std::move(*shorter);
    }
    return with_few_waypoints(chain, oracle);
}

Polyline pulled_in(Polyline chain, Oracle& oracle) {
    std::set<Corner> done;
    for (int round = 0; round < pull_rounds; ++round) {
        const double least = min_pull * arithmetic::exact_sum(lengths_of(chain));
        for (std::size_t k = 1; k + 1 < chain.size(); ++k) {
            const Corner corner{chain[k - 1], chain[k], chain[k + 1]};
            if (done.insert(corner).second) chain[k] = Pulling(corner, oracle, least).pulled();
        }
    }
    return chain;
}

Polyline without_short_pieces(Polyline chain, Oracle& oracle) {
    for (std::size_t k = 1; k + 1 < chain.size();) {
        const Configuration &before = chain[k - 1], &corner = chain[k], &after = chain[k + 1];
        const bool is_short = std::min(distance(before, corner), distance(corner, after)) < short_piece;
        if (is_short && oracle.edge_is_free(before, after, BOTH)) {
            chain.erase(chain.begin() + static_cast<std::ptrdiff_t>(k));
            k = std::max<std::size_t>(1, k - 1);
        } else {
            ++k;
        }
    }
    return chain;
}

std::vector<double> blend_widths(const Corners& path, Oracle& oracle, double least) {
    std::vector<double> widths;
    for (const std::int64_t corner : path.corners) {
        const auto k = static_cast<std::size_t>(corner);
        const std::size_t n = path.joints;
        const double *before = path.tangents + (k - 1) * n, *after = before + n;
        double width = 0.0;
        if (!path::turns_back(before, after, n)) {
            const double room = std::min(path.knots[k] - path.knots[k - 1], path.knots[k + 1] - path.knots[k]);
            width = std::min(path.sizes[k], blend_share * room);
            const auto free = [&] {
                return blend_is_free({n, path.knots[k], width, path.waypoints + k * n, before, after}, oracle);
            };
            while (width >= least && !free()) width /= 2.0;
        }
        widths.push_back(width >= least ? width : 0.0);
    }
    return widths;
}

}  // namespace smoothing
