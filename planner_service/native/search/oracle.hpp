// What searching and smoothing ask: whether states and edges are free. Every answer is counted, and any may end the call by
// an exception: a limit is reached, or Python raised one.
#pragma once

#include <vector>

namespace search {

using Configuration = std::vector<double>;

// Which ends of an edge are known to be free, as ``Known`` in edge_sampling.py.
enum Known { NEITHER = 0, START = 1, END = 2, BOTH = 3 };

class Oracle {
  public:
    virtual ~Oracle() = default;

    virtual bool edge_is_free(const Configuration& a, const Configuration& b, int known) = 0;

    // False if the edge collides; if true, ``edge_is_free`` has the last word, and checks only what is left.
    virtual bool edge_is_free_coarse(const Configuration& a, const Configuration& b, int known) = 0;

    // Whether a coarse look at an edge is another one than the last word.
    virtual bool glances() const { return true; }

    virtual bool state_is_free(const Configuration& q) = 0;

    // Whether all of ``rows`` configurations, one after the other, are free; counted up to the first that is not.
    virtual bool states_are_free(const double* Q, int rows) = 0;

    // The collision found last: where on its edge, and the number of its pair.
    virtual double last_fraction() const = 0;
    virtual int last_pair() const = 0;

    // Equal parts, at least one, into which an edge with these joint differences is split; counts nothing.
    virtual int segments(const Configuration& differences) = 0;

    // Ends the call by an exception if its time is up; asks no more often than every few milliseconds.
    virtual void poll() {}

    // Whether there are constraints, and whether a configuration keeps them with a little room; counts nothing.
    virtual bool constrained() const { return false; }
    virtual bool is_kept(const double* /*q*/) { return true; }
};

}  // namespace search
