// The search of a roadmap's query: Query._shortest of roadmap/query.py, step by step.
#include "roadmap.hpp"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <limits>
#include <optional>
#include <queue>
#include <tuple>
#include <unordered_map>
#include <utility>

#include "../arrays.hpp"
#include "places.hpp"

namespace nb = nanobind;

namespace roadmap {

namespace {

using arrays::Numbers;
using Lengths = arrays::Row;
using Verdicts = arrays::Array<std::uint8_t, 1>;
using arrays::require;
using Step = std::tuple<std::int64_t, std::int64_t, std::int64_t>;  // from, to, piece

constexpr double greed = 3.0, unknown_as = 2.0;
constexpr std::uint8_t free_verdict = 1, blocked_verdict = 2;
constexpr std::int64_t nodes_per_poll = 256;

// The neighbours of each node, one node after the other.
class Neighbours {
  public:
    Neighbours(const Numbers& starts, const Numbers& other, const Lengths& lengths, const Numbers& pieces)
        : starts_(starts), other_(other), lengths_(lengths), pieces_(pieces) {
        const std::size_t nodes = starts.shape(0), rows = other.shape(0);
        require(nodes >= 1 && lengths.shape(0) == rows && pieces.shape(0) == rows, "a length and a piece for each neighbour");
        require(starts.data()[0] == 0 && starts.data()[nodes - 1] == static_cast<std::int64_t>(rows), "rows of all nodes");
        for (std::size_t k = 1; k < nodes; ++k) require(starts.data()[k - 1] <= starts.data()[k], "rows in order");
        for (std::size_t k = 0; k < rows; ++k) {
            most_ = std::max(most_, other.data()[k]);
            most_piece_ = std::max(most_piece_, pieces.data()[k]);
            require(other.data()[k] >= 0 && pieces.data()[k] >= 0, "no such node or piece");
        }
    }

    template <typename Visit>
    void each(std::int64_t node, Visit visit) const {
        if (node + 1 >= static_cast<std::int64_t>(starts_.shape(0))) return;
        for (auto k = starts_.data()[node]; k < starts_.data()[node + 1]; ++k)
            visit(other_.data()[k], lengths_.data()[k], pieces_.data()[k]);
    }

    bool within(std::size_t nodes, std::size_t pieces) const {
        return most_ < static_cast<std::int64_t>(nodes) && most_piece_ < static_cast<std::int64_t>(pieces);
    }

  private:
    Numbers starts_, other_;
    Lengths lengths_;
    Numbers pieces_;
    std::int64_t most_ = -1, most_piece_ = -1;
};

using Row = std::tuple<std::int64_t, double, std::int64_t>;  // other, length, piece

// Further neighbours of some nodes, from a dictionary of sequences.
class Added {
  public:
    explicit Added(const nb::dict& given) {
        for (const auto item : given) {
            auto rows = nb::cast<std::vector<Row>>(item.second);
            for (const auto& [other, length, piece] : rows) {
                require(other >= 0 && piece >= 0, "no such node or piece");
                most_ = std::max(most_, other);
                most_piece_ = std::max(most_piece_, piece);
            }
            rows_.emplace(nb::cast<std::int64_t>(item.first), std::move(rows));
        }
    }

    template <typename Visit>
    void each(std::int64_t node, Visit visit) const {
        const auto found = rows_.find(node);
        if (found == rows_.end()) return;
        for (const auto& [other, length, piece] : found->second) visit(other, length, piece);
    }

    bool within(std::size_t nodes, std::size_t pieces) const {
        return most_ < static_cast<std::int64_t>(nodes) && most_piece_ < static_cast<std::int64_t>(pieces);
    }

  private:
    std::unordered_map<std::int64_t, std::vector<Row>> rows_;
    std::int64_t most_ = -1, most_piece_ = -1;
};

// The path, if there is one, and how many nodes may still be expanded.
std::pair<std::optional<std::vector<Step>>, std::int64_t> shortest(
    const Neighbours& trunk, const Added& added, const nb::dict& joins, const Lengths& bound, const Verdicts& nodes,
    const Verdicts& pieces, std::int64_t start, std::int64_t last_end, std::int64_t effort, const nb::callable& poll) {
    const std::size_t count = nodes.shape(0);
    const Added joined(joins);
    require(bound.shape(0) == count && trunk.within(count, pieces.shape(0)) && added.within(count, pieces.shape(0)) &&
                joined.within(count, pieces.shape(0)),
            "a bound and a verdict for each node");
    require(0 <= start && start <= last_end && last_end < static_cast<std::int64_t>(count), "no such start or goal");
    struct Reached {
        double cost;
        std::int64_t from, piece;
    };
    std::unordered_map<std::int64_t, Reached> reached{{start, {0.0, start, -1}}};
    reached.reserve(1024);
    using Entry = std::tuple<double, std::int64_t, double>;  // least length of a path over it, node, its cost
    std::priority_queue<Entry, std::vector<Entry>, std::greater<>> front;
    front.emplace(greed * bound.data()[start], start, 0.0);
    double best = std::numeric_limits<double>::infinity();
    while (!front.empty()) {
        const auto [unused, node, spent] = front.top();
        front.pop();
        if (spent > reached.at(node).cost) continue;  // a shorter path to this node was found since
        if (start < node && node <= last_end) {
            std::vector<Step> steps;
            for (auto at = node; reached.at(at).piece >= 0; at = reached.at(at).from)
                steps.emplace_back(reached.at(at).from, at, reached.at(at).piece);
            std::reverse(steps.begin(), steps.end());
            return {std::move(steps), effort};
        }
        if (--effort <= 0) return {std::nullopt, effort};
        if (effort % nodes_per_poll == 0) poll();
        const auto from = node;
        const auto cost = spent;
        const auto visit = [&](std::int64_t other, double length, std::int64_t piece) {
            const auto verdict = pieces.data()[piece];
            const double total = cost + (verdict == free_verdict ? length : unknown_as * length);
            const auto known = reached.find(other);
            if (known != reached.end() && known->second.cost <= total) return;
            const double ahead = bound.data()[other];
            if (total + ahead >= best || verdict == blocked_verdict || nodes.data()[other] == blocked_verdict) return;
            if (start < other && other <= last_end) best = total;
            reached[other] = {total, from, piece};
            front.emplace(total + greed * ahead, other, total);
        };
        trunk.each(node, visit);
        added.each(node, visit);
        joined.each(node, visit);
    }
    return {std::nullopt, effort};
}

}  // namespace

void bind(nb::module_& m) {
    nb::class_<Neighbours>(m, "Neighbours").def(nb::init<const Numbers&, const Numbers&, const Lengths&, const Numbers&>());
    nb::class_<Added>(m, "AddedNeighbours").def(nb::init<const nb::dict&>());
    m.def("shortest", &shortest);
    bind_places(m);
}

}  // namespace roadmap
