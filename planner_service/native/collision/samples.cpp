#include "samples.hpp"

#include <algorithm>
#include <cmath>

namespace collision {

namespace {

constexpr int FIRST = LANES;  // rows checked before the others: an edge that collides mostly does so early

// Puts configurations side by side and hands them to a variant, LANES at a time.
class Block {
  public:
    Block(const Model& model, const Variant& variant, bool every)
        : model_(model), variant_(variant), every_(every), memory_(variant.bytes(model)),
          q_(static_cast<std::size_t>(LANES * model.dof)) {}

    bool full() const { return count_ == LANES; }
    bool empty() const { return count_ == 0; }
    int row(int lane) const { return rows_[lane]; }

    void put(int row, const double* q) {
        for (int k = 0; k < model_.dof; ++k) q_[static_cast<std::size_t>(LANES * k + count_)] = q[k];
        rows_[count_++] = row;
    }

    // Calls ``each(row, pair, deep)`` for what is in doubt.
    template <class Each>
    void check(Each each) {
        const unsigned lanes = (1U << count_) - 1U;
        for (int lane = count_; lane < LANES; ++lane)  // so that the boxes swept over all lanes are no larger
            for (int k = 0; k < model_.dof; ++k) {
                const auto first = static_cast<std::size_t>(LANES * k);
                q_[first + static_cast<std::size_t>(lane)] = q_[first];
            }
        candidates_.entries.clear();
        variant_.check(model_, q_.data(), lanes, every_, memory_.data(), candidates_);
        for (const auto& entry : candidates_.entries)
            for (int lane = 0; lane < count_; ++lane)
                if ((entry.lanes >> lane & 1U) != 0U) each(rows_[lane], entry.pair, (entry.deep >> lane & 1U) != 0U);
        count_ = 0;
    }

  private:
    const Model& model_;
    const Variant& variant_;
    bool every_;
    Workspace memory_;
    std::vector<double> q_;
    int rows_[LANES] = {};
    int count_ = 0;
    Candidates candidates_;
};

// The first row so far that is not free, and its pairs; rows after it need no check.
class Earliest {
  public:
    explicit Earliest(int stop) : row_(stop), stop_(stop) {}

    int row() const { return row_; }
    bool found() const { return row_ < stop_; }

    void note(int row, int pair, bool deep) {
        if (row > row_) return;
        if (row < row_) pairs_.clear();
        row_ = row;
        pairs_.emplace_back(pair, deep);
    }

    RowCheck check(double fraction, std::vector<double> q) {
        std::sort(pairs_.begin(), pairs_.end());
        std::vector<int> numbers;
        for (const auto& [pair, deep] : pairs_) numbers.push_back(pair);
        const Status status = pairs_.front().second ? Status::colliding : Status::undecided;
        return RowCheck{status, row_, fraction, std::move(q), std::move(numbers)};
    }

  private:
    int row_, stop_;
    std::vector<std::pair<int, bool>> pairs_;
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

void Edge::sample(int row, int k, double* q) const {
    if (row < ends_) {
        const auto& end = row == 0 && first_end_is_a_ ? a_ : b_;
        std::copy(end.begin(), end.end(), q);
        return;
    }
    const auto &first = forward_ ? a_ : b_, &last = forward_ ? b_ : a_;
    const double along = static_cast<double>(k) / static_cast<double>(segments_);
    for (std::size_t i = 0; i < first.size(); ++i) q[i] = first[i] + (last[i] - first[i]) * along;
}

std::vector<std::pair<int, int>> candidates(const Model& model, const Variant& variant, const double* Q, int m) {
    std::vector<std::pair<int, int>> out;
    Block block(model, variant, true);
    const auto note = [&out](int row, int pair, bool) { out.emplace_back(row, pair); };
    for (int row = 0; row < m; ++row) {
        block.put(row, Q + static_cast<std::ptrdiff_t>(row) * model.dof);
        if (block.full() || row == m - 1) block.check(note);
    }
    std::sort(out.begin(), out.end());
    return out;
}

RowCheck check_rows(const Model& model, const Variant& variant, const double* Q, int start, int stop) {
    Block block(model, variant, false);
    Earliest earliest(stop);
    const auto note = [&earliest](int row, int pair, bool deep) { earliest.note(row, pair, deep); };
    for (int row = start; row < stop && !earliest.found(); ++row) {
        block.put(row, Q + static_cast<std::ptrdiff_t>(row) * model.dof);
        if (block.full() || row == stop - 1) block.check(note);
    }
    if (!earliest.found()) return {};
    const double* q = Q + static_cast<std::ptrdiff_t>(earliest.row()) * model.dof;
    return earliest.check(0.0, std::vector<double>(q, q + model.dof));
}

RowCheck check_rows(const Model& model, const Variant& variant, const Edge& edge, int start, int stop) {
    const auto order = bisection_order(edge.segments(), stop - edge.ends());
    const auto place = [&](int row) {
        return row < edge.ends() ? 0 : order[static_cast<std::size_t>(row - edge.ends())];
    };
    Block block(model, variant, false);
    Earliest earliest(stop);
    const auto note = [&earliest](int row, int pair, bool deep) { earliest.note(row, pair, deep); };
    std::vector<double> q(static_cast<std::size_t>(model.dof));
    const auto put = [&](int row) {
        edge.sample(row, place(row), q.data());
        block.put(row, q.data());
    };
    const int early = std::min(start + FIRST, stop);
    for (int row = start; row < early; ++row) put(row);
    if (!block.empty()) block.check(note);
    if (!earliest.found() && early < stop) {  // the others as they follow each other on the edge, not in their order
        std::vector<std::pair<int, int>> along;
        along.reserve(static_cast<std::size_t>(stop - early));
        for (int row = early; row < stop; ++row) along.emplace_back(place(row), row);
        std::sort(along.begin(), along.end());
        for (const auto& [k, row] : along) {
            if (row <= earliest.row()) put(row);
            if (block.full()) block.check(note);
        }
        if (!block.empty()) block.check(note);
    }
    if (!earliest.found()) return {};
    const int row = earliest.row(), k = place(row);
    edge.sample(row, k, q.data());
    return earliest.check(edge.fraction(row, k), q);
}

}  // namespace collision
