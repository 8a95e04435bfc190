#include "samples.hpp"

#include <algorithm>
#include <cmath>

namespace collision {

namespace {

constexpr int MANY = 16;   // rows from which on a look at windows of them pays
constexpr int KEPT = 512;  // segments up to which orders of samples are kept: at most 1 MB a thread

// The interior samples of an edge, in bisection order; and their places in it as they follow each other on the edge.
struct Order {
    std::vector<int> samples, along;
};

Order order_of(int segments, int count) {
    Order out{bisection_order(segments, count), {}};
    std::vector<int> places(static_cast<std::size_t>(segments), -1);
    for (std::size_t i = 0; i < out.samples.size(); ++i) places[static_cast<std::size_t>(out.samples[i])] = static_cast<int>(i);
    out.along.reserve(out.samples.size());
    for (const int place : places)
        if (place >= 0) out.along.push_back(place);
    return out;
}

// What a thread works in, kept from one question to the next: to allocate it takes as long as some checks.
struct Scratch {
    Workspace workspace;
    Candidates candidates, near;
    std::vector<Candidate> among;
    std::vector<double> side_by_side, q, by;
    std::vector<int> rows, samples;
    std::vector<Order> orders = std::vector<Order>(KEPT + 1);
    Order long_order;

    // The first ``count`` samples at least.
    const Order& order(int segments, int count) {
        if (segments > KEPT) return long_order = order_of(segments, count);
        Order& known = orders[static_cast<std::size_t>(segments)];
        if (known.samples.empty()) known = order_of(segments, segments - 1);
        return known;
    }
};

Scratch& scratch() {
    static thread_local Scratch own;
    return own;
}

// The first row so far that is not free; rows after it need no check.
class Earliest {
  public:
    explicit Earliest(int stop) : row_(stop), stop_(stop) {}

    int row() const { return row_; }
    bool found() const { return row_ < stop_; }

    void note(int row, bool certain, const std::vector<int>& pairs) {
        if (row >= row_) return;
        row_ = row;
        certain_ = certain;
        pairs_ = pairs;
    }

    RowCheck check(double fraction, std::vector<double> q) {
        const Status status = certain_ && pairs_.size() == 1 ? Status::colliding : Status::undecided;
        return RowCheck{status, row_, fraction, std::move(q), std::move(pairs_)};
    }

  private:
    int row_, stop_;
    bool certain_ = false;
    std::vector<int> pairs_;
};

// Puts configurations side by side and hands them to a variant, LANES at a time.
class Block {
  public:
    Block(const Model& model, const Variant& variant)
        : model_(model), variant_(variant), workspace_(scratch().workspace.of(variant.bytes(model))),
          q_(scratch().side_by_side), candidates_(scratch().candidates) {
        q_.resize(static_cast<std::size_t>(LANES * model.dof));
    }

    bool full() const { return count_ == LANES; }
    bool empty() const { return count_ == 0; }
    int row(int lane) const { return rows_[lane]; }

    void put(int row, const double* q) {
        for (int k = 0; k < model_.dof; ++k) q_[static_cast<std::size_t>(LANES * k + count_)] = q[k];
        rows_[count_++] = row;
    }

    // Empties the block, whose rows were put in their order; pairs that are not ``among`` these are known to be apart.
    void check(Earliest& earliest, const std::vector<Candidate>* among = nullptr) {
        if (empty()) return;
        const unsigned lanes = take_lanes();
        const auto [lane, certain] = variant_.find_first(model_, q_.data(), lanes, among, workspace_, candidates_);
        if (lane >= 0) earliest.note(rows_[lane], certain, candidates_.doubted);
    }

    // Empties the block: all pairs that are not proven apart, also where joints move ``by`` so much.
    void find(Candidates& found, const double* by = nullptr) {
        const unsigned lanes = take_lanes();
        variant_.find(model_, q_.data(), lanes, by, workspace_, found);
    }

  private:
    const Model& model_;
    const Variant& variant_;
    void* workspace_;
    std::vector<double>& q_;
    Candidates& candidates_;
    int rows_[LANES] = {};
    int count_ = 0;

