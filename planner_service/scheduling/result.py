"""Who takes what and when, as one value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from planner_service.cell.layout import Layout
from planner_service.collision import CheckCounts
from planner_service.errors import PlanningFailed, UnknownName
from planner_service.geometry.arrays import FloatArray, frozen, set_fields
from planner_service.geometry.validation import copied_in, numbers
from planner_service.planning.result import Failure
from planner_service.planning.task_result import TaskResult
from planner_service.scheduling.jobs import PickJob

__all__ = ["Chain", "Schedule"]


@dataclass(frozen=True, eq=False)
class Chain:
    """One job as it is done: to the object, with it to its place, and away, without a stop but for the gripper's.

    Attributes:
        arm: Which does it.
        job: What it does.
        start: Seconds after the start of the whole at which it starts.
        task: The motions, each proven by itself in what stands there meanwhile.
        gone: Objects of other jobs that are no longer where they were when it starts.
        gripper_seconds: That each motion of the gripper takes.
    """

    arm: str
    job: PickJob
    start: float
    task: TaskResult
    gone: tuple[str, ...]
    gripper_seconds: float

    def __post_init__(self) -> None:
        copied_in(self, "gone")

    @property
    def seconds(self) -> float:
        """How long it takes."""
        closing = sum(segment.gripper is not None for segment in self.task.segments)
        return self.task.duration + closing * self.gripper_seconds

    @property
    def end(self) -> float:
        """Seconds after the start of the whole at which it ends."""
        return self.start + self.seconds

    def __call__(self, t: ArrayLike) -> FloatArray:
        """Joints of the arm at times t of the whole, shape (..., n); it stands before and after."""
        times = numbers("t", t, "seconds")
        out = np.repeat(self.task.segments[0].result.unwrap()[0].waypoints[:1], times.size, axis=0)
        begin = self.start
        for segment in self.task.segments:
            trajectory = segment.result.unwrap()[1]
            begin += segment.wait + (0.0 if segment.gripper is None else self.gripper_seconds)
            rows = times.reshape(-1) >= begin
            out[rows] = trajectory(np.minimum(times.reshape(-1)[rows] - begin, trajectory.duration))
            begin += trajectory.duration
        return out.reshape(*times.shape, -1)


@dataclass(frozen=True, eq=False)
class Schedule:
    """Picks of several arms that do not touch each other, or the reason why there are none.

    Attributes:
        chains: The jobs as they are done, in the order in which they were decided; without a failure, all of them.
        starts: Where each arm stands before, its joints by its name; all end there, too.
        jobs: What was asked for.
        tolerates: Seconds by which every arm may be late, each for itself, at any time, without touching another or
            what it carries: that is proven. Infinite for one arm.
        between: The same of each two arms.
        padding: Metres that all keep from each other.
        failure: None if there is a proven plan to the end.
        rectangles: Of two arms' motions, those that were asked for a proof.
        distances: Bounds that this took, beside those of each motion's own proof.
        counts: What all plans cost that were made for it.
        layout: What the cell is made of.
    """

    chains: tuple[Chain, ...]
    starts: Mapping[str, FloatArray]
    jobs: tuple[PickJob, ...]
    tolerates: float
    between: Mapping[tuple[str, str], float]
    padding: float
    failure: Failure | None
    rectangles: int
    distances: int
    counts: CheckCounts
    layout: Layout = field(repr=False)

    def __post_init__(self) -> None:
        copied_in(self, "chains", "jobs")
        starts = {name: frozen(np.array(q, dtype=np.float64)) for name, q in self.starts.items()}
        set_fields(self, starts=MappingProxyType(starts), between=MappingProxyType(dict(self.between)))

    def __repr__(self) -> str:
        if self.failure is not None:
            return f"<Schedule: no plan, {self.failure.reason.value}>"
        late = f"tolerates {self.tolerates:.2f} s of delay"
        return f"<Schedule: {len(self.chains)} picks in {self.duration:.2f} s, {late}>"

    def __str__(self) -> str:
        if self.failure is not None:
            return f"no schedule: {self.failure}"
        late = "one arm moves" if self.tolerates == math.inf else f"tolerates {self.tolerates:.3f} s of delay"
        title = (
            f"{len(self.chains)} picks in {self.duration:.2f} s, {self.sequential:.2f} s one after the other; {late} "
            f"({self.rectangles:,} rectangles, {self.distances:,} bounds)"
        )
        chains = sorted(self.chains, key=lambda each: each.start)
        return "\n".join([title, *(f"  {c.arm}: {c.job.object}, from {c.start:.2f} to {c.end:.2f} s" for c in chains)])

    @property
    def ok(self) -> bool:
        """Whether all jobs are in it."""
        return self.failure is None

    @property
    def duration(self) -> float:
        """Seconds until all arms are back: the makespan."""
        return max((chain.end for chain in self.chains), default=0.0)

    @property
    def sequential(self) -> float:
        """Seconds that the same chains take, one after the other, whichever arm does each."""
        return math.fsum(chain.seconds for chain in self.chains)

    def of_arm(self, name: str) -> tuple[Chain, ...]:
        """What an arm does, in its order; nothing for one without a job."""
        return tuple(sorted((each for each in self.chains if each.arm == name), key=lambda each: each.start))

    def joints(self, name: str, t: ArrayLike) -> FloatArray:
        """Where an arm is at times t >= 0 by its own clock, shape (..., n).

        Raises:
            PlanningFailed: There is no plan.
            UnknownName: No such arm.
            InvalidRequest: Times are no numbers.
        """
        if self.failure is not None:
            raise PlanningFailed(self.failure)
        if not isinstance(name, str) or name not in self.starts:
            raise UnknownName("arm", name, self.starts)
        times = numbers("t", t, "seconds")
        q = np.repeat(self.starts[name][None], times.size, axis=0)
        for chain in self.of_arm(name):
            rows = times.reshape(-1) >= chain.start
            q[rows] = chain(times.reshape(-1)[rows])
        return q.reshape(*times.shape, -1)
