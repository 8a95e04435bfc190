// The collision kernel as searching and smoothing use it: free edges are remembered, everything is counted, limits hold.
//
// Its Python side is ``SearchOracle`` of search/problem.py.
#pragma once

#include <array>
#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <unordered_map>

#include "../collision/samples.hpp"
#include "oracle.hpp"

namespace search {

// No more state may be judged, or an edge cannot be judged: the oracle says which.
struct Ended : std::runtime_error {
    using std::runtime_error::runtime_error;
};

// What was judged since the last time; which pairs collided how often, by their numbers.
struct Tally {
    long states = 0, edges = 0;
    std::map<int, long> hits;
};

// What one call may still judge and has judged, and what came of its last question.
struct Account {
    Tally tally;
    long room = -1;  // states; below 0 any number
    std::chrono::steady_clock::time_point next_poll;
    bool spent = false;
    std::optional<std::pair<Configuration, Configuration>> refused;
    double last_fraction = 0.0;  // of the collision found last
    int last_pair = -1;
};

// The motions tried at starts or goals.
struct Motions {
    long free = 0, colliding = 0;
};

class EdgeOracle final : public Oracle {
  public:
    // The first pair that touches at q, given those in doubt there; -1 if none does.
    using Decide = std::function<int(const Configuration& q, const std::vector<int>& pairs)>;
    // Throws if the call is over its time or cancelled.
    using Poll = std::function<void()>;
    // Equal parts of an edge with these joint differences, by a rule of the user's own.
    using Split = std::function<int(const Configuration& differences)>;

    // The model and the settings stay where they are as long as this exists.
    EdgeOracle(const collision::Model& model, const collision::Variant& variant, const collision::Settings& settings,
               const std::vector<Configuration>& starts, const std::vector<Configuration>& goals, Decide decide, Poll poll,
               Split split);

    bool edge_is_free(const Configuration& a, const Configuration& b, int known) override;
    bool edge_is_free_coarse(const Configuration& a, const Configuration& b, int known) override;
    bool states_are_free(const double* Q, int rows) override;
    bool state_is_free(const Configuration& q) override;  // q must be within the joint limits
    int segments(const Configuration& differences) override;
    void poll() override;

    // How many states may be judged from now on, below 0 any number; ``poll_first`` before the first of them.
    void allow(long room, bool poll_first);
    // What was judged since the last time this was asked.
    Tally take();
    // From now on what is judged here is judged for another's call.
    void share(const EdgeOracle& other) { account_ = other.account_; }

    // If the last question ended by ``Ended``: whether no more state might be judged, and the edge that leaves the joint
    // limits or would have too many samples.
    bool spent() const { return account_->spent; }
    const std::optional<std::pair<Configuration, Configuration>>& refused() const { return account_->refused; }

    double last_fraction() const override { return account_->last_fraction; }
    int last_pair() const override { return account_->last_pair; }
    const Motions& starts_tried() const { return tried_[0]; }
    const Motions& goals_tried() const { return tried_[1]; }

  private:
    struct Hash {
        std::size_t operator()(const Configuration& q) const;
    };
    using JudgedEdges = std::unordered_map<Configuration, bool, Hash>;

    int parts(const Configuration& a, const Configuration& b) const;
    collision::Edge sampled(const Configuration& a, const Configuration& b, int known);
    template <class Rows>
    bool rows_are_free(const Rows& rows, int start, int stop);
    void note(const Configuration& a, const Configuration& b, bool free);
    int coarse_stop(const collision::Edge& edge) const;

    const collision::Model& model_;
    const collision::Variant& variant_;
    const collision::Settings& settings_;
    Decide decide_;
    Poll poll_;
    Split split_;  // none if the settings say how
    std::array<std::vector<Configuration>, 2> ends_;  // starts, goals
    std::array<Motions, 2> tried_;
    JudgedEdges edges_;  // those not found to collide, both ends in one; whether all of their samples were judged
    std::shared_ptr<Account> account_ = std::make_shared<Account>();
};

}  // namespace search
