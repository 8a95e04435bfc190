// The smallest gap of any pair at a configuration. A pair's gap is at least its best bound, and at least that of the bundle it
// is in. The smallest of these does not depend on the order in which pairs are looked at, nor on which are left out because a
// cheaper bound of theirs is no smaller.
#pragma once

#include <vector>

#include "places.hpp"

namespace proof {

class Clearance {
  public:
    Clearance(const Model& model, const Variant& variant);

    // A lower bound at q; infinite if there is no pair.
    double at(const double* q, const std::vector<int>& roots);

    // Adds six numbers for each of the pairs nearer than ``within`` at q: ``row``, the pair, its signed gap, and its
    // direction.
    void near(const double* q, double row, std::vector<int> pairs, double within, std::vector<double>& out);

  private:
    struct Ask {
        int pair;
        double known;  // no gap of it is smaller
    };

    const Model& model_;
    const Variant& variant_;
    Places places_;
    std::vector<double> still_;
    std::vector<Ask> asks_;
    double best_ = 0.0;

    void look(const Ask& ask);
};

}  // namespace proof
