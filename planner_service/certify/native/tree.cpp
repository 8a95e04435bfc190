#include "tree.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace proof {

namespace {

constexpr double INFINITE = std::numeric_limits<double>::infinity();
constexpr std::size_t FEW = 64;  // nodes that are not worth forgetting

}  // namespace

Tree::Tree(const Model& model, const Variant& variant, const Curve& curve, double enough, Charge& charge,
           const Curve* walked, std::vector<Leaf>* trail)
    : model_(model),
      variant_(variant),
      curve_(curve),
      terms_(model.terms),
      enough_(enough),
      charge_(charge),
      walked_(walked),
      trail_(trail),
      places_(model, variant, trail != nullptr),
      smallest_(INFINITE),
      q_(static_cast<std::size_t>(model.dof)),
      travel_(static_cast<std::size_t>(model.dof)),
      unused_(static_cast<std::size_t>(model.dof)) {}

Outcome Tree::run(const std::vector<Span>& spans, std::vector<Root> roots) {
    out_.proven = INFINITE;
    std::size_t leaves = 0;
    for (const Pair& pair : model_.pairs) leaves += pair.leaf() ? 1U : 0U;
    out_.most = static_cast<std::int64_t>(terms_.most) + 10 * static_cast<std::int64_t>(std::max(roots.size(), leaves));
    if (curve_.length() > 0.0) drop_far(spans, roots);
    bool going = root(spans, roots);
    std::vector<bool> splitting;
    while (going && !rows_.empty()) {
        splitting.clear();
        bool any = false;
        for (const Row& row : rows_) {
            const Pair& pair = pair_of(row.pair);
            const bool splits = !pair.leaf() && size_of(pair) >= row.motion;
            splitting.push_back(splits);
            any = any || splits;
        }
        going = any ? split(splitting) : !stuck() && halve();
    }
    return out_;
}

double Tree::close() const { return enough_ > 0.0 ? terms_.close * std::max(smallest_, enough_) : terms_.near; }

void Tree::note(int pair, double start, double end, const double* before, const double* after) {
    if (trail_ == nullptr) return;
    Leaf leaf{pair, {start, end}};
    std::copy(before, before + 3, leaf.numbers + 2);
    std::copy(after, after + 3, leaf.numbers + 5);
    trail_->push_back(leaf);
}

std::size_t Tree::place(double s) {
    curve_.at(s, q_.data(), travel_.data());
    if (walked_ != nullptr) walked_->at(s, travel_.data(), unused_.data());
    return places_.add(s, q_.data(), travel_.data());
}

// Roots whose bounding spheres are far apart all along are proven.
void Tree::drop_far(const std::vector<Span>& spans, std::vector<Root>& roots) {
    const std::size_t count = spans.size();
    for (const Span& span : spans) place(span.start);
    for (const Span& span : spans) place(0.5 * (span.start + span.end));
    for (const Span& span : spans) place(span.end);
    charge_.bounds(static_cast<std::int64_t>(roots.size()));
    out_.asked += static_cast<std::int64_t>(roots.size());
    places_.begin_stretches(2 * count);
    const double wanted = std::max(enough_, terms_.far);
    std::size_t left = 0;
    for (const Root& root : roots) {
        const Pair& pair = pair_of(root.pair);
        const std::size_t k = root.span, middle = count + k;
        const double apart = places_.spheres_apart(pair, middle);
        const double one = places_.pair_motion(pair, k, k, middle);
        const double two = places_.pair_motion(pair, count + k, middle, 2 * count + k);
        if (apart - one >= wanted && apart - two >= wanted) {  // both: what is no number proves nothing
            out_.proven = std::min(out_.proven, apart - std::max(one, two));
            if (trail_ == nullptr) continue;
            const Facing facing = places_.facing(pair, middle);
            const double* x = facing.x;
            const double length = std::sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]), none[3] = {};
            const double n[3] = {x[0] / length, x[1] / length, x[2] / length};
            note(root.pair, spans[k].start, places_.s(middle), none, n);
            note(root.pair, places_.s(middle), spans[k].end, n, none);
        } else {
            roots[left++] = root;
        }
    }
    roots.resize(left);
    places_.clear();
}

// What both ends of each span leave open.
bool Tree::root(const std::vector<Span>& spans, const std::vector<Root>& roots) {
    std::vector<double> s;
    for (const Span& span : spans) {
        s.push_back(span.start);
        s.push_back(span.end);
    }
    std::sort(s.begin(), s.end());
    s.erase(std::unique(s.begin(), s.end()), s.end());
    for (const double each : s) place(each);
    const auto node = [&](double at) {
        return static_cast<std::size_t>(std::lower_bound(s.begin(), s.end(), at) - s.begin());
    };
    for (const Span& span : spans) stretches_.push_back({node(span.start), node(span.end)});
    for (const Root& root : roots) rows_.push_back({root.pair, root.span, 0.0, {}, {}});
    const int ends = s.size() > 1 ? 2 : 1;  // a point has one end
    for (int end = 0; end < ends; ++end) {
        std::vector<Ask> asks;
        for (const Root& root : roots)
            asks.push_back({root.pair, end == 0 ? stretches_[root.span].left : stretches_[root.span].right});
        const Judged found = judge(asks, {}, 0, terms_.near);
        if (found.bad >= 0) {
            const Ask& ask = asks[static_cast<std::size_t>(found.bad)];
            const double at = places_.s(ask.node);
            return obstructed(ask.pair, found.ends[static_cast<std::size_t>(found.bad)], {at, at}, at);
        }
        for (std::size_t k = 0; k < rows_.size(); ++k) {
            if (end == 0) rows_[k].before = found.ends[k];
            rows_[k].after = found.ends[k];
        }
    }
    keep();
    return true;
}

