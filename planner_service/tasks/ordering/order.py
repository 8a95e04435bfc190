"""In which order to make visits, and with which branches, so that all motion takes least time, with a proven gap.

Legs are planned lazily: at first each counts what any motion takes at least (``timing.least_time``), and only those
that the best order uses, or that hold the bound down, are planned.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import NoneType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from planner_service.collision import CancelToken, CheckCounts
from planner_service.collision.budget import Cancelled
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import BoolArray, FloatArray
from planner_service.geometry.validation import instance, number, whole
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.parallel import Engine
from planner_service.planning.request import PlanRequest, clamped
from planner_service.planning.result import Failure, Reason, Stage
from planner_service.planning.task_result import Segment, TaskResult
from planner_service.robot.model import joint_vector
from planner_service.service import PlannerService
from planner_service.tasks.ordering.legs import LegTable, Place, Stops
from planner_service.tasks.ordering.result import FailedLeg, OrderResult, Stop
from planner_service.tasks.ordering.tours import IMPOSSIBLE, Tour, best_branches, improved
from planner_service.tasks.ordering.visits import Branch, Visit, require_visits

if TYPE_CHECKING:
    from planner_service.tasks.ordering.relaxation import Relaxation

__all__ = ["order"]

FIRST_ROUNDS, MORE_ROUNDS = 600, 120
"""Of taking jobs out and putting them back: for the first order, and for each that follows."""

COLUMN_ROUNDS = 240_000
"""Legs in a linear program times rounds of it: 30 visits with 8 branches each have 40 rounds, 200 have 8."""

MAX_LINEAR = 40

ALL_COLUMNS = 550_000
"""The same of all rounds of a call: 20 with 200 visits, which take some four minutes."""

USED = 0.01
"""Share of a leg in the solution of the linear program from which it is planned."""

TURNS = 24
"""Times at most that the bound is raised and an order looked for."""

MAX_ALL = 6000
"""Branches of all visits together: a table of their legs then takes 300 MB."""


def order(
    service: PlannerService,
    visits: Sequence[Visit],
    request: PlanRequest,
    *,
    end: ArrayLike | None = None,
    gap: float = 0.05,
    plans: int = 3000,
    engine: Engine | None = None,
    cancel: CancelToken | None = None,
) -> OrderResult:
    """The order and the branches with which visits take least time, each motion proven, and how good that is at least.

    Nothing depends on a clock unless the request has a time limit: equal calls give equal results, whatever the engine.

    Args:
        service: What plans the legs. They are planned in its scene, whatever was visited before, so objects that are
            moved must stand both where they were and where they will be (``order_moves`` sees to it).
        visits: What is to be visited.
        request: Its start is where the arm starts. Planner, timing, seed, scales, padding and limits are those of all
            legs, and its goal is not used.
        end: Where the arm ends, shape (n,); where it starts if None.
        gap: Share of the bound by which the order may be longer than the best: with less proven, the call returns.
        plans: Legs that may be planned, after which it returns what is known. Those of one order are always planned.
        engine: As for ``service.plan_many``; if None, one leg after another in this process.
        cancel: Ends the call when cancelled from another thread.

    Raises:
        InvalidRequest: A value is of the wrong kind or out of its range, a branch is not of this robot, or there are
            more than 6,000 branches.
        UnknownName: A visit must come after one that is not there.
        Cancelled: by ``cancel``.
    """
    instance("service", service, PlannerService, "a PlannerService")
    instance("request", request, PlanRequest, "a PlanRequest")
    instance("cancel", cancel, (CancelToken, NoneType), "a CancelToken, or None")
    chains, before = require_visits(visits)
    gap = number("gap", gap, "a share from 0 to 10", 0.0, 10.0)
    plans = whole("plans", plans, 1, 1_000_000)
    start = Branch(joint_vector("request.start", request.start, service.robot))
    last = start if end is None else Branch(joint_vector("end", end, service.robot))
    return _Ordering(service, chains, before, request, start, last, gap, plans, engine, cancel).result()


@dataclass(eq=False)
class _Ordering:
    """One call of ``order``: what was asked."""

    service: PlannerService
    chains: tuple[tuple[Visit, ...], ...]
    before: BoolArray
    request: PlanRequest
    start: Branch
    end: Branch
    gap: float
    plans: int
    engine: Engine | None
    cancel: CancelToken | None

    def result(self) -> OrderResult:
        """The order, or why there is none."""
        began = time.perf_counter()
        self.refused: list[str] = []
        self.numbers: dict[int, tuple[str, int]] = {}
        stops: list[Stops] = [((self.end,),)]
        for chain in self.chains:
            stops.append(tuple(self._usable(visit) for visit in chain))
            empty = next((visit for visit, some in zip(chain, stops[-1], strict=True) if not some), None)
            if empty is not None:
                return self._none(self._unusable(empty), None)
        if sum(len(stop) for job in stops for stop in job) > MAX_ALL:
            raise InvalidRequest(
                "visits", f"{sum(len(s) for j in stops for s in j):,} branches", f"at most {MAX_ALL:,}"
            )
        closed = np.pad(self.before, ((1, 0), (1, 0)))
        table = LegTable(self.service, self.request, tuple(stops), self.start, closed)
        tour, bound, floor = self._searched(table)
        if tour is None:
            return self._none(self._impossible(table), table)
        return self._made(table, tour, bound, floor, began)

    def _searched(self, table: LegTable) -> tuple[Tour | None, float, float]:
        """The best order of planned legs, the bound for this request's plans, and the bound for any."""
        from planner_service.tasks.ordering.relaxation import Relaxation  # scipy.optimize takes long to import

        rng = np.random.default_rng(self.request.seed)
        likely = improved(table.costs(table.least()), rng, FIRST_ROUNDS)
        relaxation = Relaxation.of(table.costs(table.least()), likely)
        rounds = max(4, min(MAX_LINEAR, COLUMN_ROUNDS // max(1, int(relaxation.columns.sum()))))
        left = ALL_COLUMNS // max(1, int(relaxation.columns.sum())) - rounds
        best: Tour | None = None
        bound = floor = 0.0
        for turn in range(TURNS):
            likely, best = self._planned(table, likely, best, rng)
            enough = math.inf if best is None else best.cost / (1.0 + self.gap)
            if turn == 0:
                floor = bound = max(0.0, relaxation.raised(table.costs(table.least()), rounds, enough))
            if bound < enough:
                more = max(1, min(left, rounds if turn == 0 else max(3, rounds // 4)))
                left -= more
                bound = max(bound, relaxation.raised(table.costs(table.seconds()), more, enough))
            wanted = table.unknown(self._used(table, relaxation))[: 2 * len(self.chains)]
            done = relaxation.settled and not wanted
            if bound >= min(enough, IMPOSSIBLE) or len(table.planned) >= self.plans or left <= 0 or done:
                break
            self._plan(table, wanted)
            likely = self._improved(table, likely if best is None else best, rng)[0]
        return best, min(bound, math.inf if best is None else best.cost), floor

    def _planned(
        self, table: LegTable, tour: Tour, best: Tour | None, rng: np.random.Generator
    ) -> tuple[Tour, Tour | None]:
        """The likely best order once all its legs are planned, and the best of those whose legs all have a plan."""
        seconds = table.seconds()
        while unknown := table.unknown(table.path(tour, seconds)):
            if len(table.planned) >= self.plans:
                break
            self._plan(table, unknown)
            best = self._better(table, tour, best)
            tour, seconds = self._improved(table, tour, rng)
        sure = table.costs(table.seconds(unknown=IMPOSSIBLE))
        return tour, _shorter(improved(sure, rng, MORE_ROUNDS, tour if best is None else best), best)

    @staticmethod
    def _better(table: LegTable, tour: Tour, best: Tour | None) -> Tour | None:
        """The best order whose legs all have a plan, now that those of another are planned.

        The other is kept at once: what is looked for next goes through legs that are not planned yet, and may spend all
        plans before it is complete.
        """
        return _shorter(best_branches(table.costs(table.seconds(unknown=IMPOSSIBLE)), tour.order), best)

    def _improved(self, table: LegTable, tour: Tour, rng: np.random.Generator) -> tuple[Tour, list[FloatArray]]:
        """A better order, if legs that are not planned take as many times what they take at least as others did."""
        seconds = table.seconds(factor=table.likely_factor())
        return improved(table.costs(seconds), rng, MORE_ROUNDS, tour), seconds

    def _used(self, table: LegTable, relaxation: Relaxation) -> list[Place]:
        """Legs that the bound stands on, those first that it uses most."""
        rows, columns = np.nonzero(relaxation.used > USED)
        places: list[tuple[float, Place]] = [
            (-float(relaxation.used[row, column]), (0, row, column))
            for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        ]
        seconds = table.seconds()
        for job, entry, exit_, share in relaxation.passes(table.costs(seconds)):
            if share > USED:
                places += [(-share, place) for place in table.inner_path(job, entry, exit_, seconds)]
        return [place for _, place in sorted(places)]

    def _plan(self, table: LegTable, places: Sequence[Place]) -> None:
        """Plan legs.

        Raises:
            Cancelled: by the caller.
        """
        table.plan(places, self.engine, self.cancel)
        if self.cancel is not None and self.cancel.cancelled:
            raise Cancelled("cancelled by the caller")

    def _usable(self, visit: Visit) -> tuple[Branch, ...]:
        """The branches of a visit that touch nothing; poses become all their inverse kinematics solutions."""
        found: list[Branch] = []
        for given in visit.ways:
            if isinstance(given, Branch):
                found.append(given)
                continue
            solutions = inverse_kinematics(self.service.robot, given, seed=self.request.seed, still=self.start.q)
            found += map(Branch, solutions)
            if not len(solutions):
                self.refused.append(f"{visit.name}: no configuration brings the tool to {given}")
        usable = []
        for k, branch in enumerate(found):
            self._require_possible(f"{visit.name} [{k}]", branch)
            blocked = "" if branch.motions else self._blocked(branch, self.service)
            if blocked:
                self.refused.append(f"{visit.name} [{k}]: {blocked}")
            else:
                usable.append(branch)
                self.numbers[id(branch)] = (visit.name, k)
        return tuple(usable)

    def _require_possible(self, name: str, branch: Branch) -> None:
        """Refuse what is outside the joint limits, and motions of a robot whose joints turn without end: a leg may
        arrive some turns from where they begin."""
        robot = self.service.robot
        lower, upper = robot.bounds
        for given in (branch.q, branch.end):
            q = clamped(joint_vector(name, given, robot), robot, self.request.start_tolerance)
            if np.any((q < lower) | (q > upper)):
                joint = int(np.argmax(np.maximum(lower - q, q - upper)))
                expected = f"{robot.joint_names[joint]} in [{lower[joint]:.4f}, {upper[joint]:.4f}]"
                raise InvalidRequest(name, float(q[joint]), expected)
        if branch.motions and any(robot.continuous):
            expected = "branches without motions: a joint of this robot turns without end"
            raise InvalidRequest(f"{name}: motions", len(branch.motions), expected)

    @staticmethod
    def _blocked(branch: Branch, usual: PlannerService) -> str:
        """What touches where a branch arrives, or where it leaves; empty if nothing does."""
        for q, service in ((branch.q, branch.before or usual), (branch.end, branch.after or usual)):
            at = clamped(q, service.robot)
            if not service.checker.state_is_free(at):
                return "; ".join(f"{a} x {b}" for a, b in sorted(service.checker.touching(at))[:2])
        return ""

    def _none(self, failure: Failure, table: LegTable | None) -> OrderResult:
        counts = CheckCounts() if table is None else table.spent
        task = TaskResult(
            (),
            self.service.world,
            self.start.q,
            failure,
            choosing=counts,
            notes=self._notes,
            request=self.request,
            task=self._words,
        )
        failed = () if table is None else self._failed(table)
        plans = 0 if table is None else len(table.planned)
        return OrderResult((), task, math.inf, 0.0, 0.0, plans, failed, tuple(self.refused), counts, failure)

    @property
    def _notes(self) -> tuple[str, ...]:
        many = len(self.refused)
        return (f"not used, as they touch something or are out of reach: {many} branches",) if many else ()

    @property
    def _words(self) -> str:
        return f"order {sum(map(len, self.chains))} visits"

    def _unusable(self, visit: Visit) -> Failure:
        own = [reason for reason in self.refused if reason.startswith(f"{visit.name}")]
        reached = any(reason.startswith(f"{visit.name} [") for reason in own)
        reason = Reason.GOAL_IN_COLLISION if reached else Reason.NO_IK_SOLUTION
        return Failure(Stage.ENDPOINTS, reason, f"no branch of {visit.name} can be used: {'; '.join(own[:4])}")

    def _impossible(self, table: LegTable) -> Failure:
        failed = self._failed(table)
        told = "; ".join(map(str, failed[:4]))
        spent = len(table.planned) >= self.plans
        why = f"after {len(table.planned)} plans (plans={self.plans})" if spent else "whichever comes first"
        detail = f"no order was found all of whose legs have a plan, {why}; {len(failed)} legs have none: {told}"
        return Failure(Stage.SEARCH, Reason.PLANNING_FAILED, detail)

    def _failed(self, table: LegTable) -> tuple[FailedLeg, ...]:
        failed = []
        for place, leg in table.planned.items():
            if leg.why:
                start, goal = (self.numbers.get(id(branch), ("", 0)) for branch in table.ends(place))
                failed.append(FailedLeg(start, goal, leg.why))
        return tuple(failed)

    def _made(self, table: LegTable, tour: Tour, bound: float, floor: float, began: float) -> OrderResult:
        """The result of an order all of whose legs have a plan."""
        segments: list[Segment] = []
        stops: list[Stop] = []
        at = self.start.end
        spent = table.spent
        for place in table.path(tour, table.seconds(unknown=IMPOSSIBLE)):
            one, two = table.ends(place)
            leg = table.planned[place]
            result = leg.result
            if not np.array_equal(at, result.unwrap()[0].waypoints[0]) and any(self.service.robot.continuous):
                result = leg.service.plan(replace(table.request_of(one, two), start=at), cancel=self.cancel)
                spent += result.counts
                if result.failure is not None:
                    return self._none(result.failure, table)
            name, number = self.numbers.get(id(two), ("", 0))
            world = leg.service.world
            title = f"to {name}" if name else "to the end"
            segments.append(Segment(title, result, world.robot.gripper_width, world.scene, leg.gripper))
            spent -= segments[-1].counts
            segments += [replace(each, name=f"{name}: {each.name}") for each in two.motions]
            if name:
                stops.append(Stop(name, number, result))
            at = result.unwrap()[0].waypoints[-1] if not two.motions else two.end
        task = TaskResult(
            tuple(segments),
            segments[-1].world_after(self.service.world),
            at,
            choosing=spent,
            notes=self._notes,
            request=self.request,
            task=self._words,
            seconds=time.perf_counter() - began,
        )
        return OrderResult(
            tuple(stops),
            task,
            task.duration,
            min(bound, task.duration),
            min(floor, task.duration),
            len(table.planned),
            self._failed(table),
            tuple(self.refused),
            task.counts,
            deterministic=all(leg.result.deterministic for leg in table.planned.values()),
        )


def _shorter(tour: Tour, best: Tour | None) -> Tour | None:
    """The shorter of a tour and the best so far, if it is possible."""
    return tour if tour.cost < (IMPOSSIBLE if best is None else best.cost) else best
