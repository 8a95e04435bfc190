#include "diagram.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace proof {

namespace {

constexpr double ROUNDING = 1e-9;  // radians or metres of room beyond a joint's travel: its values have errors of 1e-14

// A pair that overlaps in the middle of a rectangle by more than so many times what it moves there is not looked at in its quarters.
constexpr double DEEP = 2.0;

}  // namespace

Diagram::Diagram(const Model& model, const Variant& variant, Motion first, Motion second, std::vector<double> still, double enough,
                 const std::vector<int>& roots)
    : model_(model),
      variant_(variant),
      motions_{std::move(first), std::move(second)},
      enough_(enough),
      places_(model, variant),
      nodes_(2),
      q_(std::move(still)),
      room_(q_.size(), 0.0),
      still_(q_.size(), 0.0) {
    nodes_[0].state = State::open;  // above the first: all that is to be proven
    for (const int pair : roots) nodes_[0].left.push_back({pair, false, {}});
}

std::vector<double> Diagram::blocked(double lead, double delay, int finest) {
    std::vector<double> out;
    std::vector<Cell> stack{{1, 0, 0, 0, 0}};
    while (!stack.empty()) {
        const Cell cell = stack.back();
        stack.pop_back();
        if (!met(cell, lead - delay, lead + delay, nullptr)) continue;
        const State state = look(cell);
        if (state == State::proven) continue;
        if (state == State::given_up || cell.level >= finest)
            met(cell, lead - delay, lead + delay, &out);
        else
            push_quarters(cell, stack);
    }
    return out;
}

void Diagram::proven(int level, bool* out) {
    const auto size = std::size_t{1} << level;
    std::vector<Cell> stack{{1, 0, 0, 0, 0}};
    while (!stack.empty()) {
        const Cell cell = stack.back();
        stack.pop_back();
        const State state = look(cell);
        if (state == State::open && cell.level < level) {
            push_quarters(cell, stack);
            continue;
        }
        const auto each = size >> cell.level, i = each * static_cast<std::size_t>(cell.i), j = each * static_cast<std::size_t>(cell.j);
        for (std::size_t k = i; k < i + each; ++k) std::fill_n(out + size * k + j, each, state == State::proven);
    }
}

void Diagram::push_quarters(const Cell& cell, std::vector<Cell>& stack) {
    const auto node = static_cast<std::size_t>(cell.node);
    if (nodes_[node].quarters < 0) {
        nodes_[node].quarters = static_cast<int>(nodes_.size());
        nodes_.resize(nodes_.size() + 4);
    }
    const int first = nodes_[node].quarters;
    for (int k = 3; k >= 0; --k)
        stack.push_back({first + k, cell.node, cell.level + 1, 2 * cell.i + k / 2, 2 * cell.j + k % 2});
}

// Whether a rectangle is passed with a lead between two, and those with which it is, into ``out``. The first clock runs from 0 to its
// duration, the second too, and each stands at an end while the other goes on: the line along which the lead is c goes on along the
// sides of the plane. So a rectangle is met by leads from a0 - b1 to a1 - b0; by more at the sides: by those from a0 on where the
// second still stands at its start, and so on.
bool Diagram::met(const Cell& cell, double low, double high, std::vector<double>* out) const {
    constexpr double none = std::numeric_limits<double>::infinity();
    const int last = (1 << cell.level) - 1;
    const double T = motions_[0].duration, U = motions_[1].duration, size = last + 1.0;
    const double a0 = cell.i * T / size, a1 = (cell.i + 1) * T / size, b0 = cell.j * U / size, b1 = (cell.j + 1) * U / size;
    const double spans[5][2] = {
        {a0 - b1, a1 - b0},
        {cell.j == 0 ? a0 : none, cell.j == 0 ? none : -none},
        {cell.i == 0 ? -none : none, cell.i == 0 ? -b0 : -none},
        {cell.i == last ? T - b1 : none, cell.i == last ? none : -none},
        {cell.j == last ? -none : none, cell.j == last ? a1 - U : -none},
    };
    bool found = false;
    for (const auto& span : spans) {
        if (!(span[0] <= span[1])) continue;
        found = found || (span[0] <= high && span[1] >= low);
        if (out != nullptr) out->insert(out->end(), span, span + 2);
    }
    return found;
}

