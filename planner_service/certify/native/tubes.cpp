#include "tubes.hpp"

#include <algorithm>
#include <cmath>

namespace proof {

namespace {

// Bounds that a part of a room may take: one that takes more counts as more parts.
constexpr double kBoundsOfPart = 8.0;

// Edges are judged as one if that has at most so many times their room, and for so many pairs at most.
constexpr double kStraight = 1.5;
constexpr std::size_t kFewPairs = 48;
constexpr double kEven = 1e-9, kRounding = 1e-12;  // radians (or metres)

struct Part {
    std::vector<double> start, end, room, moves;
};

}  // namespace

Tubes::Tubes(const Model& model, const Variant& variant, std::size_t count, const double* starts, const double* ends,
             const double* room, double enough, double nearer, int parts, int each)
    : model_(model),
      variant_(variant),
      n_(static_cast<std::size_t>(model.dof)),
      count_(count),
      starts_(starts),
      ends_(ends),
      room_(room),
      enough_(enough),
      nearer_(nearer),
      parts_(parts),
      each_(each),
      places_(model, variant),
      middle_(n_),
      reach_(n_),
      beside_(n_),
      still_(n_, 0.0) {}

std::size_t Tubes::run(const std::vector<int>& roots) {
    return count_ == 0 ? 0 : free(0, count_, roots);
}

// How many edges from the first on are free, at most all before the last.
std::size_t Tubes::free(std::size_t first, std::size_t last, const std::vector<int>& pairs) {
    if (pairs.empty()) return last - first;
    if (last - first == 1) return edge(first, pairs) ? 1 : 0;
    const std::vector<int> open = left_as_one(first, last, left(first, last, pairs));
    if (open.empty()) return last - first;
    const std::size_t half = first + (last - first) / 2, found = free(first, half, open);
    return found < half - first ? found : found + free(half, last, open);
}

// Pairs that are not far enough apart on some edges that lie roughly on a line, as one edge from the first start to the last end with
// more room. Each end of an edge is given a point of that line; what is on an edge is no farther from the point between those two, in
// each joint, than one of the ends from its own. So all of it is on the line or beside it, if that and the edge's room are in the room.
std::vector<int> Tubes::left_as_one(std::size_t first, std::size_t last, std::vector<int> pairs) {
    if (pairs.empty() || pairs.size() > kFewPairs) return pairs;
    const double *start = starts_ + n_ * first, *end = ends_ + n_ * (last - 1);
    double square = 0.0;
    for (std::size_t j = 0; j < n_; ++j) square += (end[j] - start[j]) * (end[j] - start[j]);
    std::vector<double> room(n_, 0.0), most(n_, 0.0);
    for (std::size_t k = first; k < last; ++k)
        for (const double* q : {starts_ + n_ * k, ends_ + n_ * k}) {
            double along = 0.0;
            for (std::size_t j = 0; j < n_; ++j) along += (q[j] - start[j]) * (end[j] - start[j]);
            const double share = square > 0.0 ? std::clamp(along / square, 0.0, 1.0) : 0.0;
            for (std::size_t j = 0; j < n_; ++j) {
                const double off = std::abs(q[j] - (start[j] + share * (end[j] - start[j])));
                room[j] = std::max(room[j], off + room_[n_ * k + j]);
                most[j] = std::max(most[j], room_[n_ * k + j]);
            }
        }
    for (std::size_t j = 0; j < n_; ++j) {
        if (room[j] > kStraight * most[j] + kEven) return pairs;
        if (room[j] > 0.0) room[j] += kRounding;
    }
    const auto judged = judge_line(model_, variant_, start, end, enough_, nearer_, room.data(), pairs);
    asked_ += judged.asked;
    if (!judged.taken || !judged.whole || judged.result.verdict == Verdict::colliding) return pairs;
    std::vector<int> open;
    for (const Lost& lost : judged.lost)
        if (std::find(open.begin(), open.end(), lost.pair) == open.end()) open.push_back(lost.pair);
    return open;
}

// Everything in the middle of some edges, with what it takes to get from there to whatever is on them or beside them.
void Tubes::stand_amid(std::size_t first, std::size_t last) {
    for (std::size_t j = 0; j < n_; ++j) {
        double low = starts_[n_ * first + j], high = low, room = 0.0;
        for (std::size_t k = first; k < last; ++k) {
            low = std::min({low, starts_[n_ * k + j], ends_[n_ * k + j]});
            high = std::max({high, starts_[n_ * k + j], ends_[n_ * k + j]});
            room = std::max(room, room_[n_ * k + j]);
        }
        middle_[j] = 0.5 * (low + high);
        reach_[j] = std::max(high - middle_[j], middle_[j] - low);
        beside_[j] = room;
    }
    places_.clear();
    places_.leave_room(beside_.data());
    places_.add(0.0, middle_.data(), still_.data());
    places_.begin_about(0, reach_.data());
}

void Tubes::boxes(std::size_t pieces, double* out) {
    for (std::size_t k = 0; k < count_; ++k) {
        stand_amid(k, k + 1);
        for (std::size_t piece = 0; piece < pieces; ++piece) {
            double box[6], *all = out + 6 * piece;
            places_.box_about(piece, box);
            for (std::size_t i = 0; i < 3; ++i) {
                all[i] = k == 0 ? box[i] : std::min(all[i], box[i]);
                all[3 + i] = k == 0 ? box[3 + i] : std::max(all[3 + i], box[3 + i]);
            }
        }
    }
}

// Pairs that are not far enough apart in the middle of some edges.
std::vector<int> Tubes::left(std::size_t first, std::size_t last, std::vector<int> pairs) {
    stand_amid(first, last);
    std::vector<int> open;
    for (std::size_t k = 0; k < pairs.size(); ++k) {  // those of bundles are added at the end
        const Pair pair = model_.pair(pairs[k]);
        if (places_.spheres_clear(pair, enough_)) continue;
        asked_ += 1.0;
        const double motion = places_.motion_about(pair);
        const Facing facing = places_.facing(pair, 0);
        Bound bound{};
        bound.gap = variant_.glance(facing);
        if (!(bound.gap - motion > enough_)) variant_.rough(model_.terms, facing, nullptr, 0, bound);
        if (bound.gap - motion > enough_) continue;
        if (pair.leaf() || model_.solid(pair.second).radius < motion) {
            open.push_back(pairs[k]);
            continue;
        }
        for (int child = 0; child < pair.children; ++child) pairs.push_back(pair.child + child);
    }
    return open;
}

bool Tubes::edge(std::size_t k, const std::vector<int>& pairs) {
    const auto judged = judge_line(model_, variant_, starts_ + n_ * k, ends_ + n_ * k, enough_, nearer_, room_ + n_ * k, pairs);
    asked_ += judged.asked;
    found_ = judged.result;
    if (!judged.taken) return false;
    if (found_.verdict != Verdict::undecided || !judged.whole) return found_.verdict == Verdict::free;
    for (const Lost& lost : judged.lost)
        if (!apart_by_parts(k, lost)) {
            found_ = {Verdict::undecided, lost.pair, lost.s};
            return false;
        }
    found_ = EdgeResult{};
    return true;
}

// A lower bound of the gap of a pair at q.
double Tubes::gap_at(const double* q, const Pair& pair) {
    places_.clear();
    places_.leave_room(nullptr);
    places_.add(0.0, q, still_.data());
    Bound bound{};
    asked_ += 1.0;
    variant_.refined(model_.terms, places_.facing(pair, 0), static_cast<int>(model_.terms.rounds), bound);
    return bound.gap;
}

// Whether a pair is not far enough apart at some corner of its room about q, towards which its gap shrinks, joint by joint.
bool Tubes::corner_near(std::vector<double> q, const double* room, const Pair& pair) {
    if (!(gap_at(q.data(), pair) > enough_)) return true;
    for (std::size_t j = 0; j < n_; ++j) {
        if (room[j] == 0.0) continue;
        const double at = q[j];
        q[j] = at + room[j];
        const double above = gap_at(q.data(), pair);
        q[j] = at - room[j];
        const double below = gap_at(q.data(), pair);
        if (!(std::min(above, below) > enough_)) return true;
        if (above < below) q[j] = at + room[j];
    }
    return false;
}

bool Tubes::apart_by_parts(std::size_t k, const Lost& lost) {
    const Pair pair = model_.pair(lost.pair);
    if (!pair.leaf() || parts_ <= 0) return false;
    const double *start = starts_ + n_ * k, *end = ends_ + n_ * k, *room = room_ + n_ * k;
    Part whole{{start, start + n_}, {end, end + n_}, {room, room + n_}, std::vector<double>(n_)};
    double square = 0.0;
    for (std::size_t j = 0; j < n_; ++j) square += (end[j] - start[j]) * (end[j] - start[j]);
    const double share = square > 0.0 ? lost.s / std::sqrt(square) : 0.0;
    std::vector<double> q(n_);
    for (std::size_t j = 0; j < n_; ++j) q[j] = start[j] + share * (end[j] - start[j]);
    std::vector<double> alone(n_, 0.0);
    if (corner_near(q, room, pair)) return false;
    places_.clear();
    places_.add(0.0, q.data(), still_.data());
    for (std::size_t j = 0; j < n_; ++j) {
        alone[j] = room[j];
        places_.leave_room(alone.data());
        whole.moves[j] = places_.room_motion(pair, 0);
        alone[j] = 0.0;
    }
    places_.leave_room(nullptr);
    for (const Body& body : model_.bodies)  // no edge leaves what limits of slides say of distances from axes
        if (body.column >= 0 && body.slides) whole.moves[static_cast<std::size_t>(body.column)] = 0.0;
    std::vector<Part> open{std::move(whole)};
    for (int left = each_; !open.empty();) {
        if (parts_ <= 0 || left <= 0) return false;
        Part part = std::move(open.back());
        open.pop_back();
        const auto j = static_cast<std::size_t>(std::max_element(part.moves.begin(), part.moves.end()) - part.moves.begin());
        if (!(part.moves[j] > 0.0)) return false;
        const double half = 0.5 * part.room[j];
        part.room[j] = half;
        part.moves[j] *= 0.5;
        for (const double side : {-half, half}) {
            Part beside = part;
            beside.start[j] += side;
            beside.end[j] += side;
            const auto judged = judge_line(model_, variant_, beside.start.data(), beside.end.data(), enough_, nearer_,
                                           beside.room.data(), {lost.pair}, lost.bound);
            asked_ += judged.asked;
            const int cost = 1 + static_cast<int>(judged.asked / kBoundsOfPart);
            parts_ -= cost, left -= cost;
            if (!judged.taken || !judged.whole || judged.result.verdict == Verdict::colliding) return false;
            if (judged.result.verdict == Verdict::undecided) open.push_back(std::move(beside));
        }
    }
    return true;
}

}  // namespace proof
