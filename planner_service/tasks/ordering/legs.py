"""The legs between branches: what each takes at least, and what it takes once it has been planned."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from planner_service.certify import GripperMotion
from planner_service.collision import CancelToken, CheckCounts
from planner_service.geometry.arrays import BoolArray, FloatArray
from planner_service.parallel import Engine
from planner_service.planning.request import PlanRequest, clamped
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import SAME_WIDTH
from planner_service.scene.scene import Attached
from planner_service.service import PlannerService
from planner_service.tasks.ordering.tours import IMPOSSIBLE, Costs, Tour
from planner_service.tasks.ordering.visits import Branch
from planner_service.timing.least_time import least_times

__all__ = ["Leg", "LegTable", "Place", "Stops", "gripper_between"]

Stops = tuple[tuple[Branch, ...], ...]
"""The branches of a visit, and of those that must follow it at once."""

Place = tuple[int, int, int]
"""A leg: 0, its exit and its entry for one between visits; else the number of its table within a visit, row and
column."""

CLOSED_BY_START, CLOSED_BY_GOAL = "START_", "GOAL_"
"""How reasons begin for which no other leg from, or to, the same branch has a plan in the same scene."""


@dataclass(frozen=True, eq=False)
class Leg:
    """A planned leg: its plan or failure, and what the gripper does before it."""

    result: PlanResult
    service: PlannerService
    gripper: GripperMotion | None = None
    refused: str = ""

    @property
    def seconds(self) -> float:
        """How long it takes; ``IMPOSSIBLE`` without a plan."""
        trajectory = self.result.trajectory
        return IMPOSSIBLE if trajectory is None or self.refused else min(trajectory.duration, IMPOSSIBLE)

    @property
    def why(self) -> str:
        """Why there is no plan."""
        failure = self.result.failure
        return self.refused or ("" if failure is None else f"{failure.reason.value}: {failure.detail}")


@dataclass(eq=False)
class _Table:
    """Legs from some branches to some: seconds at least, seconds as far as known, and which are known."""

    starts: Sequence[Branch]
    goals: Sequence[Branch]
    least: FloatArray
    seconds: FloatArray
    known: BoolArray


@dataclass(eq=False)
class LegTable:
    """All legs of an ordering.

    Attributes:
        stops: Of each job; of job 0 where the arm ends.
        start: Where it starts.
        entries: Where each job's entries begin, as in ``Costs``; exits the same.
        before: As in ``Costs``.
        tables: Legs between jobs, then those within them.
        inside: For each job the numbers of its tables.
        planned: What was planned.
        spent: What that cost.
    """

    service: PlannerService
    request: PlanRequest
    stops: tuple[Stops, ...]
    start: Branch
    before: BoolArray
    tables: list[_Table] = field(default_factory=list)
    inside: list[range] = field(default_factory=list)
    planned: dict[Place, Leg] = field(default_factory=dict)
    spent: CheckCounts = field(default_factory=CheckCounts)
    _carried: list[tuple[Attached, ...]] = field(default_factory=list)

    def __post_init__(self) -> None:
        exits = [self.start, *(branch for stops in self.stops[1:] for branch in stops[-1])]
        entries = [branch for stops in self.stops for branch in stops[0]]
        self.tables.append(self._table(exits, entries))
        for stops in self.stops:
            first = len(self.tables)
            self.tables += [self._table(one, two) for one, two in pairwise(stops)]
            self.inside.append(range(first, len(self.tables)))
        self.exits = np.cumsum([0, 1, *(len(stops[-1]) for stops in self.stops[1:])])
        self.entries = np.cumsum([0, *(len(stops[0]) for stops in self.stops)])

    def _table(self, starts: Sequence[Branch], goals: Sequence[Branch]) -> _Table:
        robot, pace = self.service.robot, self.request.pace
        Q, P = (
            np.array([clamped(q, robot, self.request.start_tolerance) for q in rows])
            for rows in ([branch.end for branch in starts], [branch.q for branch in goals])
        )
        least = least_times(robot, pace.limits(robot), pace.timing, Q, P)
        after = np.array([self._load(branch.after) for branch in starts])
        before = np.array([self._load(branch.before) for branch in goals])
        known = after[:, None] != before[None, :]
        least[known] = IMPOSSIBLE
        return _Table(starts, goals, least, least.copy(), known)

    def _load(self, service: PlannerService | None) -> int:
        """The number of what the arm carries in a service's scene; what is equal has one."""
        carried = (service or self.service).scene.attached
        if carried not in self._carried:
            self._carried.append(carried)
        return self._carried.index(carried)

    def least(self) -> list[FloatArray]:
        """Seconds that any motion takes at least, table by table."""
        return [table.least for table in self.tables]

    def seconds(self, *, factor: float = 1.0, unknown: float | None = None) -> list[FloatArray]:
        """Seconds of legs as they are planned, table by table; of others what they take at least.

        Args:
            factor: What others are multiplied by: what they are likely to take.
            unknown: What every other counts instead.
        """
        others = [factor * table.seconds if unknown is None else unknown for table in self.tables]
        return [np.where(table.known, table.seconds, other) for table, other in zip(self.tables, others, strict=True)]

    def costs(self, seconds: Sequence[FloatArray]) -> Costs:
        """What jobs cost if legs take so long."""
        inner = []
        for stops, inside in zip(self.stops, self.inside, strict=True):
            own = [np.array([branch.seconds for branch in stop]) for stop in stops]
            through = np.where(np.eye(len(own[0]), dtype=bool), own[0], IMPOSSIBLE)
            for number, after in zip(inside, own[1:], strict=True):
                through = (through[:, :, None] + seconds[number][None]).min(axis=1) + after
            inner.append(np.minimum(through, IMPOSSIBLE))
        return Costs(self.entries, self.exits, seconds[0], tuple(inner), self.before)

    def likely_factor(self) -> float:
        """How many times what it takes at least a planned leg takes, at the median; 1 before any is planned."""
        ratios = [
            leg.seconds / self.tables[place[0]].least[place[1:]]
            for place, leg in self.planned.items()
            if leg.seconds < IMPOSSIBLE and self.tables[place[0]].least[place[1:]] > 0.0
        ]
        return float(np.median(ratios)) if ratios else 1.0

    def path(self, tour: Tour, seconds: Sequence[FloatArray]) -> list[Place]:
        """The legs of a tour, in order, where those take so long: the branches inside jobs are chosen by that."""
        places: list[Place] = []
        last = 0
        for job, entry, exit_ in zip(tour.order.tolist(), tour.entries.tolist(), tour.exits.tolist(), strict=True):
            places += [(0, last, entry), *self.inner_path(job, entry, exit_, seconds)]
            last = exit_
        return [*places, (0, last, 0)]

    def inner_path(self, job: int, entry: int, exit_: int, seconds: Sequence[FloatArray]) -> list[Place]:
        """The legs within a job from an entry to an exit, both numbered through."""
        inside = self.inside[job]
        ends = entry - int(self.entries[job]), exit_ - int(self.exits[job])
        chosen = self._inner(self.stops[job], [seconds[k] for k in inside], *ends)
        return [(number, *pair) for number, pair in zip(inside, pairwise(chosen), strict=True)]

    @staticmethod
    def _inner(stops: Stops, legs: Sequence[FloatArray], first: int, last: int) -> list[int]:
        """The branches of one job after another that cost least from its first to its last."""
        if not legs:
            return [first]
        reached, back = legs[0][first], []
        for stop, leg in zip(stops[1:-1], legs[1:], strict=True):
            through = (reached + np.array([branch.seconds for branch in stop]))[:, None] + leg
            back.append(through.argmin(axis=0))
            reached = through.min(axis=0)
        chosen = [last]
        for choice in reversed(back):
            chosen.append(int(choice[chosen[-1]]))
        return [first, *reversed(chosen)]

    def unknown(self, places: Iterable[Place]) -> list[Place]:
        """Those that are not planned yet, each once."""
        return [place for place in dict.fromkeys(places) if not self.tables[place[0]].known[place[1:]]]

    def ends(self, place: Place) -> tuple[Branch, Branch]:
        """The branches that a leg leads from and to."""
        table, row, column = place
        return self.tables[table].starts[row], self.tables[table].goals[column]

    def plan(self, places: Sequence[Place], engine: Engine | None, cancel: CancelToken | None) -> None:
        """Plan legs that are not known."""
        by_service: dict[int, list[Place]] = {}
        services: dict[int, PlannerService] = {}
        for place in places:
            service = self.ends(place)[1].before or self.service
            by_service.setdefault(id(service), []).append(place)
            services[id(service)] = service
        for key, some in by_service.items():
            service = services[key]
            requests = [self.request_of(*self.ends(place)) for place in some]
            for place, result in zip(some, _planned(service, requests, engine, cancel), strict=True):
                self._learn(place, result, service)

    def request_of(self, one: Branch, two: Branch) -> PlanRequest:
        """The request of a leg."""
        return replace(self.request, start=one.end, goal=two.q)

    def _learn(self, place: Place, result: PlanResult, service: PlannerService) -> None:
        gripper, refused = gripper_between(self.ends(place)[0], service, self.service)
        leg = Leg(result, service, gripper, refused)
        table, row, column = self.tables[place[0]], place[1], place[2]
        self.planned[place] = leg
        self.spent += result.counts + CheckCounts(distances=0 if gripper is None else gripper.certificate.distances)
        table.seconds[row, column], table.known[row, column] = leg.seconds, True
        reason = "" if result.failure is None else result.failure.reason.value
        if reason.startswith(CLOSED_BY_START):
            same = np.array([(goal.before or self.service) is service for goal in table.goals])
            same &= ~table.known[row]
            table.seconds[row, same], table.known[row, same] = IMPOSSIBLE, True
        if reason.startswith(CLOSED_BY_GOAL):
            same = ~table.known[:, column]
            table.seconds[same, column], table.known[same, column] = IMPOSSIBLE, True


def gripper_between(one: Branch, service: PlannerService, usual: PlannerService) -> tuple[GripperMotion | None, str]:
    """What the gripper does after a branch for a leg that ``service`` plans, and why that is not free; empty if it
    is."""
    has, wants = (one.after or usual).robot, service.robot
    if wants.gripper is None or abs(has.gripper_width - wants.gripper_width) <= SAME_WIDTH:
        return None, ""
    motion = service.certify_gripper(one.end, has.gripper_width, wants.gripper_width)
    return motion, motion.refused


def _planned(
    service: PlannerService, requests: Sequence[PlanRequest], engine: Engine | None, cancel: CancelToken | None
) -> Iterator[PlanResult]:
    if engine is None:
        return (service.plan(request, cancel=cancel) for request in requests)
    return iter(service.plan_many(requests, engine=engine, progress=False))
