"""A lower bound on what any order of jobs costs: a linear program with cutting planes, whose prices are checked here.

For each leg from an exit b to an entry a let x[b, a] be 1 if an order has it, and for each job let z[a, b] be 1 if it
is entered at a and left at b. Every order fulfils

1. each job is passed once: the sum of its z is 1;
2. what arrives at an entry passes from there, and what has passed to an exit leaves there;
3. for every set S of entries and exits without those of job 0, and every job J: the legs and passes that lead out of
   S are at least as many as the passes of J that begin at its entries in S, since an order that is in S must get back
   to job 0 (generalised subtour elimination: Fischetti, Salazar & Toth, Operations Research 45(3), 1997).

HiGHS (through scipy) minimises the cost under 1 and 2, and those of 3 that its last answer broke: first for S that is
a job and one branch of another, which are all looked at, then by a least cut for each job. Two of its dual values are
enough to know a bound that does not depend on how well it solves: with any prices p of the equations 2 and any m >= 0
of the inequalities 3, let r be what costs are left of each leg and pass. Then no order costs less than the sum, over
all jobs, of the least r of a leg into it and the least r of a pass through it, as it has one of each. That sum is
computed here, over all legs, also those that the linear program was not told.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.tasks.ordering.tours import IMPOSSIBLE, Costs, Tour

__all__ = ["Relaxation"]

ROUNDING = 1e-12
"""Relative to the numbers that are summed: more than rounding takes from a bound."""

NEAREST = 12
"""Legs from each exit, and to each entry, that the linear program begins with."""

PRICED = 3000
"""Further legs that are added at once, where their prices say that they would help."""

BROKEN = 1e-4
"""By how much an inequality must be broken to be added."""

MOST_CUTS = 400
"""Inequalities that are added at once."""

SCALE = 1_000_000
"""Of flows: scipy's are integers."""


@dataclass(frozen=True, eq=False)
class Cut:
    """An inequality of kind 3: the entries and exits of S, as masks, and the job."""

    entries: BoolArray
    exits: BoolArray
    job: int


