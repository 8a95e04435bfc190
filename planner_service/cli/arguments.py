"""What the command line's texts mean: configurations, goals, planners, timing laws."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry import FloatArray, Pose
from planner_service.optimize import Optimise
from planner_service.plan_file import TIMINGS
from planner_service.planners import PLANNERS, Planner, planner_by_name
from planner_service.robot import Robot
from planner_service.timing import Timing

__all__ = ["configuration", "goals", "optimise", "planner_or_optimise", "timing_by_name"]

_POSE = "pose:"


def configuration(option: str, text: str, robot: Robot) -> FloatArray:
    """The named pose of a robot, or as many comma-separated joint values as it has, shape (n,).

    Raises:
        InvalidRequest: neither; what is finite or within limits is not asked here.
    """
    numbers = _numbers(text)
    if numbers is None:
        if "," in text:
            raise InvalidRequest(option, text, f"{robot.n} numbers, separated by commas")
        try:
            return robot.pose(text)
        except UnknownName as error:
            message = f"{option}: {error}, or give {robot.n} joint values, separated by commas"
            raise InvalidRequest(option, text, "a named pose or joint values", message=message) from None
    if len(numbers) != robot.n:
        message = f"{option}: got {len(numbers)} values ({text}); expected {robot.n}: {', '.join(robot.joint_names)}"
        raise InvalidRequest(option, text, f"{robot.n} joint values", message=message)
    return np.array(numbers)


def goals(texts: Sequence[str], robot: Robot) -> FloatArray | Pose | tuple[FloatArray | Pose, ...]:
    """The goal, or the tuple of them, that ``PlanRequest`` takes: configurations, or ``pose:x,y,z,qw,qx,qy,qz``.

    Raises:
        InvalidRequest: a text is neither.
    """
    found = tuple(
        _goal(f"--goal ({k + 1} of {len(texts)})" if k else "--goal", text, robot) for k, text in enumerate(texts)
    )
    return found[0] if len(found) == 1 else found


def _goal(option: str, text: str, robot: Robot) -> FloatArray | Pose:
    if not text.startswith(_POSE):
        return configuration(option, text, robot)
    numbers = _numbers(text[len(_POSE) :])
    if numbers is None or len(numbers) != 7:
        raise InvalidRequest(option, text, f"{_POSE}x,y,z,qw,qx,qy,qz: metres, and a unit quaternion")
    x, y, z, qw, qx, qy, qz = numbers
    try:
        return Pose((x, y, z), (qw, qx, qy, qz))
    except InvalidRequest as error:
        raise InvalidRequest(option, text, error.expected, message=f"{option}: {error}") from None


def _numbers(text: str) -> list[float] | None:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return None


def optimise(clearance: float | None) -> Optimise:
    """An optimisation that keeps so many metres, or as many as it does by itself."""
    return Optimise() if clearance is None else Optimise(clearance=clearance)


def planner_or_optimise(name: str, clearance: float | None) -> Planner | Optimise:
    """The planner of that name (any case) with its default settings, ``optimise`` among them.

    Raises:
        UnknownName: there is none; the message offers the nearest.
        InvalidRequest: a clearance for a planner that takes none.
    """
    if name.lower() == Optimise().name:
        return optimise(clearance)
    if clearance is not None:
        raise InvalidRequest("--clearance", clearance, "--polish, or --planner optimise")
    if name.lower() not in PLANNERS:
        raise UnknownName("planner", name, [*PLANNERS, Optimise().name])
    return planner_by_name(name)


def timing_by_name(name: str) -> Timing:
    """The timing law of that name (any case) with its default settings.

    Raises:
        UnknownName: there is none; the message offers the nearest.
    """
    if name.lower() not in TIMINGS:
        raise UnknownName("timing law", name, TIMINGS)
    law: Timing = TIMINGS[name.lower()]()
    return law
