// A tree of balls around the points is asked, not each point: few corners of a hull are near any one of its faces.
#include "farthest.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "../arrays.hpp"

namespace geometry {

namespace {

using Point = std::array<double, 3>;

// Points of a ball that is not split further.
constexpr std::size_t few = 8;

// In this order, and not contracted: the bits of arrays.along.
double along(const double* direction, const Point& p) { return direction[0] * p[0] + direction[1] * p[1] + direction[2] * p[2]; }

// Points begin to end of the sorted ones are within radius of the centre. Its halves are the next ball and ``second``; 0: it has none.
struct Ball {
    std::size_t begin, end;
    Point centre;
    double radius;
    std::size_t second;
};

class Tree {
  public:
    explicit Tree(const arrays::Rows& rows) : points_(rows.shape(0)) {
        for (std::size_t i = 0; i < points_.size(); ++i) {
            const double* row = rows.data() + 3 * i;
            points_[i] = {row[0], row[1], row[2]};
            for (int k = 0; k < 3; ++k) largest_ = std::max(largest_, std::abs(row[k]));
        }
        split(0, points_.size());
    }

    // The largest component along a unit vector u, or ``best`` if that is larger. A point of a ball around c of radius r has at most
    // u . c + r. Both that bound and a component are off by a few roundings of the largest coordinate: a ball is passed over only
    // if it stays short by more than 64 of these.
    double farthest(const double* direction, double best) const {
        const double slack = 64.0 * std::numeric_limits<double>::epsilon() * largest_;
        std::vector<std::size_t> open{0};
        while (!open.empty()) {
            const std::size_t i = open.back();
            const Ball& ball = balls_[i];
            open.pop_back();
            if (along(direction, ball.centre) + ball.radius < best - slack) continue;
            if (ball.second == 0) {
                for (std::size_t k = ball.begin; k < ball.end; ++k) best = std::max(best, along(direction, points_[k]));
            } else {
                open.push_back(ball.second);
                open.push_back(i + 1);
            }
        }
        return best;
    }

  private:
    void split(std::size_t begin, std::size_t end) {
        Point low = points_[begin], high = low;
        for (std::size_t i = begin; i < end; ++i)
            for (int k = 0; k < 3; ++k) low[k] = std::min(low[k], points_[i][k]), high[k] = std::max(high[k], points_[i][k]);
        Ball ball{begin, end, {}, 0.0, 0};
        for (int k = 0; k < 3; ++k) ball.centre[k] = 0.5 * (low[k] + high[k]);
        for (std::size_t i = begin; i < end; ++i) {
            double square = 0.0;
            for (int k = 0; k < 3; ++k) square += (points_[i][k] - ball.centre[k]) * (points_[i][k] - ball.centre[k]);
            ball.radius = std::max(ball.radius, std::sqrt(square));
        }
        const std::size_t place = balls_.size();
        balls_.push_back(ball);
        if (end - begin <= few) return;
        int axis = 0;
        for (int k = 1; k < 3; ++k)
            if (high[k] - low[k] > high[axis] - low[axis]) axis = k;
        const std::size_t middle = begin + (end - begin) / 2;
        const auto at = [this](std::size_t i) { return points_.begin() + static_cast<std::ptrdiff_t>(i); };
        std::nth_element(at(begin), at(middle), at(end), [axis](const Point& a, const Point& b) { return a[axis] < b[axis]; });
        split(begin, middle);
        balls_[place].second = balls_.size();
        split(middle, end);
    }

    std::vector<Point> points_;
    std::vector<Ball> balls_;
    double largest_ = 0.0;
};

nanobind::object farthest(const arrays::Rows& points, const arrays::Rows& directions, const arrays::Row& reached) {
    arrays::require(points.shape(0) > 0 && points.shape(1) == 3 && directions.shape(1) == 3, "points and directions in space");
    arrays::require(reached.shape(0) == directions.shape(0), "what each direction is known to reach");
    const Tree tree(points);
    std::vector<double> largest(reached.data(), reached.data() + reached.shape(0));
    for (std::size_t i = 0; i < largest.size(); ++i) largest[i] = tree.farthest(directions.data() + 3 * i, largest[i]);
    const std::size_t count = largest.size();
    return arrays::array_of<double>(std::move(largest), {count});
}

}  // namespace

void bind(nanobind::module_& m) { m.def("farthest", &farthest); }

}  // namespace geometry
