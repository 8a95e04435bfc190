"""What a checker that is not ours says of a path: Coal, asked about every configuration at a stated step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import planner_service as ps
from auditor.checker import IndependentChecker, Touch, tables_of
from auditor.constraints import Range, Region
from planner_service.constraints import Constraint, JointRange
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray

__all__ = ["JOINT_STEP", "NOT_ASKED", "Auditor", "Pair", "along", "audited", "between", "independent", "inside"]
__all__ += ["instants", "stretches", "touch_in_time", "touch_of_plan", "touch_on_curve", "worst"]

JOINT_STEP = 0.01
"""Radians (metres of a slide) that any joint moves from one audited configuration to the next, at most."""

INSIDE = 1e-9
"""Path length left out on both sides of where pairs begin to be allowed to touch."""

Pair = tuple[str, str]

NOT_ASKED: Mapping[str, Any] = {"step": None, "verdict": "not_asked", "depth": None, "pair": None}
"""The audit of a run without a path."""


class Auditor:
    """Judges configurations of one robot in one scene.

    Args:
        robot: The name of a robot, the path of its robot.toml, or what the independent checker needs of any other.
        gripper_width: Metres between the finger pads; what robot.toml says if None.
        allowed: Pairs of names that may touch, beside those of robot.toml.
    """

    def __init__(
        self,
        robot: str | Mapping[str, Any],
        scene: ps.Scene,
        *,
        gripper_width: float | None = None,
        allowed: Sequence[tuple[str, str]] = (),
    ) -> None:
        told: Path | Mapping[str, Any] = (
            robot
            if not isinstance(robot, str)
            else Path(robot).parent
            if robot.endswith(".toml")
            else data_folder("robots") / robot
        )
        self._scene = tables_of(scene)
        self._make: Callable[[Sequence[tuple[str, str]]], IndependentChecker] = lambda pairs: IndependentChecker(
            told, self._scene, gripper_width=gripper_width, allowed=pairs
        )
        self._checker = self._make(allowed)

    def judge(self, Q: FloatArray, step: float = JOINT_STEP) -> dict[str, Any]:
        """The ``audit`` of a row, of configurations (m, n) that are at most ``step`` apart.

        The deepest overlap is by Coal's distance, right to about a micrometre, now and then wrong by more.
        """
        told: dict[str, Any] = {**NOT_ASKED, "step": step, "verdict": "free"}
        for q in Q:
            touch = self._checker.touch(q)
            if touch is None:
                continue
            if touch.b == "limit":
                return {**told, "verdict": "outside_limits", "pair": [touch.a, touch.b]}
            gaps = self._checker.gaps(q)
            pair = min(gaps, key=lambda names: gaps[names])
            if told["depth"] is None or -gaps[pair] > told["depth"]:
                told |= {"verdict": "colliding", "depth": -gaps[pair], "pair": list(pair)}
        return told

    def tool_pose(self, q: ArrayLike) -> FloatArray:
        """Pose of the tool frame in the base frame at q (n,), shape (4, 4), by Pinocchio."""
        return self._checker.tool_pose(q)

    def clearance(self, Q: FloatArray) -> float:
        """The smallest of Coal's distances at configurations (m, n), in metres; negative where something overlaps."""
        return min((min(self._checker.gaps(q).values(), default=math.inf) for q in Q), default=math.inf)


def along(
    curve: Callable[[Any], FloatArray], start: float, end: float, step: float = JOINT_STEP, length: float | None = None
) -> FloatArray:
    """Configurations (m, n) of a curve from start to end, no joint moving more than ``step`` from one to the next.

    Args:
        length: Of the curve, where it is not ``end - start``.
    """
    count = 2 + math.ceil((end - start if length is None else length) / step)
    while True:
        Q: FloatArray = curve(np.linspace(start, end, count))
        if float(np.abs(np.diff(Q, axis=0)).max(initial=0.0)) <= step:
            return np.asarray(Q)
        count *= 2