@dataclass
class Relaxation:
    """The linear program of some jobs, as far as it has been built; costs may change between calls, jobs may not.

    Attributes:
        columns: Which legs it has, (exits, entries).
        cuts: Inequalities of kind 3 that were tight when last looked at.
        used: How much of each leg the last solution has, (exits, entries).
        passed: How much of each pass, of one job after another.
        settled: Whether nothing more can be added: the bound rises no further while costs stay.
    """

    columns: BoolArray
    cuts: list[Cut] = field(default_factory=list)
    used: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    passed: FloatArray = field(default_factory=lambda: np.zeros(0))
    settled: bool = False

    @classmethod
    def of(cls, costs: Costs, tour: Tour) -> Relaxation:
        """With the legs that are cheap, and those of a tour."""
        priced = np.where(_own(costs), np.inf, costs.legs)
        columns = np.zeros(priced.shape, dtype=bool)
        few = min(NEAREST, *(size - 1 for size in priced.shape)) if min(priced.shape) > 1 else 0
        if few:
            np.put_along_axis(columns, np.argpartition(priced, few, axis=1)[:, :few], True, axis=1)
            np.put_along_axis(columns, np.argpartition(priced, few, axis=0)[:few], True, axis=0)
        columns[0], columns[:, 0] = True, True
        columns &= ~_own(costs)
        columns[np.append(0, tour.exits), np.append(tour.entries, 0)] = True
        return cls(columns)

    def raised(self, costs: Costs, rounds: int, enough: float = np.inf) -> float:
        """The best bound after some rounds of solving and adding legs and inequalities.

        Args:
            enough: A bound with which to stop.
        """
        best, passes, closed = -np.inf, _Passes.of(costs), _closed(costs)
        value = -np.inf
        for _ in range(rounds):
            solution = self._solve(costs, passes)
            if solution is None:
                break
            left = np.where(closed, np.inf, self._left(costs, solution))
            into = np.minimum.reduceat(left.min(axis=0), costs.entries[:-1])
            through = self._left_of_passes(passes, solution)
            parts = np.concatenate((into, np.minimum.reduceat(through, passes.begins)))
            size = np.abs(parts).sum() + np.abs(solution.prices).sum()
            best = max(best, float(parts.sum() - ROUNDING * size))
            if best >= enough:
                break
            if solution.value > value + BROKEN * abs(solution.value) / 100.0:
                self.cuts = [cut for cut, tight in zip(self.cuts, solution.tight, strict=True) if tight]
            value = max(value, solution.value)
            wanted = self._wanted(left)
            new = _broken(costs, passes, self.used, self.passed)
            self.cuts += new
            self.settled = not wanted and not new
            if self.settled:
                break
        return best

    def passes(self, costs: Costs) -> list[tuple[int, int, int, float]]:
        """How much of each pass the last solution has: the job, its entry, its exit, and the share."""
        passes = _Passes.of(costs)
        return list(
            zip(*(column.tolist() for column in (passes.job, passes.entry, passes.exit, self.passed)), strict=True)
        )

    def _solve(self, costs: Costs, passes: _Passes) -> _Solution | None:
        """The linear program as it is now; None if HiGHS has no answer."""
        leaving, arriving = np.nonzero(self.columns)
        legs, count = len(leaving), len(passes.job)
        exits, entries = costs.legs.shape
        ones = np.ones(legs)
        numbers = np.concatenate((ones, ones, -np.ones(2 * count), np.ones(count)))
        pass_columns = legs + np.arange(count)
        rows = np.concatenate(
            (leaving, exits + arriving, exits + passes.entry, passes.exit, exits + entries + passes.job)
        )
        columns = np.concatenate((np.arange(legs), np.arange(legs), pass_columns, pass_columns, pass_columns))
        equations = coo_array((numbers, (rows, columns)), shape=(exits + entries + costs.jobs, legs + count)).tocsr()
        sides = np.concatenate((np.zeros(exits + entries), np.ones(costs.jobs)))
        most = None
        if self.cuts:
            out = -(self._exits[:, leaving] & ~self._entries[:, arriving]).astype(np.float64)
            most = csr_array(np.hstack((out, self._of_passes(passes))))
        objective = np.concatenate((costs.legs[leaving, arriving], passes.cost))
        answer = linprog(
            objective,
            A_eq=equations,
            b_eq=sides,
            A_ub=most,
            b_ub=None if most is None else np.zeros(len(self.cuts)),
            method="highs-ds",
        )
        if answer.x is None:
            return None
        self.used = np.zeros(costs.legs.shape)
        self.used[leaving, arriving] = answer.x[:legs]
        self.passed = answer.x[legs:]
        slack, marginals = (np.zeros(0), np.zeros(0)) if most is None else (answer.slack, answer.ineqlin.marginals)
        prices = np.asarray(answer.eqlin.marginals)[: exits + entries]
        return _Solution(float(answer.fun), prices, np.minimum(marginals, 0.0), slack <= 1e-7)

    @property
    def _entries(self) -> BoolArray:
        return np.array([cut.entries for cut in self.cuts])

    @property
    def _exits(self) -> BoolArray:
        return np.array([cut.exits for cut in self.cuts])

    def _of_passes(self, passes: _Passes) -> FloatArray:
        """The numbers of the passes in the inequalities, (cuts, passes)."""
        inside = self._entries[:, passes.entry]
        counted = inside & (np.array([cut.job for cut in self.cuts])[:, None] == passes.job[None, :])
        return np.asarray(counted.astype(np.float64) - (inside & ~self._exits[:, passes.exit]))

    def _left(self, costs: Costs, solution: _Solution) -> FloatArray:
        """What prices leave of the cost of each leg, whether the linear program has it or not."""
        exits = costs.legs.shape[0]
        left = costs.legs - solution.prices[:exits, None] - solution.prices[None, exits:]
        if self.cuts:
            left += (solution.marginals[:, None] * self._exits).T @ (~self._entries).astype(np.float64)
        return left

    def _left_of_passes(self, passes: _Passes, solution: _Solution) -> FloatArray:
        """What they leave of the cost of each pass."""
        exits = len(solution.prices) - len(passes.of_entry)
        left = passes.cost + solution.prices[exits + passes.entry] + solution.prices[passes.exit]
        return left - solution.marginals @ self._of_passes(passes) if self.cuts else left

    def _wanted(self, left: FloatArray) -> bool:
        """Whether there are legs that would help; the best of them are added."""
        helpful = np.where(self.columns, 0.0, left).ravel()
        found = np.flatnonzero(helpful < -1e-9)
        if len(found) > PRICED:
            found = found[np.argpartition(helpful[found], PRICED)[:PRICED]]
        self.columns.ravel()[found] = True
        return len(found) > 0


@dataclass(frozen=True, eq=False)
class _Solution:
    """What a linear program came to: its value, prices of exits and entries, of cuts, and which cuts are tight."""

    value: float
    prices: FloatArray
    marginals: FloatArray
    tight: BoolArray


@dataclass(frozen=True, eq=False)
class _Passes:
    """Ways through jobs, job after job: of which job, from which entry to which exit (numbered through), at what cost.

    Attributes:
        begins: Where those of each job begin, (jobs,).
        of_entry: The job of each entry, (entries,).
    """

    job: IntArray
    entry: IntArray
    exit: IntArray
    cost: FloatArray
    begins: IntArray
    of_entry: IntArray

    @classmethod
    def of(cls, costs: Costs) -> _Passes:
        parts, begins = [], [0]
        for job, inner in enumerate(costs.inner):
            a, b = np.nonzero(inner < IMPOSSIBLE)
            if len(a) == 0:
                a, b = np.zeros(1, dtype=np.intp), np.zeros(1, dtype=np.intp)
            parts.append((np.full(len(a), job), costs.entries[job] + a, costs.exits[job] + b, inner[a, b]))
            begins.append(begins[-1] + len(a))
        job, entry, exit_, cost = (np.concatenate(column) for column in zip(*parts, strict=True))
        of_entry = np.repeat(np.arange(costs.jobs), np.diff(costs.entries))
        return cls(job, entry, exit_, cost, np.array(begins[:-1]), of_entry)


