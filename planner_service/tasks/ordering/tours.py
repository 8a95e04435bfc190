"""Orders of jobs with alternatives, by their costs alone: the best branches of an order, and good orders.

A job is entered at one of some entries and left at one of some exits; job 0 is where the arm starts and ends. The best
branches of a given order are the shortest path through a layered graph (RoboTSP, arXiv 1709.09343, finds them so,
too). Good orders are found by 2-opt and Or-opt, and by taking some jobs out and putting each back where it costs
least (large neighbourhood search, as in GLNS: Smith & Imeson, Computers & OR 87, 2017).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["IMPOSSIBLE", "Costs", "Tour", "best_branches", "improved", "tour_of"]

IMPOSSIBLE = 1e6
"""Seconds that an impossible leg counts: no possible order is as long, and sums of it lose no digits that matter."""

FEW = 7
"""Jobs of which all orders are compared."""

LONGEST_PIECE = 3
"""Jobs that Or-opt moves at once."""

CANDIDATES = 24
"""Moves that are tried, best first, until one keeps the precedences."""

SLACK = 1e-9
"""Seconds by which a move must shorten an order to count."""

NEARLY = 1.05
"""An order whose jobs were put back is looked at closely if it is at most this many times as long as the present
one."""


@dataclass(frozen=True, eq=False)
class Costs:
    """What jobs cost, in seconds; entries and exits of all jobs are numbered through, those of job 0 first.

    Attributes:
        entries: Where each job's entries begin, and how many there are in all, (jobs + 1,).
        exits: The same of its exits.
        legs: From each exit to each entry, (exits, entries).
        inner: From each entry of a job to each of its exits, an array for each job.
        before: Whether job i must come before job j, closed under transitivity, (jobs, jobs).
    """

    entries: IntArray
    exits: IntArray
    legs: FloatArray
    inner: tuple[FloatArray, ...]
    before: BoolArray

    @property
    def jobs(self) -> int:
        """How many there are, job 0 among them."""
        return len(self.inner)

    def with_legs(self, legs: FloatArray, inner: Sequence[FloatArray]) -> Costs:
        """The same jobs at other costs."""
        return replace(self, legs=legs, inner=tuple(inner))

    def between(self, i: int, j: int) -> FloatArray:
        """From each exit of job i to each entry of job j."""
        return self.legs[self.exits[i] : self.exits[i + 1], self.entries[j] : self.entries[j + 1]]

    def allows(self, order: IntArray) -> bool:
        """Whether an order of jobs keeps the precedences."""
        return not bool(np.tril(self.before[np.ix_(order, order)]).any())


@dataclass(frozen=True, eq=False)
class Tour:
    """An order of all jobs but job 0, the entry and the exit of each, and what it costs."""

    order: IntArray
    entries: IntArray
    exits: IntArray
    cost: float


def best_branches(costs: Costs, order: Sequence[int] | IntArray) -> Tour:
    """The entries and exits with which an order costs least."""
    reached = np.zeros(1)
    back: list[tuple[IntArray, IntArray]] = []
    last = 0
    for job in [*order, 0]:
        arriving = reached[:, None] + costs.between(last, job)
        by_exit = arriving.argmin(axis=0)
        at_entry = arriving[by_exit, np.arange(arriving.shape[1])]
        through = at_entry[:, None] + costs.inner[job]
        by_entry = through.argmin(axis=0)
        reached = through[by_entry, np.arange(through.shape[1])]
        back.append((by_exit, by_entry))
        last = int(job)
    entries, exits = np.zeros(len(order), dtype=np.intp), np.zeros(len(order), dtype=np.intp)
    leaving = int(back[-1][0][0])
    for place in reversed(range(len(order))):
        by_exit, by_entry = back[place]
        exits[place], entries[place] = leaving, by_entry[leaving]
        leaving = int(by_exit[entries[place]])
    jobs = np.asarray(order, dtype=np.intp)
    return Tour(jobs, costs.entries[jobs] + entries, costs.exits[jobs] + exits, float(reached[0]))


def tour_of(costs: Costs, jobs: IntArray, entries: IntArray, exits: IntArray) -> Tour:
    """A tour with given entries and exits (numbered through)."""
    leaving, arriving = np.append(0, exits), np.append(entries, 0)
    inner = sum(
        float(costs.inner[job][a - costs.entries[job], b - costs.exits[job]])
        for job, a, b in zip(jobs.tolist(), entries.tolist(), exits.tolist(), strict=True)
    )
    return Tour(jobs, entries, exits, float(costs.legs[leaving, arriving].sum()) + inner)


def nearest_first(costs: Costs) -> Tour:
    """Each time the cheapest job that may come next: an order to begin with."""
    left = set(range(1, costs.jobs))
    order: list[int] = []
    reached = np.zeros(1)
    last = 0
    while left:
        ready = [job for job in sorted(left) if not any(costs.before[other, job] for other in left)]
        steps = [(reached[:, None] + costs.between(last, job)).min(axis=0)[:, None] + costs.inner[job] for job in ready]
        best = int(np.argmin([step.min() for step in steps]))
        last, reached = ready[best], steps[best].min(axis=0)
        left.remove(last)
        order.append(last)
    return best_branches(costs, order)


def improved(costs: Costs, rng: np.random.Generator, rounds: int, begin: Tour | None = None) -> Tour:
    """A good tour, the best of up to 7 jobs: local search, then ``rounds`` of taking jobs out and putting them back.

    Args:
        begin: Where to begin; its order is kept if nothing better is found.
    """
    if costs.jobs <= FEW + 1:
        return _best_of_all(costs)
    start = nearest_first(costs) if begin is None else best_branches(costs, begin.order)
    best = present = _polished(costs, start)
    near = _neighbours(costs)
    for spent in range(rounds):
        moved = _put_back(costs, present, _taken_out(present, near, rng), rng)
        if moved.cost > NEARLY * present.cost:
            continue
        moved = best_branches(costs, moved.order)
        heat = 0.01 * (1.0 - spent / rounds) * present.cost / costs.jobs
        if moved.cost < present.cost - SLACK:
            moved = _polished(costs, moved)
        if moved.cost < present.cost + heat * rng.exponential():
            present = moved
        if present.cost < best.cost - SLACK:
            best = present
    return best


def _best_of_all(costs: Costs) -> Tour:
    """The best tour, over all sets of jobs that may have been done so far (Held & Karp, J. SIAM 10(1), 1962)."""
    many = costs.jobs - 1
    first = [sum(1 << (k - 1) for k in np.flatnonzero(costs.before[:, job]).tolist()) for job in range(costs.jobs)]
    of_exit = np.repeat(np.arange(costs.jobs), np.diff(costs.exits))
    least = np.full((1 << many, len(of_exit)), np.inf)  # by what has been done, and the exit that the arm is at
    back = np.zeros(least.shape, dtype=np.intp)
    least[0, 0] = 0.0
    for done in range(1 << many):
        at_entry = least[done][:, None] + costs.legs
        by_exit = at_entry.argmin(axis=0)
        arriving = at_entry[by_exit, np.arange(len(by_exit))]
        for job in range(1, costs.jobs):
            if done >> (job - 1) & 1 or first[job] & ~done:
                continue
            entries = slice(costs.entries[job], costs.entries[job + 1])
            through = arriving[entries, None] + costs.inner[job]
            exits = slice(costs.exits[job], costs.exits[job + 1])
            least[done | 1 << (job - 1), exits] = through.min(axis=0)
            back[done | 1 << (job - 1), exits] = by_exit[entries][through.argmin(axis=0)]
    done, order = (1 << many) - 1, list[int]()
    at = int((least[done] + costs.legs[:, 0]).argmin())
    while done:
        order.append(int(of_exit[at]))
        at, done = int(back[done, at]), done & ~(1 << (order[-1] - 1))
    return best_branches(costs, order[::-1])


def _polished(costs: Costs, tour: Tour) -> Tour:
    """A tour that neither 2-opt, nor Or-opt, nor another choice of branches shortens."""
    while True:
        order = tour.order
        shorter = _moved(costs, tour)
        after = best_branches(costs, shorter)
        if after.cost >= tour.cost - SLACK:
            return tour if after.cost >= tour.cost else after
        tour = after
        if np.array_equal(order, shorter):
            return tour


def _moved(costs: Costs, tour: Tour) -> IntArray:
    """The order after the best moves of 2-opt and Or-opt, branches kept, until there is none."""
    ring: IntArray = np.arange(len(tour.order) + 1)
    jobs = np.append(0, tour.order)
    exits, entries = np.append(0, tour.exits), np.append(0, tour.entries)
    cost = costs.legs[np.ix_(exits, entries)]
    bound = bool(costs.before.any())
    while True:
        for gain, new in _moves(cost[np.ix_(ring, ring)]):
            if gain > -SLACK:
                return np.asarray(jobs[ring][1:])
            order = ring[new]
            if not bound or costs.allows(jobs[order][1:]):
                ring = order
                break
        else:
            return np.asarray(jobs[ring][1:])


def _moves(cost: FloatArray) -> Iterator[tuple[float, IntArray]]:
    """The best few moves on the tour 0, 1, ..., m - 1, 0 with costs from each place to each: the change, and the new
    order."""
    m = len(cost)
    if m < 3:
        return
    wide = np.pad(cost, ((0, 1), (0, 1)), mode="wrap")  # place m is place 0
    steps = wide[np.arange(m), np.arange(1, m + 1)]
    forward = np.append(0.0, np.cumsum(steps[1:]))  # from place 1 to place k is forward[k - 1]
    backward = np.append(0.0, np.cumsum(wide[np.arange(2, m + 1), np.arange(1, m)]))
    i, j = np.triu_indices(m, 1)
    i, j = i[i > 0], j[i > 0]
    turned = backward[j - 1] - backward[i - 1] - forward[j - 1] + forward[i - 1]
    changes = wide[i - 1, j] + wide[i, j + 1] - steps[i - 1] - steps[j] + turned
    kinds: list[tuple[FloatArray, IntArray, IntArray, IntArray]] = [(changes, i, j, np.full(len(i), -1))]
    for length in range(1, min(LONGEST_PIECE, m - 2) + 1):
        first = np.repeat(np.arange(1, m - length + 1), m)
        after = np.tile(np.arange(m), m - length)
        outside = np.flatnonzero((after < first - 1) | (after > first + length - 1))
        first, after = first[outside], after[outside]
        last = first + length - 1
        gap = wide[first - 1, last + 1] - steps[first - 1] - steps[last]
        moved = gap + wide[after, first] + wide[last, after + 1] - steps[after]
        kinds.append((moved, first, last, after))
    change, one, two, three = (np.concatenate(column) for column in zip(*kinds, strict=True))
    few = min(CANDIDATES, len(change))
    best = np.argpartition(change, few - 1)[:few]
    for k in best[np.lexsort((best, change[best]))].tolist():
        yield float(change[k]), _reordered(m, int(one[k]), int(two[k]), int(three[k]))


def _reordered(m: int, first: int, last: int, after: int) -> IntArray:
    """Places 0 to m - 1 with those from first to last turned round, or moved behind ``after`` if that is not
    negative."""
    places = np.arange(m)
    if after < 0:
        return np.concatenate((places[:first], places[first : last + 1][::-1], places[last + 1 :]))
    piece, rest = places[first : last + 1], np.delete(places, slice(first, last + 1))
    at = int(np.searchsorted(rest, after)) + 1
    return np.concatenate((rest[:at], piece, rest[at:]))


def _neighbours(costs: Costs) -> IntArray:
    """Of each job all jobs but 0, those first that are cheap to come from or to go to."""
    least = np.minimum.reduceat(np.minimum.reduceat(costs.legs, costs.exits[:-1], axis=0), costs.entries[:-1], axis=1)
    return np.argsort(np.minimum(least, least.T)[1:, 1:], axis=1, kind="stable") + 1


def _taken_out(tour: Tour, near: IntArray, rng: np.random.Generator) -> list[int]:
    """Some jobs, in the order in which they are put back: neighbours of one, or a piece of the tour."""
    many = len(tour.order)
    count = int(rng.integers(1, min(many, max(4, min(24, many // 3))) + 1))
    if rng.random() < 0.6:
        job = int(tour.order[rng.integers(many)])
        some = near[job - 1][: 2 * count].tolist()
        taken = [job, *(some[k] for k in rng.permutation(len(some)) if some[k] != job)][:count]
    else:
        first = int(rng.integers(many))
        taken = [int(tour.order[(first + k) % many]) for k in range(count)]
    return [taken[k] for k in rng.permutation(len(taken))]


def _put_back(costs: Costs, tour: Tour, taken: Sequence[int], rng: np.random.Generator) -> Tour:
    """The tour with some jobs taken out and put back one by one, each where and how it costs least."""
    keep = ~np.isin(tour.order, taken)
    jobs, entries, exits = tour.order[keep].tolist(), tour.entries[keep].tolist(), tour.exits[keep].tolist()
    bound = bool(costs.before.any())
    for job in taken:
        leaving, arriving = np.array([0, *exits]), np.array([*entries, 0])
        first, last = costs.entries[job], costs.exits[job]
        in_, out = (
            costs.legs[leaving, first : costs.entries[job + 1]],
            costs.legs[last : costs.exits[job + 1], arriving],
        )
        way = in_[:, :, None] + costs.inner[job][None]
        change = (way.min(axis=1) + out.T) - costs.legs[leaving, arriving][:, None]
        if bound:
            low = 1 + max((k for k, other in enumerate(jobs) if costs.before[other, job]), default=-1)
            high = min((k for k, other in enumerate(jobs) if costs.before[job, other]), default=len(jobs))
            change[:low], change[high + 1 :] = np.inf, np.inf
        place, exit_ = divmod(int((change * (1.0 + 0.02 * rng.random(change.shape))).argmin()), change.shape[1])
        jobs.insert(place, job)
        entries.insert(place, int(first + way[place, :, exit_].argmin()))
        exits.insert(place, int(last + exit_))
    return tour_of(costs, np.array(jobs), np.array(entries), np.array(exits))
