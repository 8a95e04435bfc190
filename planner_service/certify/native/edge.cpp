#include "edge.hpp"

#include <algorithm>
#include <cmath>

namespace proof {

Edge::Edge(const Model& model, const Variant& variant, const Curve& curve, double enough, double nearer, const double* room)
    : model_(model),
      variant_(variant),
      curve_(curve),
      terms_(model.terms),
      enough_(enough),
      nearer_(nearer),
      roomy_(room != nullptr),
      places_(model, variant, false, room),
      q_(static_cast<std::size_t>(model.dof)),
      travel_(static_cast<std::size_t>(model.dof)) {}

LineVerdict judge_line(const Model& model, const Variant& variant, const double* q1, const double* q2, double enough, double nearer,
                       const double* room, const std::vector<int>& roots, const Bound& hint) {
    const auto n = static_cast<std::size_t>(model.dof);
    std::vector<double> points(q1, q1 + n), tangent(n);
    points.insert(points.end(), q2, q2 + n);
    double square = 0.0;
    for (std::size_t k = 0; k < n; ++k) {
        const double step = points[n + k] - points[k];
        square += step * step;
    }
    const double length = std::sqrt(square), knots[2] = {0.0, length};
    if (!std::isfinite(length)) return {};
    for (std::size_t k = 0; k < n; ++k) tangent[k] = (points[n + k] - points[k]) / length;
    const std::int64_t line = 0, blend = -1;
    const std::size_t pieces = length > 0.0 ? 1 : 0;
    const Curve curve(n, {pieces + 1, pieces, points.data(), knots, tangent.data(), knots, &line, &blend, nullptr});
    Edge edge(model, variant, curve, enough, nearer, room);
    const EdgeResult result = edge.run(roots, hint);
    return {true, result, edge.asked(), edge.whole(), edge.lost()};
}

EdgeResult Edge::run(const std::vector<int>& roots, const Bound& hint) {
    std::vector<Middle> open;
    bool going = middle(roots, hint, open) && (open.empty() || ends(open));
    while (going && !rows_.empty()) going = split() && halve();
    return out_;
}

std::size_t Edge::place(double s) {
    curve_.at(s, q_.data(), travel_.data());
    return places_.add(s, q_.data(), travel_.data());
}

// Whether so many bounds more may be asked.
// Of the bounds of an edge, what one with room may ask for: it is asked while an arm moves, and can be refused.
constexpr double ROOMY_SHARE = 8.0;

bool Edge::charge(std::size_t count, int pair, double s) {
    asked_ += static_cast<double>(count);
    if (asked_ <= (roomy_ ? terms_.edge_most / ROOMY_SHARE : terms_.edge_most)) return true;
    whole_ = false;
    lose(pair, s);
    return false;
}

// A pair that is neither apart nor overlaps as far as can be told; the others are looked at all the same.
void Edge::lose(int pair, double s, const Bound& bound) {
    if (out_.verdict == Verdict::free) out_ = {Verdict::undecided, pair, s};
    if (roomy_) lost_.push_back({pair, s, bound});
}

// Whether a pair is far enough apart at a node for all of its room; if it is not, no halving helps.
bool Edge::leaves_room(int pair, std::size_t node, const Bound& bound) {
    if (!roomy_ || bound.gap - places_.room_motion(pair_of(pair), node) > enough_) return true;
    if (apart_about(pair_of(pair), node, bound, nullptr)) return true;
    lose(pair, places_.s(node), bound);
    return false;
}

// Whether a pair stays apart along the direction of a bound, while joints travel so far from a node, and their room. For tubes only,
// and for pairs of two pieces, whose bounds have a direction once they are more than a glance.
bool Edge::apart_about(const Pair& pair, std::size_t node, const Bound& bound, const double* travel) {
    if (!roomy_ || !pair.leaf() || !(bound.gap > enough_)) return false;
    for (const bool bent : {false, true}) {
        const Places::Approach found = places_.approach(pair, node, bound.n, travel, bent);
        if (!(bound.gap - found.slope > enough_)) return false;
        if (bound.gap - (found.slope + found.rest) > enough_) return true;
    }
    return false;
}

// Whether it does from each end of a stretch to its middle.
bool Edge::apart_between(const Pair& pair, std::size_t left, const Bound& one, std::size_t right, const Bound& two) {
    if (!roomy_ || !pair.leaf()) return false;
    share_.resize(q_.size());
    for (std::size_t k = 0; k < share_.size(); ++k) share_[k] = 0.5 * (places_.travel(right)[k] - places_.travel(left)[k]);
    return apart_about(pair, left, one, share_.data()) && apart_about(pair, right, two, share_.data());
}

bool Edge::closed(const Bound& one, const Bound& two, double motion) const {
    const double a = one.gap, b = two.gap;
    return std::max(0.5 * (a + b - motion), std::max(a, b) - motion) > enough_;
}

// A bound of a pair at a node, as good as it takes to close what is open, or to say that nothing can.
template <class Closes, class Directed>
Edge::Found Edge::judge(int number, std::size_t node, const double* hints, int count, Bound& bound, const Closes& closes,
                        const Directed& directed) {
    const Pair pair = pair_of(number);
    const Facing facing = places_.facing(pair, node);
    bound.gap = variant_.glance(facing);
    if (closes(bound)) return Found::closed;  // so would be what ``rough`` finds
    variant_.rough(terms_, facing, hints, count, bound);
    if (closes(bound) || directed(bound)) return Found::closed;
    if (!pair.leaf()) return Found::open;
    variant_.refined(terms_, facing, static_cast<int>(terms_.rounds), bound);
    const auto settled = [&] {
        if (closes(bound) || directed(bound)) return Found::closed;
        return leaves_room(number, node, bound) ? Found::open : Found::lost;
    };
    if (bound.gap > enough_) return settled();
    const Contact contact = variant_.settled(terms_, facing, enough_, nearer_, bound);
    if (contact == Contact::apart) return settled();
    if (contact == Contact::overlap) {
        out_ = {Verdict::colliding, number, places_.s(node)};
        return Found::over;
    }
    lose(number, places_.s(node), bound);
    return Found::lost;
}

// Pairs that a look at the middle leaves open; false when it is over.
bool Edge::middle(const std::vector<int>& roots, const Bound& hint, std::vector<Middle>& open) {
    const double length = curve_.length();
    const std::size_t node = place(0.5 * length);
    std::vector<double> half = travel_;
    curve_.at(length, q_.data(), travel_.data());
    for (std::size_t k = 0; k < half.size(); ++k) half[k] = std::max(half[k], travel_[k] - half[k]);
    places_.begin_about(node, half.data());
    std::vector<Middle> asks;
    for (const int number : roots)
        if (!places_.spheres_clear(pair_of(number), enough_)) asks.push_back({number, hint});
    for (std::size_t first = 0; first < asks.size();) {  // those of bundles are added at the end
        const std::size_t last = asks.size();
        if (!charge(last - first, asks[first].pair, places_.s(node))) return false;
        for (; first < last; ++first) {
            const int number = asks[first].pair;
            const Pair pair = pair_of(number);
            const double motion = places_.motion_about(pair);
            const Bound known = asks[first].bound;
            const int hints = known.gap != 0.0 ? 1 : 0;
            Bound bound{};
            const Found found = judge(number, node, known.n, hints, bound,
                                      [&](const Bound& b) { return b.gap - motion > enough_; },
                                      [&](const Bound& b) { return apart_about(pair, node, b, half.data()); });
            if (found == Found::over) return false;
            if (found != Found::open) continue;
            if (stays_whole(pair, motion)) {
                open.push_back({number, bound});
                continue;
            }
            for (int child = 0; child < pair.children; ++child) {
                asks.push_back({pair.child + child, bound});
                asks.back().bound.gap = 1.0;  // a hint
            }
        }
    }
    return true;
}

// Halves of the edge that the middle leaves open, with a look at its ends.
bool Edge::ends(const std::vector<Middle>& open) {
    const double length = curve_.length();
    const std::size_t start = place(0.0), end = place(length);
    stretches_ = {{start, 0}, {0, end}};
    places_.begin_stretches(2);
    for (std::size_t half = 0; half < 2; ++half) {
        const Stretch& stretch = stretches_[half];
        const std::size_t node = half == 0 ? start : end;
        const std::size_t first = rows_.size();
        for (const Middle& known : open) {
            const double motion = places_.pair_motion(pair_of(known.pair), half, stretch.left, stretch.right);
            if (!(known.bound.gap - motion > enough_)) rows_.push_back({known.pair, half, motion, known.bound, known.bound});
        }
        if (rows_.size() > first && !charge(rows_.size() - first, rows_[first].pair, places_.s(node))) return false;
        std::size_t left = first;
        for (std::size_t k = first; k < rows_.size(); ++k) {
            Row row = rows_[k];
            Bound bound{};
            const Bound known = row.before;
            const Found found = judge(row.pair, node, known.n, 1, bound,
                                      [&](const Bound& b) { return closed(b, known, row.motion); },
                                      [&](const Bound& b) { return apart_between(pair_of(row.pair), stretch.left, half == 0 ? b : known,
                                                                                 stretch.right, half == 0 ? known : b); });
            if (found == Found::over) return false;
            if (found != Found::open) continue;
            (half == 0 ? row.before : row.after) = bound;
            rows_[left++] = row;
        }
        rows_.resize(left);
    }
    return true;
}

// Pairs with bundles that are larger than the motion give way to what is in them.
bool Edge::split() {
    std::vector<Row> asks, next;
    for (const Row& row : rows_)
        (stays_whole(pair_of(row.pair), row.motion) ? next : asks).push_back(row);
    if (asks.empty()) return true;
    while (!asks.empty()) {
        std::vector<Row> fresh, deeper;
        for (const Row& row : asks) {
            const Pair pair = pair_of(row.pair);
            for (int child = 0; child < pair.children; ++child) {
                fresh.push_back(row);
                fresh.back().pair = pair.child + child;
            }
        }
        if (!charge(2 * fresh.size(), fresh[0].pair, places_.s(stretches_[fresh[0].stretch].left))) return false;
        for (Row& row : fresh) {
            const Stretch& stretch = stretches_[row.stretch];
            row.motion = places_.pair_motion(pair_of(row.pair), row.stretch, stretch.left, stretch.right);
            double hints[6];
            std::copy(row.before.n, row.before.n + 3, hints);
            std::copy(row.after.n, row.after.n + 3, hints + 3);
            Bound left{}, right{};
            const Found one = judge(row.pair, stretch.left, hints, 2, left,
                                    [&](const Bound& b) { return b.gap - row.motion > enough_; },
                                    [&](const Bound&) { return false; });
            if (one == Found::over) return false;
            if (one != Found::open) continue;
            const Found two = judge(row.pair, stretch.right, hints, 2, right,
                                    [&](const Bound& b) { return closed(left, b, row.motion); },
                                    [&](const Bound& b) { return apart_between(pair_of(row.pair), stretch.left, left, stretch.right, b); });
            if (two == Found::over) return false;
            if (two != Found::open) continue;
            row.before = left;
            row.after = right;
            const Pair pair = pair_of(row.pair);
            (stays_whole(pair, row.motion) ? next : deeper).push_back(row);
        }
        asks = std::move(deeper);
    }
    rows_ = std::move(next);
    return true;
}

// What a look at the middle of each stretch leaves open of its halves.
bool Edge::halve() {
    if (rows_.empty()) return true;
    const Stretch& leading = stretches_[rows_[0].stretch];
    if (!charge(rows_.size(), rows_[0].pair, places_.s(leading.left))) return false;
    const std::size_t count = stretches_.size();
    std::vector<std::ptrdiff_t> number(count, -1);
    std::vector<Stretch> halves;
    for (const Row& row : rows_)
        if (number[row.stretch] < 0) {
            const Stretch& stretch = stretches_[row.stretch];
            const std::size_t node = place(0.5 * (places_.s(stretch.left) + places_.s(stretch.right)));
            number[row.stretch] = static_cast<std::ptrdiff_t>(halves.size());
            halves.push_back({stretch.left, node});
            halves.push_back({node, stretch.right});
        }
    places_.begin_stretches(halves.size());
    std::vector<Row> next;
    for (const Row& row : rows_) {
        const auto half = static_cast<std::size_t>(number[row.stretch]);
        const Stretch &one = halves[half], &two = halves[half + 1];
        const Pair pair = pair_of(row.pair);
        const double motions[2] = {places_.pair_motion(pair, half, one.left, one.right),
                                   places_.pair_motion(pair, half + 1, two.left, two.right)};
        double hints[9];
        for (int k = 0; k < 3; ++k) {
            hints[k] = row.before.n[k];
            hints[3 + k] = row.after.n[k];
            hints[6 + k] = row.before.n[k] + row.after.n[k];
        }
        Bound bound{};
        const auto first = [&](const Bound& b, bool directed) {
            return closed(row.before, b, motions[0]) || (directed && apart_between(pair, one.left, row.before, one.right, b));
        };
        const auto second = [&](const Bound& b, bool directed) {
            return closed(b, row.after, motions[1]) || (directed && apart_between(pair, two.left, b, two.right, row.after));
        };
        const Found found = judge(row.pair, one.right, hints, 3, bound,
                                  [&](const Bound& b) { return first(b, false) && second(b, false); },
                                  [&](const Bound& b) { return first(b, true) && second(b, true); });
        if (found == Found::over) return false;
        if (found != Found::open) continue;
        if (!first(bound, true)) next.push_back({row.pair, half, motions[0], row.before, bound});
        if (!second(bound, true)) next.push_back({row.pair, half + 1, motions[1], bound, row.after});
    }
    rows_ = std::move(next);
    stretches_ = std::move(halves);
    return true;
}

}  // namespace proof
