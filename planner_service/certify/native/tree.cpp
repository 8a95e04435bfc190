#include "tree.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace proof {

namespace {

constexpr double INFINITE = std::numeric_limits<double>::infinity();
constexpr std::size_t FEW = 64;  // nodes that are not worth forgetting
constexpr std::size_t NOWHERE = std::numeric_limits<std::size_t>::max();

constexpr std::size_t HALVINGS = 3;                                    // of a span, to look at spheres
constexpr std::size_t PARTS = (std::size_t{1} << (HALVINGS + 2)) - 1;   // of a span, with the halves of the smallest
constexpr std::size_t NODES = (std::size_t{1} << (HALVINGS + 1)) + 1;   // at their ends

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
    out_.most = static_cast<std::int64_t>(terms_.most) + 10 * static_cast<std::int64_t>(std::max(roots.size(), model_.judged));
    spans_ = spans;
    stretches_.assign(spans.size() * PARTS, {NOWHERE, NOWHERE});
    nodes_.assign(spans.size() * NODES, NOWHERE);
    places_.begin_stretches(stretches_.size());
    // The robot's own pairs first: how near these are says which others are far.
    const auto standing = std::stable_partition(roots.begin(), roots.end(), [this](const Root& root) {
        return static_cast<std::size_t>(pair_of(root.pair).second) < model_.riding;
    });
    bool going = begin({roots.begin(), standing}) && begin({standing, roots.end()});
    if (going) keep();
    std::vector<bool> splitting;
    while (going && !rows_.empty()) {
        splitting.clear();
        bool any = false;
        for (const Row& row : rows_) {
            const Pair pair = pair_of(row.pair);
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

// What spheres and looks at both ends leave open of some roots.
bool Tree::begin(const std::vector<Root>& roots) {
    const std::size_t first = rows_.size(), crowds = model_.crowds.size();
    std::vector<std::vector<int>> together(crowds * spans_.size());
    for (const Root& root : roots) {
        const bool still = !(spans_[root.span].end > spans_[root.span].start);
        const int crowd = model_.crowd(root.pair);
        if (trail_ == nullptr && !still && crowd >= 0) {
            together[root.span * crowds + static_cast<std::size_t>(crowd)].push_back(root.pair);
            continue;
        }
        const std::int64_t asked = out_.asked;
        if (still || sift(root.pair, {root.span, 0, 0})) leave(root.pair, {root.span, 0, 0});
        charge_.bounds(out_.asked - asked);
    }
    for (std::size_t k = 0; k < together.size(); ++k) {
        if (together[k].empty()) continue;
        const std::int64_t asked = out_.asked;
        sift_crowd(model_.crowds[k % crowds], together[k], {k / crowds, 0, 0});
        charge_.bounds(out_.asked - asked);
    }
    return ends(rows_, first, 0, terms_.near);
}

// Bounds at both ends of rows from ``first`` on, at the second only where the first does not suffice. ``hints`` is 2 if
// those of the rows have directions to try, else 0.
bool Tree::ends(std::vector<Row>& rows, std::size_t first, int hints, double close) {
    for (int end = 0; end < 2; ++end) {
        std::vector<Ask> asks;
        std::vector<double> tries;
        std::vector<std::size_t> which;
        for (std::size_t k = first; k < rows.size(); ++k) {
            const Row& row = rows[k];
            const Stretch& stretch = stretches_[row.stretch];
            if (end == 1 && (stretch.right == stretch.left || row.before.gap - row.motion >= spare())) continue;
            asks.push_back({row.pair, end == 0 ? stretch.left : stretch.right});
            which.push_back(k);
            const double* last = end == 0 ? row.before.n : row.after.n;
            const double* other = end == 0 ? row.after.n : row.before.n;
            if (hints > 0) tries.insert(tries.end(), {other[0], other[1], other[2], last[0], last[1], last[2]});
        }
        const Judged found = judge(asks, tries, hints, close, [&](std::size_t k, const Bound& bound) {
            const Row& row = rows[which[k]];
            return end == 0 ? bound.gap - row.motion >= spare() : shut(row.before, bound, row.motion);
        });
        if (found.bad >= 0) {
            const Ask& ask = asks[static_cast<std::size_t>(found.bad)];
            const double at = places_.s(ask.node);
            return obstructed(ask.pair, found.ends[static_cast<std::size_t>(found.bad)], {at, at}, at);
        }
        for (std::size_t k = 0; k < which.size(); ++k) (end == 0 ? rows[which[k]].before : rows[which[k]].after) = found.ends[k];
    }
    for (std::size_t k = first; k < rows.size(); ++k) {
        Row& row = rows[k];
        const Stretch& stretch = stretches_[row.stretch];
        if (stretch.right == stretch.left) row.after = row.before;
        else if (row.before.gap - row.motion >= spare()) row.after = {row.before.gap - row.motion, {}};  // follows from it
    }
    return true;
}

// Looks at the sphere around the first piece in the middle of a part of a span. Returns whether all of the part stays
// open; if not, what stays open of it is among the rows.
//
// A bundle is opened where it is larger than the motion or, if the sphere is near, than that sphere. What is near stays
// open: halving brings it no farther. The rest is halved.
bool Tree::sift(int number, const Part& part) {
    const Pair pair = pair_of(number);
    const Part one{part.span, part.level + 1, 2 * part.index}, two{part.span, part.level + 1, 2 * part.index + 1};
    const Look seen = look(pair, part);
    const Bound& found = seen.found;
    const double motion = std::max(seen.before, seen.after);
    if (seen.apart()) {
        out_.proven = std::min(out_.proven, found.gap - motion);
        const Stretch &left = stretch_of(one), &right = stretch_of(two);
        const double none[3] = {};
        note(number, places_.s(left.left), places_.s(left.right), none, found.n);
        note(number, places_.s(right.left), places_.s(right.right), found.n, none);
        return false;
    }
    const bool near = found.gap < seen.wanted;
    const double size = near ? model_.solid(pair.first).radius : motion;
    if (!pair.leaf() && size_of(pair) >= size) {
        for (int child = pair.child; child < pair.child + pair.children; ++child)
            if (sift(child, part)) leave(child, part);
        return false;
    }
    if (near || part.level == HALVINGS) return true;
    const bool first = sift(number, one), second = sift(number, two);
    if (first && second) return true;
    if (first) leave(number, one);
    if (second) leave(number, two);
    return false;
}

// The same of pairs that a sphere around all that rides on a body stands for: where it is near, or halving ends, each is
// looked at by itself.
void Tree::sift_crowd(const Pair& crowd, const std::vector<int>& pairs, const Part& part) {
    const Look seen = look(crowd, part);
    if (seen.apart()) {
        out_.proven = std::min(out_.proven, seen.found.gap - std::max(seen.before, seen.after));
    } else if (seen.found.gap < seen.wanted || part.level == HALVINGS) {
        for (const int pair : pairs)
            if (sift(pair, part)) leave(pair, part);
    } else {
        sift_crowd(crowd, pairs, {part.span, part.level + 1, 2 * part.index});
        sift_crowd(crowd, pairs, {part.span, part.level + 1, 2 * part.index + 1});
    }
}

Tree::Look Tree::look(const Pair& pair, const Part& part) {
    const Part one{part.span, part.level + 1, 2 * part.index}, two{part.span, part.level + 1, 2 * part.index + 1};
    const Stretch &left = stretch_of(one), &right = stretch_of(two);
    ++out_.asked;
    return {places_.sphere_apart(pair, left.right), places_.pair_motion(pair, number_of(one), left.left, left.right),
            places_.pair_motion(pair, number_of(two), right.left, right.right),
            std::max(enough_, std::min(terms_.far, smallest_))};
}

// A part of a span that is to be looked at more closely.
void Tree::leave(int number, const Part& part) {
    const Stretch& stretch = stretch_of(part);
    const double motion = places_.pair_motion(pair_of(number), number_of(part), stretch.left, stretch.right);
    rows_.push_back({number, number_of(part), motion, {}, {}});
}

std::size_t Tree::number_of(const Part& part) const {
    return part.span * PARTS + ((std::size_t{1} << part.level) - 1) + part.index;
}

const Tree::Stretch& Tree::stretch_of(const Part& part) {
    Stretch& out = stretches_[number_of(part)];
    if (out.left != NOWHERE) return out;
    const std::size_t step = (NODES - 1) >> part.level;
    const auto node = [&](std::size_t index) {
        const Span& span = spans_[part.span];
        if (!(span.end > span.start)) index = 0;
        std::size_t& found = nodes_[part.span * NODES + index];
        const double share = static_cast<double>(index) / static_cast<double>(NODES - 1);
        if (found == NOWHERE) found = place(index == NODES - 1 ? span.end : span.start + share * (span.end - span.start));
        return found;
    };
    out = {node(part.index * step), node((part.index + 1) * step)};
    return out;
}

// The same with some pairs replaced by their children, as far as these are not proven.
bool Tree::split(const std::vector<bool>& splitting) {
    std::vector<Row> rest, fresh;
    places_.begin_stretches(stretches_.size());
    for (std::size_t k = 0; k < rows_.size(); ++k) {
        const Row& row = rows_[k];
        if (!splitting[k]) {
            rest.push_back(row);
            continue;
        }
        const Stretch& stretch = stretches_[row.stretch];
        const Pair pair = pair_of(row.pair);
        for (int child = pair.child; child < pair.child + pair.children; ++child) {
            const double motion = places_.pair_motion(pair_of(child), row.stretch, stretch.left, stretch.right);
            fresh.push_back({child, row.stretch, motion, row.before, row.after});
        }
    }
    if (!ends(fresh, 0, 2, close())) return false;
    rows_ = std::move(rest);
    rows_.insert(rows_.end(), fresh.begin(), fresh.end());
    keep();
    return true;
}

// What a look at the middle of each stretch leaves open of its halves.
bool Tree::halve() {
    const std::size_t count = stretches_.size();
    for (std::size_t k = 0; k < count; ++k) {
        const std::size_t middle = place(0.5 * (places_.s(stretches_[k].left) + places_.s(stretches_[k].right)));
        stretches_.push_back({middle, stretches_[k].right});
        stretches_[k].right = middle;
    }
    places_.begin_stretches(2 * count);
    std::vector<Ask> asks;
    std::vector<double> hints;
    const std::size_t open = rows_.size();
    rows_.reserve(2 * open);
    for (std::size_t k = 0; k < open; ++k) {
        Row& row = rows_[k];
        const Stretch &one = stretches_[row.stretch], &two = stretches_[row.stretch + count];
        const Pair pair = pair_of(row.pair);
        row.motion = places_.pair_motion(pair, row.stretch, one.left, one.right);
        rows_.push_back({row.pair, row.stretch + count, places_.pair_motion(pair, row.stretch + count, two.left, two.right), {}, row.after});
        asks.push_back({row.pair, one.right});
        const double *a = row.before.n, *b = row.after.n;
        hints.insert(hints.end(), {a[0], a[1], a[2], b[0], b[1], b[2]});
        hints.insert(hints.end(), {a[0] + b[0], a[1] + b[1], a[2] + b[2]});
    }
    const Judged found = judge(asks, hints, 3, close(), [&](std::size_t k, const Bound& bound) {
        const Row &one = rows_[k], &two = rows_[open + k];
        return shut(one.before, bound, one.motion) && shut(bound, two.after, two.motion);
    });
    if (found.bad >= 0) {
        const auto bad = static_cast<std::size_t>(found.bad);
        const double start = places_.s(stretches_[rows_[bad].stretch].left), end = places_.s(stretches_[rows_[open + bad].stretch].right);
        return obstructed(rows_[bad].pair, found.ends[bad], {start, end}, places_.s(asks[bad].node));
    }
    for (std::size_t k = 0; k < open; ++k) rows_[k].after = rows_[open + k].before = found.ends[k];
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

// Metres that a cheap bound has to prove to be good enough: it would not lower what is proven of all.
double Tree::spare() const { return std::max(enough_, smallest_); }

bool Tree::shut(const Bound& one, const Bound& two, double motion) const {
    return std::min(0.5 * (one.gap + two.gap - motion), std::min(one.gap, two.gap)) >= spare();
}

// Bounds of pairs at nodes, one each and no better than it takes to close a row, up to a row without a bundle that is
// not far enough apart.
template <class Closes>
Tree::Judged Tree::judge(const std::vector<Ask>& asks, const std::vector<double>& hints, int each, double close,
                         const Closes& closes) {
    Judged found;
    const auto batch = static_cast<std::size_t>(terms_.batch);
    found.ends.resize(asks.size());
    found.enough.assign(asks.size(), false);
    std::vector<Facing> facings(std::min(batch, asks.size()));
    for (std::size_t first = 0; found.bad < 0 && first < asks.size();) {
        const std::size_t last = std::min(first + batch, asks.size());
        charge_.bounds(static_cast<std::int64_t>(last - first));
        out_.asked += static_cast<std::int64_t>(last - first);
        for (std::size_t k = first; k < last; ++k) {
            const Pair pair = pair_of(asks[k].pair);
            Bound& bound = found.ends[k];
            bound = places_.sphere_apart(pair, asks[k].node);
            if (closes(k, bound)) {
                found.enough[k] = true;
                continue;
            }
            Facing& facing = facings[k - first] = places_.facing(pair, asks[k].node);
            const double* tries = hints.data() + 3 * static_cast<std::size_t>(each) * k;
            if (each == 3 && trail_ == nullptr) variant_.hinted(terms_, facing, tries, each, bound);
            else variant_.rough(terms_, facing, tries, each, bound);
            found.enough[k] = trail_ == nullptr && closes(k, bound);  // a better one would not prove more
        }
        found.bad = tighten(asks, first, last, close, facings, found);
        first = last;
    }
    return found;
}

// A better bound, also of an overlap where these are what is judged.
void Tree::refine(const Facing& facing, int rounds, Bound& bound) const {
    variant_.refined(terms_, facing, rounds, bound);
    if (enough_ <= 0.0 && bound.gap < 0.0) variant_.drawn_apart(terms_, facing, static_cast<int>(terms_.rounds), bound);
}

// The same with better bounds of pairs that are close, and the worst row that is not far enough apart, if any is.
std::ptrdiff_t Tree::tighten(const std::vector<Ask>& asks, std::size_t first, std::size_t last, double close,
                             std::vector<Facing>& facings, Judged& found) {
    const int rounds = static_cast<int>(terms_.rounds), last_rounds = static_cast<int>(terms_.last_rounds);
    std::vector<Bound>& ends = found.ends;
    for (std::size_t k = first; k < last; ++k) {
        if (found.enough[k]) continue;
        const Pair pair = pair_of(asks[k].pair);
        if (pair.leaf() && ends[k].gap < close) refine(facings[k - first], rounds, ends[k]);
        smallest_ = std::min(smallest_, pair.leaf() ? ends[k].gap : ends[k].gap + 2.0 * size_of(pair));
    }
    std::ptrdiff_t worst = -1;
    for (std::size_t k = first; k < last; ++k) {
        if (found.enough[k] || !pair_of(asks[k].pair).leaf() || ends[k].gap > enough_) continue;
        refine(facings[k - first], last_rounds, ends[k]);
        if (worst < 0 || ends[k].gap < ends[static_cast<std::size_t>(worst)].gap) worst = static_cast<std::ptrdiff_t>(k);
    }
    return worst < 0 || ends[static_cast<std::size_t>(worst)].gap > enough_ ? -1 : worst;
}

// What is proven of a row by bounds along one direction at both ends, that of either; -infinity if less than wanted.
double Tree::bent(const Row& row, double wanted) {
    const Stretch& stretch = stretches_[row.stretch];
    const double least = std::min(row.before.gap, row.after.gap);
    if (trail_ != nullptr || stretch.left == stretch.right || least < wanted) return -INFINITE;
    double* strays = strays_.data() + row.stretch * q_.size();
    std::int8_t& even = evenness_[row.stretch];
    if (even < 0) even = curve_.strays(places_.s(stretch.left), places_.s(stretch.right), strays) ? 1 : 0;
    if (even == 0) return -INFINITE;
    const Pair pair = pair_of(row.pair);
    const double bend = places_.pair_bend(pair, row.stretch, stretch.left, stretch.right, strays);
    if (least - bend < wanted) return -INFINITE;
    const bool nearer_before = row.before.gap < row.after.gap;
    for (const bool from_before : {nearer_before, !nearer_before}) {
        const Bound& known = from_before ? row.before : row.after;
        const std::size_t from = from_before ? stretch.left : stretch.right, to = from_before ? stretch.right : stretch.left;
        ++out_.asked;
        const double bound = places_.steady(pair, from, to, known, bend);
        if (bound >= wanted) return bound;
    }
    return -INFINITE;
}

// Accept the rows that are proven; the others' stretches are numbered anew.
void Tree::keep() {
    const double wanted = enough_ > 0.0 ? std::max(enough_, terms_.fraction * smallest_) : enough_;
    std::vector<std::ptrdiff_t> number(stretches_.size(), -1);
    std::size_t left = 0;
    strays_.resize(stretches_.size() * q_.size());
    evenness_.assign(stretches_.size(), -1);
    const std::int64_t asked = out_.asked;
    for (const Row& row : rows_) {
        const Stretch& stretch = stretches_[row.stretch];
        const double motion = row.motion;
        const double one = row.before.gap, two = row.after.gap;
        double bound = std::min(0.5 * (one + two - motion), std::min(one, two));
        if (!(bound >= wanted)) bound = bent(row, wanted);
        if (bound >= wanted) {
            out_.proven = std::min(out_.proven, bound);
            note(row.pair, places_.s(stretch.left), places_.s(stretch.right), row.before.n, row.after.n);
            continue;
        }
        number[row.stretch] = 0;
        rows_[left++] = row;
    }
    rows_.resize(left);
    charge_.bounds(out_.asked - asked);
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
