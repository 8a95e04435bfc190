// An oracle of the user's own, behind functions.
#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include "oracle.hpp"

namespace search {

class AskedOracle final : public Oracle {
  public:
    struct Answers {
        std::function<bool(const Configuration& q)> state;
        std::function<bool(const Configuration& a, const Configuration& b, int known)> edge, coarse;  // coarse: may be none
        std::function<std::pair<double, int>()> last;  // of the collision found last: where on its edge, and its number
        std::function<void()> poll;
    };

    explicit AskedOracle(Answers answers) : answers_(std::move(answers)) {}

    bool edge_is_free(const Configuration& a, const Configuration& b, int known) override { return answers_.edge(a, b, known); }
    bool edge_is_free_coarse(const Configuration& a, const Configuration& b, int known) override {
        return glances() ? answers_.coarse(a, b, known) : answers_.edge(a, b, known);
    }
    bool glances() const override { return static_cast<bool>(answers_.coarse); }
    bool state_is_free(const Configuration& q) override { return answers_.state(q); }
    bool states_are_free(const double* Q, int rows) override {
        const auto n = static_cast<std::ptrdiff_t>(dof_);
        for (int row = 0; row < rows; ++row)
            if (!answers_.state(Configuration(Q + row * n, Q + (row + 1) * n))) return false;
        return true;
    }
    // Asked before the samples of a blend are: these are STEP apart.
    int segments(const Configuration& differences) override {
        constexpr double STEP = 0.01;
        dof_ = differences.size();
        double squares = 0.0;
        for (const double difference : differences) squares += difference * difference;
        return std::max(1, static_cast<int>(std::ceil(std::sqrt(squares) / STEP)));
    }
    double last_fraction() const override { return answers_.last().first; }
    int last_pair() const override { return answers_.last().second; }
    void poll() override { answers_.poll(); }

  private:
    Answers answers_;
    std::size_t dof_ = 0;
};

}  // namespace search