    unsigned take_lanes() {
        const unsigned lanes = (1U << count_) - 1U;
        for (int lane = count_; lane < LANES; ++lane)  // so that the boxes swept over all lanes are no larger
            for (int k = 0; k < model_.dof; ++k) {
                const auto first = static_cast<std::size_t>(LANES * k);
                q_[first + static_cast<std::size_t>(lane)] = q_[first];
            }
        count_ = 0;
        return lanes;
    }
};

}  // namespace

bool within_limits(const Settings& settings, const std::vector<double>& q) {
    for (std::size_t k = 0; k < q.size(); ++k)
        if (!(settings.lower[k] <= q[k] && q[k] <= settings.upper[k])) return false;
    return true;
}

int segments_of(const Settings& settings, const std::vector<double>& a, const std::vector<double>& b) {
    constexpr double slack = 1e-9;
    double motion = 0.0, squares = 0.0;
    for (std::size_t k = 0; k < a.size(); ++k) {
        const double difference = b[k] - a[k];
        motion += settings.reach[k] * std::fabs(difference);
        squares += difference * difference;
    }
    int most = 1;
    const auto split = [&most](double extent, double step) {  // whether that makes no more than MAX_SEGMENTS
        const double parts = extent / step - slack;
        if (!(parts <= MAX_SEGMENTS)) return false;
        most = std::max(most, static_cast<int>(std::ceil(parts)));
        return true;
    };
    for (const double step : settings.motion_steps)
        if (!split(motion, step)) return 0;
    for (const double step : settings.joint_steps)
        if (!split(std::sqrt(squares), step)) return 0;
    return most;
}

int coarse_samples(int segments, int coarse) {
    int parts = 1;
    while (parts * coarse < segments) parts *= 2;
    return std::min(parts, segments) - 1;
}

std::vector<int> bisection_order(int segments, int count) {
    std::vector<int> order;
    std::vector<std::pair<int, int>> spans{{0, segments}};
    order.reserve(static_cast<std::size_t>(std::max(count, 0)));
    spans.reserve(static_cast<std::size_t>(2 * std::max(count, 0) + 1));
    for (std::size_t next = 0; next < spans.size() && static_cast<int>(order.size()) < count; ++next) {
        const auto [low, high] = spans[next];
        const int middle = low + (high - low) / 2;
        if (middle <= low) continue;
        order.push_back(middle);
        spans.emplace_back(low, middle);
        spans.emplace_back(middle, high);
    }
    return order;
}

Edge::Edge(std::vector<double> a, std::vector<double> b, bool check_a, bool check_b, int segments)
    : a_(std::move(a)), b_(std::move(b)), forward_(a_ <= b_), ends_((check_a ? 1 : 0) + (check_b ? 1 : 0)),
      first_end_is_a_(check_a), segments_(segments) {}

double Edge::fraction(int row, int k) const {
    if (row < ends_) return row == 0 && first_end_is_a_ ? 0.0 : 1.0;
    const double along = static_cast<double>(k) / static_cast<double>(segments_);
    return forward_ ? along : 1.0 - along;
}

bool Edge::within(const std::vector<double>& travel) const {
    for (std::size_t k = 0; k < travel.size(); ++k)
        if (!(std::fabs(a_[k]) <= travel[k] && std::fabs(b_[k]) <= travel[k])) return false;
    return !travel.empty();
}

void Edge::motion(double share, double* by) const {
    for (std::size_t k = 0; k < a_.size(); ++k) by[k] = std::fabs(b_[k] - a_[k]) * share;
}

void Edge::at(double along, double* q) const {
    const auto &first = forward_ ? a_ : b_, &last = forward_ ? b_ : a_;
    for (std::size_t i = 0; i < first.size(); ++i) q[i] = first[i] + (last[i] - first[i]) * along;
}

void Edge::sample(int row, int k, double* q) const {
    if (row < ends_) {
        const auto& end = row == 0 && first_end_is_a_ ? a_ : b_;
        std::copy(end.begin(), end.end(), q);
        return;
    }
    at(static_cast<double>(k) / static_cast<double>(segments_), q);
}

std::vector<std::pair<int, int>> candidates(const Model& model, const Variant& variant, const double* Q, int m) {
    std::vector<std::pair<int, int>> out;
    Block block(model, variant);
    Candidates& found = scratch().candidates;
    for (int row = 0; row < m; ++row) {
        block.put(row, Q + static_cast<std::ptrdiff_t>(row) * model.dof);
        if (!block.full() && row < m - 1) continue;
        block.find(found);
        for (const auto& entry : found.entries)
            for (int lane = 0; lane < LANES; ++lane)
                if ((entry.lanes >> lane & 1U) != 0U) out.emplace_back(block.row(lane), entry.pair);
    }
    std::sort(out.begin(), out.end());
    return out;
}

RowCheck check_rows(const Model& model, const Variant& variant, const double* Q, int start, int stop) {
    Block block(model, variant);
    Earliest earliest(stop);
    for (int row = start; row < stop && !earliest.found(); ++row) {
        block.put(row, Q + static_cast<std::ptrdiff_t>(row) * model.dof);
        if (block.full() || row == stop - 1) block.check(earliest);
    }
    if (!earliest.found()) return {};
    const double* q = Q + static_cast<std::ptrdiff_t>(earliest.row()) * model.dof;
    return earliest.check(0.0, std::vector<double>(q, q + model.dof));
}

// Finds the pairs that may come near each other in windows of LANES samples that follow each other: a window is looked at
// in its middle, for pairs that are not apart by more than what they move to each other from there to its ends.
void look_at_windows(Block& block, const Edge& edge, const std::vector<int>& samples, Candidates& near) {
    auto &q = scratch().q, &by = scratch().by;
    const auto last = samples.size() - 1;
    int widest = 0;
    for (std::size_t first = 0; first <= last; first += LANES) {
        const int low = samples[first], high = samples[std::min(first + LANES - 1, last)];
        widest = std::max(widest, high - low);
        edge.at(0.5 * (low + high) / edge.segments(), q.data());
        block.put(static_cast<int>(first / LANES), q.data());
    }
    by.resize(q.size());
    edge.motion(0.5 * widest / edge.segments(), by.data());
    block.find(near, by.data());
}

RowCheck check_rows(const Model& model, const Variant& variant, const Edge& edge, int start, int stop) {
    const Order* order = &scratch().order(edge.segments(), std::min(stop, start + 2 * LANES) - edge.ends());
    const auto sample = [&](int row) {
        return row < edge.ends() ? 0 : order->samples[static_cast<std::size_t>(row - edge.ends())];
    };
    Block block(model, variant);
    Earliest earliest(stop);
    auto& q = scratch().q;
    q.resize(static_cast<std::size_t>(model.dof));
    const auto put = [&](int row) {
        edge.sample(row, sample(row), q.data());
        block.put(row, q.data());
    };
    const auto told = [&]() -> RowCheck {
        if (!earliest.found()) return {};
        const int row = earliest.row(), k = sample(row);
        edge.sample(row, k, q.data());
        return earliest.check(edge.fraction(row, k), q);
    };
    int early = start;  // rows checked before the others: an edge that collides mostly does so early
    do {  // one block, and a second if that is the last
        for (const int end = std::min(early + LANES, stop); early < end; ++early) put(early);
        block.check(earliest);
    } while (!earliest.found() && early < stop && stop - early <= LANES);
    if (earliest.found() || early == stop) return told();
    order = &scratch().order(edge.segments(), stop - edge.ends());

    // The others as they follow each other on the edge, not in their order.
    auto &rows = scratch().rows, &samples = scratch().samples;
    auto& among = scratch().among;
    Candidates& near = scratch().near;
    const bool bounded = !model.crowded() && edge.within(model.travel);
    const auto check = [&] {
        const bool windows = bounded && static_cast<int>(rows.size()) > MANY;
        if (windows) look_at_windows(block, edge, samples, near);
        for (std::size_t first = 0; first < rows.size(); first += LANES) {
            if (windows) {
                among.clear();
                for (const auto& c : near.entries)
                    if ((c.lanes >> (first / LANES) & 1U) != 0U) among.push_back(c);
                if (among.empty()) continue;
            }
            const auto begin = rows.begin() + static_cast<std::ptrdiff_t>(first);
            const auto end = rows.begin() + static_cast<std::ptrdiff_t>(std::min(first + LANES, rows.size()));
            std::sort(begin, end);
            for (auto row = begin; row != end && *row < earliest.row(); ++row) put(*row);
            block.check(earliest, windows ? &among : nullptr);
        }
        rows.clear();
        samples.clear();
    };
    rows.clear();
    samples.clear();
    for (const int place : order->along) {
        const int row = edge.ends() + place;
        if (row < early || row >= earliest.row()) continue;
        rows.push_back(row);
        samples.push_back(sample(row));
        if (rows.size() == LANES * LANES) check();
    }
    check();
    return told();
}

}  // namespace collision
