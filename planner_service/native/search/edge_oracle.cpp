#include "edge_oracle.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

namespace search {

namespace {

constexpr int ROWS_AT_ONCE = 4096;  // between two polls: a user may cancel within 50 ms
constexpr std::chrono::milliseconds POLL_EVERY{20};

// Both ends of an edge in one, whatever its direction.
Configuration key_of(const Configuration& a, const Configuration& b) {
    const bool forward = a <= b;
    Configuration key(forward ? a : b);
    const Configuration& last = forward ? b : a;
    key.insert(key.end(), last.begin(), last.end());
    return key;
}

}  // namespace

std::size_t EdgeOracle::Hash::operator()(const Configuration& q) const {
    std::uint64_t hash = 0x9e3779b97f4a7c15ULL;
    for (const double value : q) {
        const double same = value + 0.0;  // -0.0 is 0.0
        std::uint64_t bits = 0;
        std::memcpy(&bits, &same, sizeof bits);
        hash = (hash ^ bits) * 0xff51afd7ed558ccdULL;
        hash ^= hash >> 32;
    }
    return static_cast<std::size_t>(hash);
}

EdgeOracle::EdgeOracle(const collision::Model& model, const collision::Variant& variant,
                       const collision::Settings& settings, const std::vector<Configuration>& starts,
                       const std::vector<Configuration>& goals, Decide decide, Poll poll,
                       Split split)
    : model_(model), variant_(variant), settings_(settings), decide_(std::move(decide)), poll_(std::move(poll)),
      split_(std::move(split)), ends_{starts, goals} {
}

void EdgeOracle::allow(long room, bool poll_first) {
    account_->room = room;
    account_->spent = false;
    account_->refused.reset();
    account_->next_poll = std::chrono::steady_clock::now();
    if (!poll_first) account_->next_poll += POLL_EVERY;
}

Tally EdgeOracle::take() { return std::exchange(account_->tally, Tally{}); }

void EdgeOracle::poll() {
    if (std::chrono::steady_clock::now() < account_->next_poll) return;
    poll_();
    account_->next_poll = std::chrono::steady_clock::now() + POLL_EVERY;
}

// Equal parts of an edge; 0 if there would be too many.
int EdgeOracle::parts(const Configuration& a, const Configuration& b) const {
    if (!split_) return collision::segments_of(settings_, a, b);
    Configuration differences(a.size());
    for (std::size_t k = 0; k < a.size(); ++k) differences[k] = b[k] - a[k];
    return split_(differences);
}

collision::Edge EdgeOracle::sampled(const Configuration& a, const Configuration& b, int known) {
    const bool inside = collision::within_limits(settings_, a) && collision::within_limits(settings_, b);
    const int segments = inside ? parts(a, b) : 0;
    if (segments == 0) {
        account_->refused.emplace(a, b);
        throw Ended("an edge that cannot be judged");
    }
    return collision::Edge(a, b, (known & START) == 0, (known & END) == 0 && a != b, segments);
}

int EdgeOracle::coarse_stop(const collision::Edge& edge) const {
    return edge.ends() + collision::coarse_samples(edge.segments(), settings_.coarse_segments);
}

// Rows [start, stop) of what ``check(start, stop)`` checks, counted one by one up to the first that collides.
template <class Rows>
bool EdgeOracle::rows_are_free(const Rows& check, int start, int stop) {
    Account& account = *account_;
    for (int row = start; row < stop;) {
        poll();
        if (account.room == 0) {
            account.spent = true;
            throw Ended("the check budget is spent");
        }
        int end = std::min(stop, row + ROWS_AT_ONCE);
        if (account.room > 0 && account.room < end - row) end = row + static_cast<int>(account.room);
        const collision::RowCheck found = check(row, end);
        int pair = -1;
        if (found.status == collision::Status::colliding) pair = found.pairs.front();
        if (found.status == collision::Status::undecided) pair = decide_(found.q, found.pairs);
        const int next = found.status == collision::Status::free ? end : found.row + 1;
        account.tally.states += next - row;
        if (account.room > 0) account.room -= next - row;
        row = next;
        if (pair >= 0) {
            ++account.tally.hits[pair];
            account.last_pair = pair;
            account.last_fraction = found.fraction;
            return false;
        }
    }
    return true;
}

bool EdgeOracle::edge_is_free(const Configuration& a, const Configuration& b, int known) {
    const auto key = key_of(a, b);
    const auto judged = edges_.find(key);
    if (judged != edges_.end() && judged->second) return true;
    const bool looked = judged != edges_.end();
    if (looked) edges_.erase(judged);
    const auto edge = sampled(a, b, looked ? static_cast<int>(BOTH) : known);
    if (!looked) ++account_->tally.edges;
    const auto check = [&](int start, int stop) { return collision::check_rows(model_, variant_, edge, start, stop); };
    const bool free = rows_are_free(check, looked ? coarse_stop(edge) : 0, edge.rows());
    if (!looked) note(a, b, free);
    if (free) edges_[key] = true;
    return free;
}

bool EdgeOracle::edge_is_free_coarse(const Configuration& a, const Configuration& b, int known) {
    auto key = key_of(a, b);
    if (edges_.find(key) != edges_.end()) return true;
    const auto edge = sampled(a, b, known);
    ++account_->tally.edges;
    const auto check = [&](int start, int stop) { return collision::check_rows(model_, variant_, edge, start, stop); };
    const bool free = rows_are_free(check, 0, coarse_stop(edge));
    if (free) edges_.emplace(std::move(key), false);
    note(a, b, free);
    return free;
}

bool EdgeOracle::states_are_free(const double* Q, int rows) {
    const auto check = [&](int start, int stop) { return collision::check_rows(model_, variant_, Q, start, stop); };
    return rows_are_free(check, 0, rows);
}

bool EdgeOracle::state_is_free(const Configuration& q) {
    if (!collision::within_limits(settings_, q)) {
        account_->refused.emplace(q, q);
        throw Ended("a state that cannot be judged");
    }
    return states_are_free(q.data(), 1);
}

int EdgeOracle::segments(const Configuration& differences) {
    const Configuration nowhere(differences.size(), 0.0);
    const int count = parts(nowhere, differences);
    if (count == 0) {
        account_->refused.emplace(nowhere, differences);
        throw Ended("a motion of too many samples");
    }
    return count;
}

// Counts a motion if it starts or ends at a start or goal.
void EdgeOracle::note(const Configuration& a, const Configuration& b, bool free) {
    for (std::size_t k = 0; k < 2; ++k) {
        const auto is_end = [&](const Configuration& q) { return q == a || q == b; };
        if (std::any_of(ends_[k].begin(), ends_[k].end(), is_end)) ++(free ? tried_[k].free : tried_[k].colliding);
    }
}

}  // namespace search