// The same with some pairs replaced by their children, as far as these are not proven.
bool Tree::split(const std::vector<bool>& splitting) {
    std::vector<Row> rest, fresh;
    std::vector<double> hints;
    for (std::size_t k = 0; k < rows_.size(); ++k) {
        const Row& row = rows_[k];
        if (!splitting[k]) {
            rest.push_back(row);
            continue;
        }
        const Pair& pair = pair_of(row.pair);
        for (int child = 0; child < pair.children; ++child) {
            fresh.push_back({pair.child + child, row.stretch, 0.0, {}, {}});
            hints.insert(hints.end(), row.before.n, row.before.n + 3);
            hints.insert(hints.end(), row.after.n, row.after.n + 3);
        }
    }
    for (int end = 0; end < 2; ++end) {
        std::vector<Ask> asks;
        for (const Row& row : fresh)
            asks.push_back({row.pair, end == 0 ? stretches_[row.stretch].left : stretches_[row.stretch].right});
        const Judged found = judge(asks, hints, 2, close());
        if (found.bad >= 0) {
            const Ask& ask = asks[static_cast<std::size_t>(found.bad)];
            const double at = places_.s(ask.node);
            return obstructed(ask.pair, found.ends[static_cast<std::size_t>(found.bad)], {at, at}, at);
        }
        for (std::size_t k = 0; k < fresh.size(); ++k) (end == 0 ? fresh[k].before : fresh[k].after) = found.ends[k];
    }
    rows_ = std::move(rest);
    rows_.insert(rows_.end(), fresh.begin(), fresh.end());
    keep();
    return true;
}

// What a look at the middle of each stretch leaves open of its halves.
bool Tree::halve() {
    const std::size_t count = stretches_.size();
    std::vector<std::size_t> middles;
    for (const Stretch& stretch : stretches_)
        middles.push_back(place(0.5 * (places_.s(stretch.left) + places_.s(stretch.right))));
    std::vector<Ask> asks;
    std::vector<double> hints;
    for (const Row& row : rows_) {
        const double *one = row.before.n, *two = row.after.n;
        asks.push_back({row.pair, middles[row.stretch]});
        hints.insert(hints.end(), {one[0], one[1], one[2], two[0], two[1], two[2]});
        hints.insert(hints.end(), {one[0] + two[0], one[1] + two[1], one[2] + two[2]});
    }
    const Judged found = judge(asks, hints, 3, close());
    if (found.bad >= 0) {
        const auto bad = static_cast<std::size_t>(found.bad);
        const Stretch& stretch = stretches_[rows_[bad].stretch];
        return obstructed(rows_[bad].pair, found.ends[bad], {places_.s(stretch.left), places_.s(stretch.right)},
                          places_.s(asks[bad].node));
    }
    for (std::size_t k = 0; k < count; ++k) {
        stretches_.push_back({middles[k], stretches_[k].right});
        stretches_[k].right = middles[k];
    }
    const std::size_t open = rows_.size();
    rows_.reserve(2 * open);
    for (std::size_t k = 0; k < open; ++k) {
        rows_.push_back({rows_[k].pair, rows_[k].stretch + count, 0.0, found.ends[k], rows_[k].after});
        rows_[k].after = found.ends[k];
    }
    keep();
    return true;
}

// Whether the proof cannot go on.
bool Tree::stuck() {
    const bool spent = out_.asked + static_cast<std::int64_t>(rows_.size()) > out_.most;
    std::ptrdiff_t worst = -1;
    double least = INFINITE;
    for (std::size_t k = 0; k < rows_.size(); ++k) {
        const Stretch& stretch = stretches_[rows_[k].stretch];
        const double start = places_.s(stretch.left), end = places_.s(stretch.right), middle = 0.5 * (start + end);
        if (!spent && middle > start && middle < end) continue;
        const double gap = std::min(rows_[k].before.gap, rows_[k].after.gap);
        if (worst < 0 || gap < least) {
            worst = static_cast<std::ptrdiff_t>(k);
            least = gap;
        }
    }
    if (worst < 0) return false;
    const Row& row = rows_[static_cast<std::size_t>(worst)];
    const Stretch& stretch = stretches_[row.stretch];
    out_.end = spent ? End::spent : End::pointlike;
    out_.pair = row.pair;
    out_.span = {places_.s(stretch.left), places_.s(stretch.right)};
    out_.s = 0.5 * (out_.span.start + out_.span.end);
    return true;
}

