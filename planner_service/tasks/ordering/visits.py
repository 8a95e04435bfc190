"""What is to be visited: where the arm may arrive for each visit, what it does there, and what must come before it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import NoneType

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import BoolArray, FloatArray, set_fields
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import checked_name, instance, items, numbers
from planner_service.planning.task_result import JOIN, Segment, require_joined
from planner_service.service import PlannerService

__all__ = ["MAX_BRANCHES", "Branch", "Visit", "chain_of", "require_visits"]

MAX_BRANCHES = 256
"""Branches of one visit."""

MAX_VISITS = 1000


@dataclass(frozen=True, eq=False)
class Branch:
    """One way to make a visit: where the arm arrives and leaves, and its motions in between.

    Attributes:
        q: Where it arrives, shape (n,).
        end: Where it leaves, shape (n,); q if not given, or where the motions end.
        motions: Proven motions from q to there, such as those of a ``ProvenWay``.
        before: What plans the way to it; the service of ``order`` if None.
        after: What plans on, as a pick leaves the arm with an object; the same if None. Two branches follow one another
            only if the arm carries the same after the first as before the second.

    Raises:
        InvalidRequest: the motions do not lead from q to the end.
    """

    q: FloatArray
    end: FloatArray = None  # type: ignore[assignment]  # the constructor takes None
    motions: tuple[Segment, ...] = ()
    before: PlannerService | None = None
    after: PlannerService | None = None

    def __post_init__(self) -> None:
        q = _configuration("q", self.q)
        motions = items("motions", self.motions, Segment, "a list of Segment")
        last = q
        if motions:
            require_joined(motions)
            first, last = motions[0].result.unwrap()[0].waypoints[0], motions[-1].result.unwrap()[0].waypoints[-1]
            _require_near("q", q, first, "where the motions begin")
        end = last if self.end is None else _configuration("end", self.end)
        if motions or len(end) != len(q):
            _require_near("end", end, last, "where the motions end")
        for name, service in (("before", self.before), ("after", self.after)):
            instance(name, service, (PlannerService, NoneType), "a PlannerService, or None")
        set_fields(self, q=q, end=end, motions=motions)

    @property
    def seconds(self) -> float:
        """How long its motions take, and how long the arm waits between them."""
        return math.fsum(each.result.unwrap()[1].duration + each.wait for each in self.motions)


@dataclass(frozen=True, eq=False)
class Visit:
    """Something to be done once, in one of several ways.

    Attributes:
        name: For messages and results.
        branches: Ways to do it: ``Branch`` values, joint vectors (n,), or poses of the tool, each of which stands for
            all inverse kinematics solutions that are found.
        then: A visit that must follow at once, such as the place that follows a pick.
        after: Names of visits that must come before.
        ways: The branches as they were read.

    Raises:
        InvalidRequest: there is no branch, more than 256, or one is something else; or ``then`` has an ``after``.
    """

    name: str
    branches: Branch | Pose | ArrayLike | Sequence[Branch | Pose | ArrayLike]
    then: Visit | None = None
    after: Sequence[str] = ()
    ways: tuple[Branch | Pose, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        checked_name("name of a visit", self.name)
        expected = "a list of branches, joint vectors or poses"
        alone = isinstance(self.branches, Branch | Pose)
        given = [self.branches] if alone else items("branches", self.branches, object, expected, MAX_BRANCHES)
        if not given:
            raise InvalidRequest("branches", self.branches, "at least one")
        read = [each if isinstance(each, Branch | Pose) else Branch(_of(k, each)) for k, each in enumerate(given)]
        instance("then", self.then, (Visit, NoneType), "a Visit, or None")
        after = items("after", self.after, str, "names of visits")
        if self.then is not None and self.then.after:
            raise InvalidRequest("then.after", self.then.after, "none: what must come before stands in the first visit")
        ways = tuple(read)
        set_fields(self, branches=ways, ways=ways, after=after)


def chain_of(visit: Visit) -> tuple[Visit, ...]:
    """A visit and those that must follow it at once."""
    chain = [visit]
    while (then := chain[-1].then) is not None:
        chain.append(then)
    return tuple(chain)


def require_visits(visits: object) -> tuple[tuple[tuple[Visit, ...], ...], BoolArray]:
    """Visits with those that follow them, and which must come before which, closed under transitivity, (m, m).

    Raises:
        InvalidRequest: there is none, a name is there twice, or they wait for each other.
        UnknownName: one must come after a visit that is not there.
    """
    given = items("visits", visits, Visit, "a list of Visit", MAX_VISITS)
    if not given:
        raise InvalidRequest("visits", visits, "at least one Visit")
    chains = tuple(chain_of(visit) for visit in given)
    names = [visit.name for chain in chains for visit in chain]
    twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if twice is not None:
        raise InvalidRequest("visits", twice, "each name once")
    of_name = {visit.name: k for k, chain in enumerate(chains) for visit in chain}
    before = np.zeros((len(given), len(given)), dtype=bool)
    for k, visit in enumerate(given):
        for name in visit.after:
            if name not in of_name:
                raise UnknownName("visit", name, names)
            before[of_name[name], k] = True
    for k in range(len(given)):  # Warshall, J. ACM 9(1), 1962
        before |= before[:, k, None] & before[None, k]
    waiting = [visit.name for k, visit in enumerate(given) if before[k, k]]
    if waiting:
        raise InvalidRequest("after", waiting, "visits that do not wait for each other")
    return chains, before


def _of(k: int, value: object) -> FloatArray:
    return _configuration(f"branches[{k}]", value)


def _configuration(name: str, value: object) -> FloatArray:
    expected = "joint values, shape (n,)"
    q = numbers(name, value, expected)
    if q.ndim != 1 or len(q) == 0 or not np.all(np.isfinite(q)):
        raise InvalidRequest(name, value, expected)
    return q


def _require_near(name: str, q: FloatArray, other: FloatArray, what: str) -> None:
    if q.shape != other.shape or not np.all(np.abs(q - other) <= JOIN):
        raise InvalidRequest(name, q.tolist(), f"{other.tolist()}, {what}")
