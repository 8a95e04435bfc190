// The space that is searched: how configurations are drawn, how far apart they are, and a step from one towards another.
// What differs for joints that go round, follow others or keep to a constraint belongs here.
#pragma once

#include <algorithm>
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

    // Draws from the ellipsoid of all that is on a way from a to b no longer than ``longest``, within the bounds (Gammell et
    // al., IROS 2014). Only its shape is exact: a direction has a sum of uniform numbers in each joint, which every machine
    // rounds alike.
    void draw_between(Generator& generator, const Configuration& a, const Configuration& b, double longest, Configuration& q) const {
        const double between = length(a.data(), b.data());
        const double along = 0.5 * longest, across = 0.5 * std::sqrt(std::max(0.0, longest * longest - between * between));
        double square = 0.0, radius = 0.0, share = 0.0;
        for (double& x : q) {
            x = -6.0;
            for (int k = 0; k < 12; ++k) x += generator.uniform();
            square += x * x;
            radius = std::max(radius, generator.uniform());  // the largest of n is distributed as a radius in an n-ball
        }
        const double scale = square > 0.0 ? radius / std::sqrt(square) : 0.0;
        for (std::size_t k = 0; k < dof() && between > 0.0; ++k) share += q[k] * ((b[k] - a[k]) / between);
        for (std::size_t k = 0; k < dof(); ++k) {
            const double axis = between > 0.0 ? (b[k] - a[k]) / between : 0.0;
            const double x = 0.5 * (a[k] + b[k]) + scale * (across * q[k] + (along - across) * (share * axis));
            q[k] = std::min(std::max(x, lower_[k]), upper_[k]);
        }
    }

    // The length of the straight way between two configurations.
    double length(const double* a, const double* b) const {
        double total = 0.0;
        for (std::size_t k = 0; k < dof(); ++k) total += (b[k] - a[k]) * (b[k] - a[k]);
        return std::sqrt(total);
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
