// An oracle that also refuses edges that leave the constraints: search/constrained.py is its reference.
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
    bool states_are_free(const double* Q, int rows) override { return oracle_.states_are_free(Q, rows); }
    int segments(const Configuration& differences) override { return oracle_.segments(differences); }
    void poll() override { oracle_.poll(); }

    bool constrained() const override { return true; }
    bool is_kept(const double* q) override { return projector_.has_room(q); }

  private:
    Oracle& oracle_;
    constraints::Projector& projector_;
};

}  // namespace search
