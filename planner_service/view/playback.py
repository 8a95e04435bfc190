"""Motions on one clock: a plan, or the motions of a task one after another, each with its own gripper and scene."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner_service.certify import ExemptInterval
from planner_service.geometry.arrays import FloatArray
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import Segment
from planner_service.service import PlannerService
from planner_service.timing.laws import tool_speeds
from planner_service.view.collision_report import CollisionReporter
from planner_service.view.regions import PLACES, Kept

__all__ = ["Clip", "Frame", "Playback", "Samples", "Span", "Timed"]

SAMPLES = 400
"""Points of a plot."""

Pairs = frozenset[tuple[str, str]]


class Timed(Protocol):
    """Where a robot is at each time of a motion: a trajectory, or what several arms do on their own clocks."""

    @property
    def duration(self) -> float:
        """Seconds."""

    def __call__(self, t: ArrayLike, order: int = 0) -> FloatArray:
        """q, or its derivative of an order, at times t, shape (..., n)."""

    def s(self, t: ArrayLike) -> FloatArray:
        """How far it has come at times t."""


@dataclass(frozen=True, eq=False)
class Clip:
    """One motion.

    Attributes:
        service: Plans for the robot and the scene as they are during this motion.
        exempt: Stretches of its path on which named pairs may touch.
        begin: When it begins, in seconds on the clock of the playback.
        kept: The constraints that it keeps; None if there are none.
    """

    name: str
    service: PlannerService
    trajectory: Timed
    exempt: tuple[ExemptInterval, ...]
    begin: float
    kept: Kept | None

    @classmethod
    def of(cls, name: str, service: PlannerService, result: PlanResult, begin: float) -> Clip:
        """The motion of a plan in the world of a service."""
        _, trajectory = result.unwrap()
        Q = trajectory(np.linspace(0.0, trajectory.duration, PLACES, dtype=np.float64))
        kept = Kept.of(service.robot, result.constraints, Q)
        return cls(name, service, trajectory, result.exempt, begin, kept)

    @property
    def end(self) -> float:
        """When it ends, in seconds on the clock of the playback."""
        return self.begin + self.trajectory.duration

    @cached_property
    def reporter(self) -> CollisionReporter:
        """Reports collisions during this motion."""
        return CollisionReporter(self.service)

    def clearances(self, t: FloatArray) -> FloatArray:
        """Proven clearances in metres t seconds (m,) after the motion began, but for pairs that may touch; (m,)."""
        q = np.clip(self.trajectory(t), *self.service.robot.bounds)
        expected = [self.expected(at) for at in t.tolist()]
        clearance = np.zeros(len(t))
        for pairs in set(expected):
            rows: NDArray[np.bool_] = np.array([other == pairs for other in expected])
            clearance[rows] = self.reporter.clearances(q[rows], pairs)
        return clearance

    def expected(self, t: float) -> Pairs:
        """Pairs that may touch t seconds after the motion began."""
        s = float(self.trajectory.s(t))
        return frozenset(pair for part in self.exempt if part.s_start <= s <= part.s_end for pair in part.pairs)


class Frame(NamedTuple):
    """One instant: the motion, the seconds since it began, the configuration (n,), and the pairs that may touch."""

    clip: Clip
    t: float
    q: FloatArray
    expected: Pairs


class Samples(NamedTuple):
    """A playback at m instants ``t``: fractions of the limits from -1 to 1, (m, n) each, proven clearances in metres,
    and speeds of the tool in metres per second, (m,) each. A position of -1 is the lower limit, 1 the upper one.
    """

    t: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    clearance: FloatArray
    speed: FloatArray


class Span(NamedTuple):
    """A part of the time in which an arm moves, or waits, in seconds."""

    begin: float
    end: float
    waits: bool


@dataclass(frozen=True, eq=False)
class Playback:
    """One or more motions, one after another; the time in which a gripper opens or closes is left out.

    Attributes:
        tools: Where tools go, (m, 3) each, where that is not one tool along one path.
        rows: Names of several arms, and of each when it moves and when it waits; empty of one.
    """

    clips: tuple[Clip, ...]
    tools: tuple[FloatArray, ...] = ()
    rows: tuple[tuple[str, tuple[Span, ...]], ...] = ()

    @classmethod
    def of_result(cls, service: PlannerService, result: PlanResult) -> Playback | None:
        """The motion of a plan made by a service; None if there is no plan."""
        return None if result.trajectory is None else cls((Clip.of("plan", service, result, 0.0),))

    @classmethod
    def of_task(cls, service: PlannerService, segments: Sequence[Segment]) -> Playback | None:
        """The motions of a task up to the first without a plan; None if there are none.

        Args:
            service: Plans for the beginning of the task.
        """
        clips = list[Clip]()
        clock = 0.0
        for segment in segments:
            if segment.result.trajectory is None:
                break
            world = segment.world_after(service.world)
            service = service if world is service.world else PlannerService.of(world)
            clips.append(Clip.of(segment.name, service, segment.result, clock + segment.wait))
            clock = clips[-1].end
        return cls(tuple(clips)) if clips else None

    @property
    def duration(self) -> float:
        """Seconds of motion."""
        return self.clips[-1].end

    @cached_property
    def _begins(self) -> list[float]:
        return [clip.begin for clip in self.clips]

    def at(self, t: float) -> Frame:
        """The robot after t seconds: at the start before the beginning, at the goal after the end."""
        clip = self.clips[max(0, bisect_right(self._begins, t) - 1)]
        since = min(max(t - clip.begin, 0.0), clip.trajectory.duration)
        return Frame(clip, since, clip.trajectory(since), clip.expected(since))

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """The first and the last configuration, each (n,)."""
        return self.at(0.0).q, self.at(self.duration).q

    @cached_property
    def samples(self) -> Samples:
        """The curves to plot."""
        parts = [_sampled(clip, t) for clip, t in zip(self.clips, self._instants, strict=True)]
        return Samples(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    @cached_property
    def used(self) -> dict[str, FloatArray]:
        """By name, how much of its tolerance each bounded quantity uses at the instants of ``samples``, (m,): from -1
        at a lower bound to 1 at an upper one; NaN while it is not bounded.
        """
        begins = np.cumsum([0, *map(len, self._instants)])
        out: dict[str, FloatArray] = {}
        for clip, t, first in zip(self.clips, self._instants, begins.tolist(), strict=False):
            if clip.kept is not None:
                for name, values in zip(clip.kept.names, clip.kept.used(clip.trajectory(t)).T, strict=True):
                    out.setdefault(name, np.full(begins[-1], np.nan))[first : first + len(t)] = values
        return out

    @cached_property
    def _instants(self) -> list[FloatArray]:
        """When each motion is sampled, in seconds since it began."""
        per_second = SAMPLES / self.duration if self.duration > 0.0 else 0.0
        ends = [clip.trajectory.duration for clip in self.clips]
        counts = [max(3, round(per_second * end)) if per_second else 2 for end in ends]
        return [np.linspace(0.0, end, count, dtype=np.float64) for end, count in zip(ends, counts, strict=True)]


def _sampled(clip: Clip, t: FloatArray) -> Samples:
    q, qd, qdd = (clip.trajectory(t, order) for order in (0, 1, 2))
    limits = clip.service.robot.around(q[0]).limits
    middle, half = (limits.lower + limits.upper) / 2.0, (limits.upper - limits.lower) / 2.0
    shares = (q - middle) / half, qd / limits.velocity, qdd / limits.acceleration
    return Samples(t + clip.begin, *shares, clip.clearances(t), tool_speeds(clip.service.robot, q, qd))