bool Tree::obstructed(int pair, const Bound& found, Span span, double s) {
    out_.end = End::close;
    out_.pair = pair;
    out_.gap = found.gap;
    out_.span = span;
    out_.s = s;
    return false;
}

// Bounds of pairs at nodes, one each, up to a row without a bundle that is not far enough apart.
Tree::Judged Tree::judge(const std::vector<Ask>& asks, const std::vector<double>& hints, int each, double close) {
    Judged found;
    const auto batch = static_cast<std::size_t>(terms_.batch);
    std::vector<Facing> facings;
    std::size_t first = 0;
    do {
        const std::size_t last = std::min(first + batch, asks.size());
        charge_.bounds(static_cast<std::int64_t>(last - first));
        out_.asked += static_cast<std::int64_t>(last - first);
        facings.clear();
        for (std::size_t k = first; k < last; ++k) {
            facings.push_back(places_.facing(pair_of(asks[k].pair), asks[k].node));
            found.ends.emplace_back();
            const double* tries = hints.data() + 3 * static_cast<std::size_t>(each) * k;
            variant_.rough(terms_, facings.back(), tries, each, found.ends.back());
        }
        found.bad = tighten(asks, first, last, close, facings, found.ends);
        first = last;
    } while (found.bad < 0 && first < asks.size());
    return found;
}

// A better bound, also of an overlap where these are what is judged.
void Tree::refine(const Facing& facing, int rounds, Bound& bound) const {
    variant_.refined(terms_, facing, rounds, bound);
    if (enough_ <= 0.0 && bound.gap < 0.0) variant_.drawn_apart(terms_, facing, static_cast<int>(terms_.rounds), bound);
}

// The same with better bounds of pairs that are close, and the worst row that is not far enough apart, if any is.
std::ptrdiff_t Tree::tighten(const std::vector<Ask>& asks, std::size_t first, std::size_t last, double close,
                             std::vector<Facing>& facings, std::vector<Bound>& ends) {
    const int rounds = static_cast<int>(terms_.rounds), last_rounds = static_cast<int>(terms_.last_rounds);
    for (std::size_t k = first; k < last; ++k) {
        const Pair& pair = pair_of(asks[k].pair);
        if (pair.leaf() && ends[k].gap < close) refine(facings[k - first], rounds, ends[k]);
        smallest_ = std::min(smallest_, pair.leaf() ? ends[k].gap : ends[k].gap + 2.0 * size_of(pair));
    }
    std::ptrdiff_t worst = -1;
    for (std::size_t k = first; k < last; ++k) {
        if (!pair_of(asks[k].pair).leaf() || ends[k].gap > enough_) continue;
        refine(facings[k - first], last_rounds, ends[k]);
        if (worst < 0 || ends[k].gap < ends[static_cast<std::size_t>(worst)].gap) worst = static_cast<std::ptrdiff_t>(k);
    }
    return worst < 0 || ends[static_cast<std::size_t>(worst)].gap > enough_ ? -1 : worst;
}

// Accept the rows that are proven; the others' stretches are numbered anew.
void Tree::keep() {
    const double wanted = enough_ > 0.0 ? std::max(enough_, terms_.fraction * smallest_) : enough_;
    std::vector<std::ptrdiff_t> number(stretches_.size(), -1);
    places_.begin_stretches(stretches_.size());
    std::size_t left = 0;
    for (const Row& row : rows_) {
        const Stretch& stretch = stretches_[row.stretch];
        const double motion = places_.pair_motion(pair_of(row.pair), row.stretch, stretch.left, stretch.right);
        const double one = row.before.gap, two = row.after.gap;
        const double bound = std::min(0.5 * (one + two - motion), std::min(one, two));
        if (bound >= wanted) {
            out_.proven = std::min(out_.proven, bound);
            note(row.pair, places_.s(stretch.left), places_.s(stretch.right), row.before.n, row.after.n);
            continue;
        }
        number[row.stretch] = 0;
        rows_[left] = row;
        rows_[left++].motion = motion;
    }
    rows_.resize(left);
    std::size_t used = 0;
    for (std::size_t k = 0; k < stretches_.size(); ++k) {
        if (number[k] < 0) continue;
        number[k] = static_cast<std::ptrdiff_t>(used);
        stretches_[used++] = stretches_[k];
    }
    stretches_.resize(used);
    for (Row& row : rows_) row.stretch = static_cast<std::size_t>(number[row.stretch]);
    forget();
}

// Nodes at which no open stretch ends.
void Tree::forget() {
    if (places_.count() < FEW || places_.count() < 3 * stretches_.size()) return;
    std::vector<std::size_t> number(places_.count(), 0), nodes;
    for (const Stretch& stretch : stretches_) number[stretch.left] = number[stretch.right] = 1;
    for (std::size_t k = 0; k < number.size(); ++k)
        if (number[k] != 0) {
            number[k] = nodes.size();
            nodes.push_back(k);
        }
    places_.keep(nodes);
    for (Stretch& stretch : stretches_) stretch = {number[stretch.left], number[stretch.right]};
}

}  // namespace proof
