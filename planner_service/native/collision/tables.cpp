#include "tables.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>

namespace collision {

namespace {

constexpr double STEP = 0.01;            // metres that a joint moves any point of a pair from cell to cell
constexpr int MOST_CELLS = 128;          // a joint
constexpr std::size_t KEPT = 4'000'000;  // numbers in the keys of tables, 32 MB, from which on they are forgotten

// What a pair's table is made from: the entries of q that move one of its solids and not the other, and by how much per
// unit at most; and all numbers that its proofs depend on.
struct Moved {
    std::vector<int> joints;
    std::vector<double> reach, key;

    void add(const Model& model, const Rider& rider) {
        append(rider.rotation, 9);
        append(rider.position, 3);
        append(rider.solid.half, 3);
        append(&rider.solid.ball, 1);
        append(&rider.solid.disc, 1);
        if (rider.solid.hull < 0) return key.push_back(0.0);
        const Hull& hull = model.hulls[static_cast<std::size_t>(rider.solid.hull)];
        key.push_back(static_cast<double>(hull.padded));
        append(model.corners.data() + hull.start, 3 * hull.padded);
    }

    void add(const Joint& joint, double by, bool of_first) {
        const auto at = std::find(joints.begin(), joints.end(), joint.q_index);
        const auto known = static_cast<std::size_t>(at - joints.begin());
        if (known == joints.size()) {
            joints.push_back(joint.q_index);
            reach.push_back(0.0);
        }
        reach[known] += by;
        key.insert(key.end(), {of_first ? 1.0 : 2.0, double(joint.q_index), double(joint.motion == Motion::slide), joint.multiplier});
        append(joint.rotation, 9);
        append(joint.offset, 3);
        append(joint.axis, 3);
    }

    void append(const double* numbers, std::size_t count) { key.insert(key.end(), numbers, numbers + count); }
};

Moved moved(const Model& model, const OwnPair& own) {
    const auto first = static_cast<std::size_t>(own.first), second = static_cast<std::size_t>(own.second);
    const std::size_t n = model.joints.size();
    Moved out;
    out.key.push_back(model.margin);
    out.add(model, model.riders[first]);
    out.add(model, model.riders[second]);
    for (std::size_t k = 0; k < n; ++k) {
        const double a = model.reach[first * n + k], b = model.reach[second * n + k];
        if ((a > 0.0) != (b > 0.0)) out.add(model.joints[k], a + b, a > 0.0);
    }
    return out;
}

using Proofs = std::shared_ptr<std::vector<unsigned char>>;

// The proofs of all tables of this process by their keys.
Proofs proofs_of(const std::vector<double>& key, std::size_t cells) {
    static std::map<std::vector<double>, Proofs> known;
    static std::size_t numbers = 0;
    const auto found = known.find(key);
    if (found != known.end()) return found->second;
    numbers += key.size() + cells / sizeof(double);
    if (numbers > KEPT) {
        known.clear();
        numbers = key.size();
    }
    return known[key] = std::make_shared<std::vector<unsigned char>>(cells);
}

}  // namespace

void add_tables(Model& model, const std::vector<double>& lower, const std::vector<double>& upper) {
    model.tables.clear();
    for (OwnPair& own : model.own_pairs) {
        own.table = -1;
        const Rider &first = model.riders[static_cast<std::size_t>(own.first)],
                    &second = model.riders[static_cast<std::size_t>(own.second)];
        if (first.solid.hull < 0 && second.solid.hull < 0) continue;  // separating axes are as quick
        Moved pair = moved(model, own);
        if (pair.joints.size() > 2) continue;
        Table table;
        table.motion = MOTION_SLACK;
        for (std::size_t s = 0; s < 2; ++s) {  // where fewer joints move a pair, joint 0 stands in and has one cell
            const bool moves = s < pair.joints.size();
            table.joint[s] = moves ? pair.joints[s] : 0;
            const auto q = static_cast<std::size_t>(table.joint[s]);
            const double reach = moves ? pair.reach[s] : 0.0, range = upper[q] - lower[q];
            table.cells[s] = static_cast<int>(std::min(std::max(range * reach / STEP, 1.0), double{MOST_CELLS}));
            table.low[s] = lower[q];
            table.per[s] = table.cells[s] / std::max(range, 1e-9);
            table.motion += 0.5 / table.per[s] * reach;
            pair.key.insert(pair.key.end(), {lower[q], upper[q]});
        }
        table.proofs = proofs_of(pair.key, static_cast<std::size_t>(table.cells[0] * table.cells[1]));
        own.table = static_cast<int>(model.tables.size());
        model.tables.push_back(table);
    }
}

}  // namespace collision
