// Less padding near starts and goals that are closer to something than the padding of the rest.
#pragma once

#include <utility>

#include "edge_oracle.hpp"

namespace search {

class TieredOracle final : public Oracle {
  public:
    // ``roomy`` judges all edges but the first ``near_end`` of those from an end in ``tight``; what any of them judges is
    // judged for the same call.
    TieredOracle(EdgeOracle& roomy, std::vector<std::pair<Configuration, EdgeOracle*>> tight, double near_end);

    bool edge_is_free(const Configuration& a, const Configuration& b, int known) override;
    bool edge_is_free_coarse(const Configuration& a, const Configuration& b, int known) override;
    bool state_is_free(const Configuration& q) override;
    bool states_are_free(const double* Q, int rows) override { return roomy_.states_are_free(Q, rows); }
    int segments(const Configuration& differences) override { return roomy_.segments(differences); }
    double last_fraction() const override { return roomy_.last_fraction(); }
    int last_pair() const override { return roomy_.last_pair(); }
    void poll() override { roomy_.poll(); }

  private:
    EdgeOracle* tight_at(const Configuration& q) const;
    template <class Judge>
    bool parts_are_free(const Configuration& a, const Configuration& b, int known, const Judge& judge) const;

    EdgeOracle& roomy_;
    std::vector<std::pair<Configuration, EdgeOracle*>> tight_;
    double near_end_;
};

}  // namespace search
