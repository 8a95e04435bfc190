"""The joints between base and tool, which inverse kinematics may move; a robot may have others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.presentation.measures import range_text
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import Robot

__all__ = ["ToolChain"]

LIMIT_SLACK = 1e-9
"""A joint value at most this far outside its limits (rad) is rounding."""


@dataclass(frozen=True, eq=False)
class ToolChain:
    """A robot reduced to the joints that move its tool.

    Attributes:
        robot: A robot of these joints alone, without shapes; the whole robot if all of its joints move the tool.
        columns: The entries of the whole robot's q that they are.
        still: q (n,) of the whole robot; the other joints stay at its values.
    """

    robot: Robot
    columns: Sequence[int]
    still: FloatArray

    @classmethod
    def of(cls, robot: Robot, still: FloatArray) -> ToolChain:
        """The chain of ``robot`` with its other joints at the values of ``still``, n finite numbers.

        Raises:
            InvalidRequest: No joint moves the tool, or a joint outside the chain is beyond its limits.
        """
        columns = sorted({robot.bodies[index].q_index for index in chain_to_base(robot.bodies, robot.tool_body)})
        if len(columns) == robot.n:
            return cls(robot, columns, still)
        if not columns:
            raise InvalidRequest("tool_frame", robot.tool_frame, "a tool that a joint moves; ask for joint values")
        locked = {}
        limits = zip(*(bound.tolist() for bound in robot.bounds), strict=True)
        for index, (name, value, (low, high)) in enumerate(zip(robot.joint_names, still.tolist(), limits, strict=True)):
            if index not in columns:
                if not low - LIMIT_SLACK <= value <= high + LIMIT_SLACK:
                    raise InvalidRequest(f"still: {name}", value, f"within {range_text(low, high, value)}")
                locked[name] = low  # any value will do: it does not move the chain
        bare = replace(robot, shapes=(), gripper=None, retreats=())
        return cls(bare.locked(locked), columns, still)

    def of_whole(self, q: FloatArray) -> FloatArray:
        """The chain's part of configurations (..., n)."""
        return np.asarray(q[..., self.columns])

    def whole(self, Q: FloatArray) -> FloatArray:
        """Configurations (m, n) of the whole robot for configurations (m, k) of the chain."""
        out = np.repeat(self.still[np.newaxis], len(Q), axis=0)
        out[:, self.columns] = Q
        return out