def between(waypoints: ArrayLike, step: float = JOINT_STEP) -> FloatArray:
    """Configurations (m, n) of a polyline (N, n), its waypoints among them, no joint moving more than ``step``."""
    points = np.asarray(waypoints, dtype=np.float64)
    parts = [points[:1]]
    for a, b in pairwise(points):
        count = max(1, math.ceil(float(np.abs(b - a).max()) / step))
        parts.append(a + (b - a) * (np.arange(1, count + 1)[:, None] / count))
    return np.concatenate(parts)


def audited(robot: ps.Robot, constraint: Constraint) -> Region | Range:
    """The same constraint for the checker that is not ours."""
    if isinstance(constraint, JointRange):
        return Range(constraint.joint, constraint.lower, constraint.upper)
    return Region(
        robot.tool_frame if constraint.link is None else constraint.link,
        constraint.tool.matrix,
        constraint.relative_to,
        constraint.frame.matrix,
        constraint.lower,
        constraint.upper,
        constraint.tilt,
        constraint.turn,
        constraint.name,
    )


def independent(robot: str, scene: ps.Scene) -> IndependentChecker:
    """The checker that is not ours, for a robot that comes with the package."""
    return IndependentChecker(data_folder("robots") / robot, tables_of(scene))


def instants(trajectory: ps.Trajectory, step: float = JOINT_STEP) -> FloatArray:
    """Configurations (m, n) of a motion, no joint turning more than ``step`` (rad) from one to the next."""
    return along(trajectory, 0.0, trajectory.duration, step, trajectory.path.length)


def touch_in_time(second: IndependentChecker, trajectory: ps.Trajectory, step: float = JOINT_STEP) -> str | None:
    """What touches first in the course of a motion, as ``a x b``; None if nothing does."""
    return _in_words(next((second.touch(q) for q in instants(trajectory, step) if not second.free(q)), None))


def touch_on_curve(second: IndependentChecker, path: ps.JointPath, motion_step: float) -> str | None:
    """The same of a curve, no point of the robot moving farther than ``motion_step`` (m) between two looks."""
    return _in_words(second.curve_touch(path, path.length, motion_step))


def touch_of_plan(
    judge: Callable[[tuple[Pair, ...]], IndependentChecker], result: ps.PlanResult, motion_step: float
) -> str | None:
    """The same of a plan's curve, None of no plan; on a way out of a contact the plan's own pairs may touch.

    Args:
        judge: Gives the checker for which these pairs may touch.
    """
    path = result.path
    if path is None:
        return None
    for first, last, pairs in stretches(
        ((each.s_start, each.s_end, each.pairs) for each in result.exempt), path.length
    ):
        start, end = inside(first, last, path.length)
        touch = judge(pairs).curve_touch(partial(_moved, path, start), end - start, motion_step)
        if touch is not None:
            return _in_words(touch)
    return None


def _moved(path: ps.JointPath, start: float, s: Any) -> FloatArray:
    return path(start + s)


def _in_words(touch: Touch | None) -> str | None:
    return None if touch is None else f"{touch.a} x {touch.b}"


def stretches(
    exempt: Iterable[tuple[float, float, Iterable[Pair]]], length: float
) -> Iterator[tuple[float, float, tuple[Pair, ...]]]:
    """A curve from cut to cut, with the pairs that may touch there.

    Args:
        exempt: From where to where on the curve which pairs may touch.
    """
    listed = [(start, end, tuple(pairs)) for start, end, pairs in exempt]
    cuts = sorted({0.0, length, *(cut for start, end, _ in listed for cut in (start, end))})
    for first, last in zip(cuts, cuts[1:] or cuts, strict=False):
        middle = (first + last) / 2
        yield first, last, tuple(pair for start, end, pairs in listed if start <= middle <= end for pair in pairs)


def inside(first: float, last: float, length: float) -> tuple[float, float]:
    """A stretch without the very places at which pairs begin, or cease, to be allowed to touch."""
    start = first + (INSIDE if first > 0.0 else 0.0)
    return start, max(start, last - (INSIDE if last < length else 0.0))


def worst(audits: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """One audit of several pieces: the worst of them."""
    order = ("not_asked", "free", "colliding", "outside_limits")
    return dict(max(audits, key=lambda a: (order.index(a["verdict"]), a["depth"] or 0.0), default=NOT_ASKED))
