// The space that is searched: how configurations are drawn, how far apart they are, and a step from one towards another.
// What differs for joints that go round, follow others or keep to a constraint belongs here.
#pragma once

#include <cmath>
#include <cstddef>
#include <utility>

#include "../constraints/projector.hpp"
#include "generator.hpp"
#include "oracle.hpp"

namespace search {

class Space {
  public:
    // ``weights``: of the squared difference of each joint in a squared distance. ``projector``: what keeps constraints,
    // if there are any; it stays where it is as long as this exists.
    Space(Configuration lower, Configuration upper, Configuration weights, constraints::Projector* projector = nullptr)
        : lower_(std::move(lower)), upper_(std::move(upper)), weights_(std::move(weights)), projector_(projector) {}

    std::size_t dof() const { return lower_.size(); }
    const Configuration& weights() const { return weights_; }
    // What keeps constraints; null without any.
    constraints::Projector* projector() const { return projector_; }

    // The longest distance between two configurations.
    double extent() const { return std::sqrt(squared_distance(lower_.data(), upper_.data())); }

    void draw(Generator& generator, Configuration& q) const {
        for (std::size_t k = 0; k < dof(); ++k) q[k] = lower_[k] + (upper_[k] - lower_[k]) * generator.uniform();
    }

    // Summed in joint order, without fused operations: equal bits on every processor.
    double squared_distance(const double* a, const double* b) const {
        double total = 0.0;
        for (std::size_t k = 0; k < dof(); ++k) total += weights_[k] * ((b[k] - a[k]) * (b[k] - a[k]));
        return total;
    }

    // The configuration ``range`` from a towards b, which is ``distance`` away; b itself if that is no farther.
    void step(const Configuration& a, const Configuration& b, double distance, double range, Configuration& out) const {
        if (distance <= range) {
            out = b;
            return;
        }
        const double share = range / distance;
        for (std::size_t k = 0; k < dof(); ++k) out[k] = a[k] + (b[k] - a[k]) * share;
    }

  private:
    Configuration lower_, upper_, weights_;
    constraints::Projector* projector_;
};

}  // namespace search
