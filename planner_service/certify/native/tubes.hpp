// Straight edges with room beside them: how many are free, the first ones first. Whatever is on several edges, or beside them, is
// within so much of one configuration in each joint; pairs that are far enough apart there for that are not looked at again, nor those
// that are far enough apart along the line that the edges roughly follow. What is left of edges is halved; a single one is judged by
// ``Edge``.
#pragma once

#include <vector>

#include "edge.hpp"

namespace proof {

class Tubes {
  public:
    // ``starts``, ``ends`` and ``room`` (the caller's): of so many edges, a row of numbers each. ``parts``: of rooms that are too much as
    // a whole, so many may be looked at, for all edges together, and ``each`` of one pair on one of them.
    Tubes(const Model& model, const Variant& variant, std::size_t count, const double* starts, const double* ends,
          const double* room, double enough, double nearer, int parts, int each);

    // How many edges are free before the first that is not.
    std::size_t run(const std::vector<int>& roots);
    // Boxes along the axes of the base frame that the first riding pieces do not leave anywhere on the edges or beside them, six
    // numbers each.
    void boxes(std::size_t pieces, double* out);
    // Of that one.
    const EdgeResult& found() const { return found_; }
    double asked() const { return asked_; }

  private:
    const Model& model_;
    const Variant& variant_;
    std::size_t n_, count_;
    const double *starts_, *ends_, *room_;
    double enough_, nearer_;
    int parts_, each_;
    EdgeResult found_;
    double asked_ = 0.0;
    Places places_;
    std::vector<double> middle_, reach_, beside_, still_;

    std::size_t free(std::size_t first, std::size_t last, const std::vector<int>& pairs);
    std::vector<int> left_as_one(std::size_t first, std::size_t last, std::vector<int> pairs);
    bool edge(std::size_t k, const std::vector<int>& pairs);
    std::vector<int> left(std::size_t first, std::size_t last, std::vector<int> pairs);
    // Whether a pair is apart on an edge and beside it, by parts of its room; ``s`` is where the whole of it was too much.
    bool apart_by_parts(std::size_t k, const Lost& lost);
    double gap_at(const double* q, const Pair& pair);
    bool corner_near(std::vector<double> q, const double* room, const Pair& pair);
    void stand_amid(std::size_t first, std::size_t last);
};

}  // namespace proof
