"""Picks shared out between arms: one chain of motions after the other is decided, each proven against all before it.

A chain is a whole pick and place: to the object, down, up with it, to its place, down, up, and back to where the arm
stood at first. Each is planned for its arm alone, in what may stand there meanwhile (``worlds``), and starts as early
as it is proven apart from everything that the other arms do as far as that is decided, and from where they then stand
(``lines``). An arm goes on from where it left the object before; where it cannot wait there, it goes back first.

So nothing is decided without a proven way to the end: each decided chain brings its arm back to where it stood at
first, and all arms stand apart there. No arm ever waits for something that does not come.

What is decided is not taken back. If no chain can be added, all is decided once more with the jobs that were left
before all others, as long as jobs are left that were not left before, and ``ATTEMPTS`` times at most. While such a job
has no start, since another arm stands in its way, that arm goes on, and those that can do the job wait for it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import NoneType

import numpy as np
from numpy.typing import ArrayLike

from planner_service.cell import Cell
from planner_service.collision import CancelToken, CheckCounts
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import instance, items, number, whole
from planner_service.grasping.kinds import GraspKind, GraspKinds
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Failure, Reason, Stage
from planner_service.planning.task_result import Handling, TaskResult
from planner_service.robot.model import Robot, joint_vector
from planner_service.scheduling.jobs import PickJob
from planner_service.scheduling.lines import FOREVER, Lines, Piece, motions_of, pieces_of, stand
from planner_service.scheduling.result import Chain, Schedule
from planner_service.scheduling.worlds import before, require_jobs
from planner_service.service import PlannerService
from planner_service.tasks import MoveTo, Task, pick_steps, place_steps, solve, standing_on

__all__ = ["schedule_picks"]

MAX_JOBS = 100
MAX_DELAY = 1.0
MAX_GRIPPER = 60.0

FROM_ABOVE = GraspKinds((GraspKind.TOP,))
"""Grasps that are tried first."""

LOOKED_AT = 4
"""Jobs of which the one is taken that ends first."""

ATTEMPTS = 4
"""Times at most that all is decided."""


def schedule_picks(
    cell: Cell,
    jobs: Sequence[PickJob],
    *,
    starts: Mapping[str, ArrayLike] | None = None,
    request: PlanRequest | None = None,
    delay: float = 0.1,
    gripper_seconds: float = 0.5,
    looked_at: int = LOOKED_AT,
    cancel: CancelToken | None = None,
) -> Schedule:
    """Picks shared out between the arms of a cell, proven apart to the end before anything moves.

    Args:
        cell: Of robots at places, each with a gripper; nothing is carried.
        jobs: What is to be done, in any order.
        starts: Where arms stand at first, and go back to, by their names; at home if not named.
        request: Planner, timing, seed, scales, padding and limits of all motions; its start and goal are not used.
        delay: Seconds by which any arm may be late at any time, each for itself, without touching another.
        gripper_seconds: That the gripper takes to open or close; the arm stands meanwhile.
        looked_at: Jobs that are planned for the arm that is free first; the one is taken that ends first.
        cancel: Ends the call before its next check.

    Raises:
        UnknownName: There is no such arm, or no such obstacle.
        InvalidRequest: A value is of the wrong kind or out of range, an arm has no gripper or joints that turn without
            end, or an object is in two jobs.
        Cancelled: By the caller.
    """
    instance("cell", cell, Cell, "a Cell")
    asked = items("jobs", jobs, PickJob, "a sequence of PickJob", MAX_JOBS)
    if not asked:
        raise InvalidRequest("jobs", jobs, "at least one PickJob")
    number("delay", delay, f"seconds in [0, {MAX_DELAY:g}]", 0.0, MAX_DELAY)
    number("gripper_seconds", gripper_seconds, f"seconds in [0, {MAX_GRIPPER:g}]", 0.0, MAX_GRIPPER)
    whole("looked_at", looked_at, 1, MAX_JOBS)
    instance("request", request, (PlanRequest, NoneType), "a PlanRequest, or None")
    instance("cancel", cancel, (CancelToken, NoneType), "a CancelToken, or None")
    require_cell(cell)
    require_jobs(cell.scene, cell.arms, asked)
    given = instance("starts", {} if starts is None else starts, Mapping, "joints by the names of arms")
    for name in given:
        cell.arm(name)
    stood = {
        name: joint_vector(f"starts[{name!r}]", given.get(name, robot.home), robot)
        for name, robot in ((name, cell.arm(name).robot) for name in cell.arms)
    }
    return _Scheduling(cell, asked, stood, request, delay, gripper_seconds, looked_at, cancel).run()


def require_cell(cell: Cell) -> None:
    """Refuse a cell whose picks cannot be scheduled.

    Raises:
        InvalidRequest: It says why.
    """
    if cell.layout.whole is not None:
        raise InvalidRequest("cell", "one robot with several arms", "a cell of robots at places, each with a gripper")
    if any(cell.layout.carried.values()):
        raise InvalidRequest("cell", cell.layout.carried, "a cell in which nothing is carried")
    for name, arm in cell.layout.arms.items():
        if arm.robot.gripper is None:
            raise InvalidRequest("cell", name, "arms with a gripper")
        if any(arm.robot.continuous):
            raise InvalidRequest("cell", name, "arms without joints that turn without end")


@dataclass(eq=False)
class _Arm:
    """Where an arm is once all that is decided for it is done, but for the way back.

    Attributes:
        free: From when on it can start, where it then stands.
        back: When it is back where it stood at first; it is there already if that is not later.
    """

    robot: Robot
    rest: FloatArray
    q: FloatArray
    free: float = 0.0
    back: float = 0.0


@dataclass(frozen=True, eq=False)
class _Offer:
    """A chain that can be decided."""

    chain: Chain
    pieces: Sequence[Piece]
    left_at: float
    free: float
    end: float
    returned: bool


class _Scheduling:
    """One call."""

    def __init__(
        self,
        cell: Cell,
        jobs: Sequence[PickJob],
        starts: Mapping[str, FloatArray],
        request: PlanRequest | None,
        delay: float,
        gripper_seconds: float,
        looked_at: int,
        cancel: CancelToken | None,
    ) -> None:
        self._cell, self._jobs, self._delay, self._looked_at = cell, jobs, delay, looked_at
        self._request, self._gripper_seconds, self._cancel = request, gripper_seconds, cancel
        self._starts = starts
        self._padding = 0.0 if request is None else request.padding
        self._counts = CheckCounts()
        self._begin()

    def _begin(self) -> None:
        """Nothing is decided."""
        self._lines = Lines(self._cell, self._starts, self._delay, self._padding)
        robots = {name: self._cell.arm(name).robot for name in self._cell.arms}
        self._arms = {name: _Arm(robot, self._starts[name], self._starts[name]) for name, robot in robots.items()}
        self._chains = list[Chain]()
        self._held = dict[str, tuple[str, float]]()  # by an object, the arm that takes it, and from when on
        self._refused = dict[tuple[str, str], str]()

    def run(self) -> Schedule:
        """All chains, or as many as were decided before none could be added."""
        trouble = self._start_trouble()
        if trouble:
            return self._result(Failure(Stage.ENDPOINTS, Reason.START_IN_COLLISION, trouble))
        estimates = self._estimates()
        best, first, rectangles, bounds = None, list[PickJob](), 0, 0
        for _ in range(ATTEMPTS):
            left = self._decided(first, estimates)
            made = self._result(self._stuck(left) if left else None)
            rectangles, bounds = rectangles + made.rectangles, bounds + made.distances
            if best is None or len(made.chains) > len(best.chains):
                best = made
            new = [job for job in left if job not in first]
            if not new:
                break
            first = [*new, *first]
            self._begin()
        assert best is not None
        return replace(best, rectangles=rectangles, distances=bounds, counts=self._counts)

    def _decided(self, first: Sequence[PickJob], estimates: Mapping[tuple[str, str], float]) -> list[PickJob]:
        """Decide chains, of some jobs before all others; the jobs that are left when none can be added."""
        left = list(self._jobs)
        while left:
            ahead = [job for job in left if job in first]
            able = [name for name in self._arms if any(estimates[name, job.object] < math.inf for job in ahead)]
            others = [name for name in self._arms if name not in able]
            offer = self._next(ahead, estimates, able) or self._next(left, estimates, others)
            offer = offer or self._next(left, estimates, able)
            if offer is None:
                break
            self._decide(offer)
            left.remove(offer.chain.job)
        return left

    def _start_trouble(self) -> str:
        """What touches where arms stand at first, with everything where it is and where it goes."""
        scene = before(self._cell.scene, self._jobs, None, ())
        for name, arm in self._arms.items():
            checker = PlannerService(arm.robot, scene).checker
            if not checker.state_is_free(arm.rest):
                touching = "; ".join(f"{a} x {b}" for a, b in sorted(checker.touching(arm.rest))[:2])
                return f"{name}: {touching} where it stands, or where an object goes"
        for (a, b), late in self._lines.tolerates().items():
            if late <= self._delay:
                return f"{a} and {b} are not proven apart where they stand"
        return ""

    def _estimates(self) -> dict[tuple[str, str], float]:
        """Seconds of each job's chain by each arm, from where it stands first; infinite where there is none."""
        out = {}
        for name in self._arms:
            for job in self._jobs:
                task = self._planned(name, job, FROM_ABOVE, ()) if not job.arms or name in job.arms else None
                out[name, job.object] = math.inf if task is None else task.duration
        return out

    def _next(
        self, left: Sequence[PickJob], estimates: Mapping[tuple[str, str], float], names: Sequence[str]
    ) -> _Offer | None:
        """The chain that some arms do next: that of the one that is free first, or if it has none, of another.

        Jobs that an arm could not do from above at first, and grasps from elsewhere, are tried if there is none.
        """
        for grasps in (FROM_ABOVE, None):
            for name in sorted(names, key=lambda name: self._arms[name].free):
                mine = [job for job in left if not job.arms or name in job.arms]
                if grasps is not None:
                    mine = [job for job in mine if estimates[name, job.object] < math.inf]

                def rank(job: PickJob, name: str = name) -> tuple[float, float]:
                    own, *others = (estimates[each, job.object] for each in sorted(self._arms, key=name.__ne__))
                    other = min(others, default=math.inf)
                    return (0.0 if own == other else own - other, own)

                best: _Offer | None = None
                for k, job in enumerate(sorted(mine, key=rank)):
                    if k >= self._looked_at and best is not None:
                        break
                    offer = self._offer(name, job, grasps)
                    if offer is not None and (best is None or offer.free < best.free):
                        best = offer
                self._lines.forget()
                if best is not None:
                    return best
        return None

    def _offer(self, name: str, job: PickJob, grasps: GraspKinds | None) -> _Offer | None:
        """A job's chain by an arm at its earliest start: from where it is, from where it stood at first, or from there
        when all else is done."""
        arm = self._arms[name]
        found = None
        if arm.q is not arm.rest:
            found = self._from(name, job, grasps, arm.q, arm.free, arm.free)
        if found is None:
            found = self._from(name, job, grasps, arm.rest, arm.back, arm.back)
        done = self._lines.end() + 2.0 * self._delay
        if found is None and self._gone(name, job, done) != self._gone(name, job, arm.back):
            found = self._from(name, job, grasps, arm.rest, arm.back, done)
        return found

    def _gone(self, name: str, job: PickJob, since: float) -> tuple[str, ...]:
        """Objects of other jobs that an arm that starts at a time does not meet where they were."""
        taken = [(each.object, *self._held[each.object]) for each in self._jobs if each.object in self._held]
        return tuple(object for object, arm, at in taken if arm == name or at + self._delay <= since)

    def _from(
        self, name: str, job: PickJob, grasps: GraspKinds | None, q: FloatArray, left_at: float, earliest: float
    ) -> _Offer | None:
        """A job's chain from q (n,), where the arm is from ``left_at`` on."""
        gone, waits = self._gone(name, job, earliest), q is not self._arms[name].rest
        task = self._planned(name, job, grasps, gone, q)
        if task is None:
            return None
        pieces = pieces_of(motions_of(task, self._gripper_seconds))
        back = pieces[-1]
        chain = [*pieces, stand(self._arms[name].rest, back.end, FOREVER)]
        wait = stand(q, 0.0, 0.0) if waits else None
        latest = max(self._lines.end() + 2.0 * self._delay, earliest)
        start = self._lines.fit(name, wait, chain, earliest, latest)
        if start is None:
            self._refused[name, job.object] = "it is not proven apart from the other arms at any start"
            return None
        made = Chain(name, job, start, task, gone, self._gripper_seconds)
        return _Offer(made, chain, left_at, start + back.begin, start + back.end, returned=not waits)

    def _planned(
        self, name: str, job: PickJob, grasps: GraspKinds | None, gone: Sequence[str], q: FloatArray | None = None
    ) -> TaskResult | None:
        """A job's chain by an arm alone."""
        arm = self._arms[name]
        scene = before(self._cell.scene, self._jobs, job, gone)
        start = arm.rest if q is None else q
        service = PlannerService(self._opened(name), scene)
        below = standing_on(self._cell.scene, job.object)
        taking = Handling(support=None if below in gone else below)
        steps = (
            *pick_steps(job.object, grasps, taking),
            *place_steps(job.object, [job.place], Handling(support=job.support)),
            MoveTo(tuple(arm.rest.tolist()), name="back"),
        )
        task = solve(service, Task(steps), start, request=self._request, cancel=self._cancel)
        self._counts += task.counts
        if task.failure is not None:
            self._refused[name, job.object] = task.failure.detail
            return None
        return task

    def _opened(self, name: str) -> Robot:
        """An arm's robot, its gripper as it is once all that is decided for it is done."""
        mine = [chain for chain in self._chains if chain.arm == name]
        return mine[-1].task.world.robot if mine else self._arms[name].robot

    def _decide(self, offer: _Offer) -> None:
        chain, arm = offer.chain, self._arms[offer.chain.arm]
        mine = [k for k, each in enumerate(self._chains) if each.arm == chain.arm]
        if not offer.returned:  # what it did before ends without the way back
            last = self._chains[mine[-1]]
            task = last.task
            ended = task.segments[-1].result.unwrap()[0].waypoints[0]
            self._chains[mine[-1]] = replace(last, task=replace(task, segments=task.segments[:-1], q=ended))
        self._lines.commit(chain.arm, offer.pieces, chain.start, offer.left_at)
        self._chains.append(chain)
        lifted = next(piece.begin for piece in offer.pieces if piece.held is not None)
        self._held[chain.job.object] = chain.arm, chain.start + lifted
        arm.free, arm.back = offer.free, offer.end
        arm.q = np.array(chain.task.segments[-1].result.unwrap()[0].waypoints[0])

    def _stuck(self, left: Sequence[PickJob]) -> Failure:
        why = [
            f"{name}, {job.object}: {self._refused[name, job.object]}"
            for job in left
            for name in self._arms
            if (name, job.object) in self._refused
        ]
        names = ", ".join(each.object for each in left[:4])
        detail = f"{len(left)} picks are left, {names}; {'; '.join(why[:4])}"
        return Failure(Stage.SEARCH, Reason.PLANNING_FAILED, detail)

    def _result(self, failure: Failure | None) -> Schedule:
        between = self._lines.tolerates() if failure is None else {}
        margins = [
            chain.start - since
            for chain in self._chains
            for object in chain.gone
            for arm, since in [self._held[object]]
            if arm != chain.arm
        ]
        return Schedule(
            tuple(self._chains),
            self._starts,
            tuple(self._jobs),
            min([*between.values(), *margins], default=math.inf),
            between,
            self._padding,
            failure,
            self._lines.rectangles,
            self._lines.bounds,
            self._counts,
            self._cell.layout,
        )
