"""Goals of several arms that go together: where the ends of the arms' own plans touch, the nearest that do not."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice, product

import numpy as np

from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.planning.request import PlanRequest
from planner_service.robot.model import Robot

__all__ = ["goals_of", "together"]

EACH, MOST = 12, 400
"""Goals of an arm that are looked at, the nearest to its start, and combinations of these."""


def goals_of(robot: Robot, request: PlanRequest, own: FloatArray) -> list[FloatArray]:
    """Configurations that reach a goal of a request, from near its start to far: its own plan's end, what is given, and
    inverse kinematics of poses; of a ``PoseGoal`` its pose in the middle."""
    given = request.goal if isinstance(request.goal, tuple) else (request.goal,)
    start = np.asarray(request.start, dtype=np.float64)
    robot, out = robot.around(start), [own]
    for goal in given:
        if isinstance(goal, Pose | PoseGoal):
            pose = goal if isinstance(goal, Pose) else goal.pose
            rows: Sequence[FloatArray] = list(inverse_kinematics(robot, pose, seed=request.seed, seeds=[own]))
        else:
            rows = [np.asarray(goal, dtype=np.float64)]
        limits = robot.limits
        out += [q for q in rows if q.shape == own.shape and np.all((limits.lower <= q) & (q <= limits.upper))]
    distinct = list[FloatArray]()
    for q in out:
        if all(np.abs(q - other).max() > 1e-6 for other in distinct):
            distinct.append(q)
    distinct.sort(key=lambda q: joint_distance(start.tolist(), q.tolist()))
    return distinct[:EACH]


def together(
    goals: Mapping[str, Sequence[FloatArray]],
    starts: Mapping[str, FloatArray],
    free: Callable[[Mapping[str, FloatArray]], bool],
) -> Iterator[dict[str, FloatArray]]:
    """Combinations of goals, one of each arm, that are free, those first whose arm with the longest way has less to go.

    Args:
        free: Whether arms stand free at some goals.
    """
    ways = {name: [joint_distance(starts[name].tolist(), q.tolist()) for q in rows] for name, rows in goals.items()}
    choices = sorted(
        product(*(range(len(rows)) for rows in goals.values())),
        key=lambda picked: (
            max((ways[name][k] for name, k in zip(goals, picked, strict=True)), default=math.inf),
            sum(picked),
        ),
    )
    for picked in islice(choices, MOST):
        combined = {name: rows[k] for (name, rows), k in zip(goals.items(), picked, strict=True)}
        if free(combined):
            yield combined
