"""The joints between base and tool: what inverse kinematics may move of a robot that has others, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import FloatArray
from planner_service.robot.model import Robot

__all__ = ["ToolChain"]

LIMIT_SLACK = 1e-9
"""A joint value that far outside its limits (rad) is a rounding of the limit."""


@dataclass(frozen=True, eq=False)
class ToolChain:
    """A robot reduced to the joints that move its tool.

    Attributes:
        robot: It moves these joints alone and has no shapes; the whole robot where all of its joints move the tool.
        columns: Which entries of the whole robot's q they are.
        still: q (n,) of the whole robot, in which the other joints stay.
    """

    robot: Robot
    columns: Sequence[int]
    still: FloatArray

    @classmethod
    def of(cls, robot: Robot, still: FloatArray) -> ToolChain:
        """The chain of ``robot`` while its other joints stand as in ``still``, n finite numbers.

        Raises:
            InvalidRequest: no joint moves the tool, or a joint beside the chain stands outside its limits.
        """
        columns = _moving_the_tool(robot)
        if len(columns) == robot.n:
            return cls(robot, columns, still)
        if not columns:
            raise InvalidRequest("tool_frame", robot.tool_frame, "a tool that a joint moves; ask for joint values")
        standing = {}
        limits = zip(robot.limits.lower.tolist(), robot.limits.upper.tolist(), strict=True)
        for index, (name, value, (low, high)) in enumerate(zip(robot.joint_names, still.tolist(), limits, strict=True)):
            if index not in columns:
                if not low - LIMIT_SLACK <= value <= high + LIMIT_SLACK:
                    raise InvalidRequest(f"still: {name}", value, f"within [{low:.4f}, {high:.4f}]")
                standing[name] = low  # or anywhere: it moves nothing of the chain
        bare = replace(robot, shapes=(), gripper=None, retreats=())
        return cls(bare.locked(standing), columns, still)

    def of_whole(self, q: FloatArray) -> FloatArray:
        """The chain's part of configurations (..., n)."""
        return np.asarray(q[..., self.columns])

    def whole(self, Q: FloatArray) -> FloatArray:
        """Configurations (m, n) of the whole robot for such (m, k) of the chain."""
        out = np.repeat(self.still[np.newaxis], len(Q), axis=0)
        out[:, self.columns] = Q
        return out


def _moving_the_tool(robot: Robot) -> list[int]:
    found = []
    body = robot.tool_body
    while body > 0:
        found.append(robot.bodies[body].q_index)
        body = robot.bodies[body].parent
    return sorted(found)
