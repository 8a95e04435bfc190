// An oracle that also refuses edges that leave the constraints.
#pragma once

#include "../constraints/projector.hpp"
#include "oracle.hpp"

namespace search {

class ConstrainedOracle final : public Oracle {
  public:
    ConstrainedOracle(Oracle& oracle, constraints::Projector& projector) : oracle_(oracle), projector_(projector) {}

    constraints::Projector& projector() { return projector_; }

    bool edge_is_free(const Configuration& a, const Configuration& b, int known) override {
        return projector_.keeps(a, b) && oracle_.edge_is_free(a, b, known);
    }
    bool edge_is_free_coarse(const Configuration& a, const Configuration& b, int known) override {
        return projector_.keeps(a, b) && oracle_.edge_is_free_coarse(a, b, known);
    }
    bool glances() const override { return oracle_.glances(); }
    bool state_is_free(const Configuration& q) override { return oracle_.state_is_free(q); }
    bool states_are_free(const double* Q, int rows) override { return oracle_.states_are_free(Q, rows); }
    int segments(const Configuration& differences) override { return oracle_.segments(differences); }
    double last_fraction() const override { return oracle_.last_fraction(); }
    int last_pair() const override { return oracle_.last_pair(); }
    void poll() override { oracle_.poll(); }

    bool constrained() const override { return true; }
    bool is_kept(const double* q) override { return projector_.has_room(q); }

  private:
    Oracle& oracle_;
    constraints::Projector& projector_;
};

}  // namespace search
