// The bisection of a whole curve; interval_proof.py says how it goes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "curve.hpp"
#include "places.hpp"

namespace proof {

// Told how many bounds are asked next; may throw.
class Charge {
  public:
    virtual ~Charge() = default;
    virtual void bounds(std::int64_t count) = 0;
};

struct Span {
    double start, end;
};

struct Root {
    int pair;
    std::size_t span;
};

enum class End { proven, close, spent, pointlike };

struct Outcome {
    std::int64_t asked = 0, most = 0;
    double proven = 0.0;
    End end = End::proven;
    int pair = -1;
    Span span{};
    double s = 0.0, gap = 0.0;
};

// A pair proven on a stretch: from where to where in s, and directions at both ends, from the second piece towards the
// first in the second's axes; zero where none was needed.
struct Leaf {
    int pair;
    double numbers[8];
};

class Tree {
  public:
    // What is proven is added to ``trail``, if one is given: by plain bounds, the joints travelling as ``walked`` says.
    Tree(const Model& model, const Variant& variant, const Curve& curve, double enough, Charge& charge,
         const Curve* walked = nullptr, std::vector<Leaf>* trail = nullptr);

    // Prove the roots; run it once.
    Outcome run(const std::vector<Span>& spans, std::vector<Root> roots);

  private:
    struct Stretch {
        std::size_t left, right;
    };
    struct Row {  // a pair not proven yet on a stretch, and what is known at both ends
        int pair;
        std::size_t stretch;
        double motion;
        Bound before, after;
    };
    struct Ask {
        int pair;
        std::size_t node;
    };
    struct Judged {
        std::vector<Bound> ends;
        std::vector<bool> enough;  // bounds that close what is open: no better one is wanted
        std::ptrdiff_t bad = -1;   // a row that is not far enough apart
    };
    struct Part {  // a span halved so often, and which of these parts
        std::size_t span, level, index;
    };

    const Model& model_;
    const Variant& variant_;
    const Curve& curve_;
    const Terms& terms_;
    double enough_;
    Charge& charge_;
    const Curve* walked_;
    std::vector<Leaf>* trail_;
    Places places_;
    Outcome out_;
    double smallest_;
    std::vector<Span> spans_;
    std::vector<std::size_t> nodes_;  // of all parts of all spans
    std::vector<Stretch> stretches_;
    std::vector<Row> rows_;
    std::vector<double> q_, travel_, unused_;
    std::vector<double> strays_;          // of each stretch and joint
    std::vector<std::int8_t> evenness_;   // of each stretch whether it strays in a known way; -1: not asked yet

    Pair pair_of(int number) const { return model_.pair(number); }
    double size_of(const Pair& pair) const { return model_.solid(pair.second).radius; }
    double close() const;
    void note(int pair, double start, double end, const double* before, const double* after);
    std::size_t place(double s);
    bool begin(const std::vector<Root>& roots);
    bool ends(std::vector<Row>& rows, std::size_t first, int hints, double close);
    bool sift(int pair, const Part& part);
    void sift_crowd(const Pair& crowd, const std::vector<int>& pairs, const Part& part);
    struct Look {  // at the middle of a part
        Bound found;
        double before, after, wanted;
        bool apart() const { return found.gap - before >= wanted && found.gap - after >= wanted; }  // both: for what is no number
    };
    Look look(const Pair& pair, const Part& part);
    void leave(int pair, const Part& part);
    std::size_t number_of(const Part& part) const;
    const Stretch& stretch_of(const Part& part);
    double spare() const;
    bool shut(const Bound& one, const Bound& two, double motion) const;
    bool split(const std::vector<bool>& splitting);
    bool halve();
    bool stuck();
    bool obstructed(int pair, const Bound& found, Span span, double s);
    template <class Closes>
    Judged judge(const std::vector<Ask>& asks, const std::vector<double>& hints, int each, double close,
                 const Closes& closes);
    void refine(const Facing& facing, int rounds, Bound& bound) const;
    std::ptrdiff_t tighten(const std::vector<Ask>& asks, std::size_t first, std::size_t last, double close,
                           std::vector<Facing>& facings, Judged& found);
    double bent(const Row& row, double wanted);
    void keep();
    void forget();
};

}  // namespace proof
