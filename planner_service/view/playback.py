"""Motions on one clock: a plan, or the motions of a task one after another, each with its own gripper and scene."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner_service.certify import ExemptInterval
from planner_service.geometry.shapes import FloatArray
from planner_service.path.trajectory import Trajectory
from planner_service.planning.result import PlanResult
from planner_service.service import PlannerService
from planner_service.tasks.result import Segment
from planner_service.view.collision_report import Eye

__all__ = ["Moment", "Reel", "Samples", "Take"]

SAMPLES = 400
"""Instants of a plot."""

Pairs = frozenset[tuple[str, str]]


@dataclass(frozen=True, eq=False)
class Take:
    """One motion.

    Attributes:
        service: Plans for the robot and the scene as they are during it.
        exempt: Stretches of its path on which named pairs may touch.
        begin: Seconds on the reel's clock.
    """

    name: str
    service: PlannerService
    trajectory: Trajectory
    exempt: tuple[ExemptInterval, ...]
    begin: float

    @property
    def end(self) -> float:
        """Seconds on the reel's clock."""
        return self.begin + self.trajectory.duration

    @cached_property
    def eye(self) -> Eye:
        """Judges its configurations."""
        return Eye(self.service)

    def meant(self, t: float) -> Pairs:
        """Pairs that may touch, t seconds after it began."""
        s = float(self.trajectory.s(t))
        return frozenset(pair for part in self.exempt if part.s_start <= s <= part.s_end for pair in part.pairs)


class Moment(NamedTuple):
    """An instant of a reel: the motion, the seconds since that began, where the robot is (n,), what may touch."""

    take: Take
    t: float
    q: FloatArray
    meant: Pairs


class Samples(NamedTuple):
    """A reel at m instants ``t``: parts of the limits from -1 to 1, (m, n) each, and proven clearances in metres, (m,).

    Of positions -1 is the lower limit and 1 the upper one.
    """

    t: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    clearance: FloatArray


@dataclass(frozen=True, eq=False)
class Reel:
    """One or more motions, one after another; what a gripper takes to open or close is left out."""

    takes: tuple[Take, ...]

    @classmethod
    def of_result(cls, service: PlannerService, result: PlanResult) -> Reel | None:
        """The motion of a plan that a service made; None without one."""
        if result.trajectory is None:
            return None
        return cls((Take("plan", service, result.trajectory, result.exempt, 0.0),))

    @classmethod
    def of_task(cls, service: PlannerService, segments: Sequence[Segment]) -> Reel | None:
        """The motions of a task, as far as there are plans; None without any.

        Args:
            service: For the beginning of the task.
        """
        takes = list[Take]()
        here, clock = service, 0.0
        for segment in segments:
            result = segment.result
            if result.trajectory is None:
                break
            world = segment.world_after(here.world)
            here = here if world is here.world else PlannerService.of(world)
            takes.append(Take(segment.name, here, result.trajectory, result.exempt, clock))
            clock = takes[-1].end
        return cls(tuple(takes)) if takes else None

    @property
    def duration(self) -> float:
        """Seconds of motion."""
        return self.takes[-1].end

    @cached_property
    def _begins(self) -> list[float]:
        return [take.begin for take in self.takes]

    def at(self, t: float) -> Moment:
        """Where the robot is after t seconds; before the beginning at the start, after the end at the goal."""
        take = self.takes[max(0, bisect_right(self._begins, t) - 1)]
        inside = min(max(t - take.begin, 0.0), take.trajectory.duration)
        return Moment(take, inside, take.trajectory(inside), take.meant(inside))

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """The first and the last configuration, each (n,)."""
        return self.at(0.0).q, self.at(self.duration).q

    @cached_property
    def samples(self) -> Samples:
        """What is plotted."""
        parts = [_sampled(take, self.duration) for take in self.takes]
        return Samples(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _sampled(take: Take, whole: float) -> Samples:
    count = max(3, round(SAMPLES * take.trajectory.duration / whole)) if whole > 0.0 else 2
    t: FloatArray = np.linspace(0.0, take.trajectory.duration, count, dtype=np.float64)
    q, qd, qdd = (take.trajectory(t, order) for order in (0, 1, 2))
    limits = take.service.robot.limits
    middle, half = (limits.lower + limits.upper) / 2.0, (limits.upper - limits.lower) / 2.0
    inside = np.minimum(np.maximum(q, limits.lower), limits.upper)
    meant = [take.meant(at) for at in t.tolist()]
    clearance = np.zeros(count)
    for pairs in set(meant):
        rows: NDArray[np.bool_] = np.array([other == pairs for other in meant])
        clearance[rows] = take.eye.clearances(inside[rows], pairs)
    return Samples(t + take.begin, (q - middle) / half, qd / limits.velocity, qdd / limits.acceleration, clearance)