Diagram::State Diagram::look(const Cell& cell) {
    const auto node = static_cast<std::size_t>(cell.node);
    if (nodes_[node].state != State::unknown) return nodes_[node].state;
    rectangles_ += 1.0;
    std::vector<Ask> left;
    const State found = judge(cell, left);
    nodes_[node].state = found;
    if (found == State::open) nodes_[node].left = std::move(left);
    return found;
}

// What is known of a rectangle, and the pairs that are left for its quarters.
Diagram::State Diagram::judge(const Cell& cell, std::vector<Ask>& left) {
    const auto step = std::size_t{1} << (LAST - cell.level);
    const std::size_t begins[2] = {step * static_cast<std::size_t>(cell.i), step * static_cast<std::size_t>(cell.j)};
    for (std::size_t k = 0; k < 2; ++k) {
        const Motion& motion = motions_[k];
        const std::size_t n = motion.columns.size();
        for (std::size_t j = 0; j < n; ++j) {
            const std::size_t begin = n * begins[k] + j, end = begin + n * step;
            const auto column = static_cast<std::size_t>(motion.columns[j]);
            q_[column] = 0.5 * (motion.q[begin] + motion.q[end]);
            room_[column] = 0.5 * (motion.travel[end] - motion.travel[begin]) + ROUNDING;
        }
    }
    places_.clear();
    places_.leave_room(room_.data());
    places_.add(0.0, q_.data(), still_.data());
    places_.begin_about(0, still_.data());
    std::vector<Ask> asks = nodes_[static_cast<std::size_t>(cell.above)].left;
    for (std::size_t k = 0; k < asks.size(); ++k) {  // those of bundles are added at the end
        Ask ask = asks[k];
        const Pair pair = model_.pair(ask.pair);
        if (places_.spheres_clear(pair, enough_)) continue;
        asked_ += 1.0;
        const double motion = places_.motion_about(pair);
        const Facing facing = places_.facing(pair, 0);
        Bound bound{};
        bound.gap = variant_.glance(facing);
        if (bound.gap - motion > enough_) continue;
        variant_.rough(model_.terms, facing, ask.n, ask.hinted ? 1 : 0, bound);
        if (bound.gap - motion > enough_) continue;
        if (!pair.leaf()) {
            if (model_.solid(pair.second).radius < motion)
                left.push_back(ask);
            else
                for (int child = 0; child < pair.children; ++child) asks.push_back({pair.child + child, false, {}});
            continue;
        }
        if (cell.level >= FIRST) {
            variant_.refined(model_.terms, facing, static_cast<int>(model_.terms.rounds), bound);
            if (bound.gap - motion > enough_ || apart_about(pair, bound)) continue;
            if (!(bound.gap > enough_) && (cell.level >= SMALL || bound.gap + DEEP * motion < enough_)) return State::given_up;
        }
        ask.hinted = bound.gap > -std::numeric_limits<double>::infinity();
        std::copy(bound.n, bound.n + 3, ask.n);
        left.push_back(ask);
    }
    if (left.empty()) return State::proven;
    return cell.level == LAST ? State::given_up : State::open;
}

// Whether a pair of two pieces stays apart along the direction of a bound all over the rectangle.
bool Diagram::apart_about(const Pair& pair, const Bound& bound) {
    if (!(bound.gap > enough_)) return false;
    for (const bool bent : {false, true}) {
        const Places::Approach found = places_.approach(pair, 0, bound.n, nullptr, bent);
        if (!(bound.gap - found.slope > enough_)) return false;
        if (bound.gap - (found.slope + found.rest) > enough_) return true;
    }
    return false;
}

}  // namespace proof
