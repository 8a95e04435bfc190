"""What ssik finds, which solves arms of six turning joints in closed form: a reference that need not be installed.

It is given the axes of an arm at q = 0 and returns solutions but for whole turns; how an arm is best solved it finds
out by itself. ``pip install ssik==8.2.0`` puts it beside the study; the package does without.
"""

from __future__ import annotations

import importlib
import math
from importlib.util import find_spec
from typing import Any

import numpy as np

from planner_service import Pose, Robot
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.kinematic_tree import chain_to_base

__all__ = ["INSTALL", "ClosedForm", "installed"]

INSTALL = "pip install ssik==8.2.0"


def installed() -> bool:
    """Whether ssik can be asked."""
    return find_spec("ssik") is not None


class ClosedForm:
    """An arm as ssik knows it.

    Args:
        robot: Six joints, each of which turns one body of the chain from the base to the tool.
    """

    def __init__(self, robot: Robot) -> None:
        axes, origins = [], []
        T = np.eye(4)
        for index in reversed(chain_to_base(robot.bodies, robot.tool_body)):
            body = robot.bodies[index]
            T = T @ body.placement
            axes.append(math.copysign(1.0, body.multiplier) * (T[:3, :3] @ body.axis))
            origins.append(T[:3, 3])
        tool = T @ robot.tool_placement
        steps = np.diff(np.array([np.zeros(3), *origins, tool[:3, 3]]), axis=0)
        self._unturned = tool[:3, :3].T
        self._arm: Any = importlib.import_module("ssik").Manipulator.from_axes(np.array(axes), steps)

    @staticmethod
    def suits(robot: Robot) -> bool:
        """Whether ssik solves arms built like that one."""
        chain = [robot.bodies[index] for index in chain_to_base(robot.bodies, robot.tool_body)]
        turning = [body.q_index for body in chain if abs(body.multiplier) == 1.0 and not body.prismatic]
        return robot.n == 6 and sorted(turning) == list(range(6)) and len(chain) == 6

    def solve(self, pose: Pose) -> FloatArray:
        """All configurations that ssik finds, (k, n), within a turn and regardless of limits."""
        target = np.eye(4)
        target[:3, :3] = pose.rotation @ self._unturned
        target[:3, 3] = pose.position
        found = self._arm.solve(target, respect_limits=False, enumerate_windings=False)
        return np.array([solution.q for solution in found], dtype=np.float64).reshape(-1, 6)