def _own(costs: Costs) -> BoolArray:
    """Which legs lead from a job to itself, (exits, entries)."""
    return np.repeat(np.repeat(np.eye(costs.jobs, dtype=bool), np.diff(costs.exits), 0), np.diff(costs.entries), 1)


def _closed(costs: Costs) -> BoolArray:
    """Which legs no order has that keeps the precedences, and those from a job to itself, (exits, entries).

    From i to j there is none if j must come before i, or a third job between them.
    """
    before = costs.before.astype(np.intp)
    jobs = costs.before.T | (before @ before > 0) | np.eye(costs.jobs, dtype=bool)
    if costs.jobs == 1:
        jobs[:] = False
    return np.repeat(np.repeat(jobs, np.diff(costs.exits), 0), np.diff(costs.entries), 1)


def _broken(costs: Costs, passes: _Passes, used: FloatArray, passed: FloatArray) -> list[Cut]:
    """Inequalities of kind 3 that a solution breaks, the most broken first."""
    found = [*_pairs_broken(costs, passes, used, passed), *_cuts_broken(costs, passes, used, passed)]
    found.sort(key=lambda pair: -pair[0])
    return [cut for _, cut in found[:MOST_CUTS]]


def _pairs_broken(costs: Costs, passes: _Passes, used: FloatArray, passed: FloatArray) -> list[tuple[float, Cut]]:
    """Of those for a job and one pass of another: legs between them are at most as many as that pass's ends are
    used."""
    exits, entries = used.shape
    at_entry = np.bincount(passes.entry, passed, entries)
    at_exit = np.bincount(passes.exit, passed, exits)
    arriving = np.add.reduceat(used, costs.exits[:-1], axis=0)  # from each job to each entry
    leaving = np.add.reduceat(used, costs.entries[:-1], axis=1)  # from each exit to each job
    excess = (
        arriving[:, passes.entry] + leaving[passes.exit].T - (at_entry[passes.entry] + at_exit[passes.exit] - passed)
    )
    excess[0], excess[:, 0] = 0.0, 0.0
    found = []
    for job, one in np.argwhere(excess > BROKEN).tolist():
        inside = np.zeros(entries, dtype=bool), np.zeros(exits, dtype=bool)
        inside[0][costs.entries[job] : costs.entries[job + 1]] = True
        inside[1][costs.exits[job] : costs.exits[job + 1]] = True
        inside[0][passes.entry[one]] = inside[1][passes.exit[one]] = True
        found.append((float(excess[job, one]), Cut(*inside, job)))
    return found


def _cuts_broken(costs: Costs, passes: _Passes, used: FloatArray, passed: FloatArray) -> list[tuple[float, Cut]]:
    """The most broken of each job, by a largest flow from its entries to job 0."""
    exits, entries = used.shape
    source = entries + exits
    b, a = np.nonzero(used > BROKEN / 10.0)
    through = np.flatnonzero(passed > BROKEN / 10.0)
    tails = np.concatenate((entries + b, passes.entry[through]))
    heads = np.concatenate((a, entries + passes.exit[through]))
    flows = np.rint(SCALE * np.concatenate((used[b, a], passed[through]))).astype(np.int32)
    at_entry = np.rint(SCALE * np.bincount(passes.entry, passed, entries)).astype(np.int32)
    found, seen = [], set()
    for job in range(1, costs.jobs):
        own = costs.entries[job] + np.flatnonzero(at_entry[costs.entries[job] : costs.entries[job + 1]])
        rows, columns = np.concatenate((tails, np.full(len(own), source))), np.concatenate((heads, own))
        graph = csr_array((np.concatenate((flows, at_entry[own])), (rows, columns)), shape=(source + 1, source + 1))
        flow = maximum_flow(graph, source, 0)
        short = 1.0 - flow.flow_value / SCALE
        if short <= BROKEN:
            continue
        rest = graph - flow.flow
        rest.data = (rest.data > 0).astype(np.int32)
        rest.eliminate_zeros()
        inside = np.zeros(source + 1, dtype=bool)
        inside[breadth_first_order(rest, source, return_predecessors=False)] = True
        key = inside.tobytes()
        if key not in seen:
            seen.add(key)
            found.append((short, Cut(inside[:entries], inside[entries:source], job)))
    return found
