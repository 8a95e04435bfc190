"""Compiled inverse kinematics and straight tool lines."""

from __future__ import annotations

import cmath
import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.numeric_inverse import STEPS, Bounds, Descent, length_scale
from planner_service.kinematics.wxai_inverse import WxaiInverse
from planner_service.native.loading import load_core
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import Robot

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["descended", "tool_arm"]


@lru_cache(maxsize=16)
def tool_arm(robot: Robot, *, closed_form: bool = False) -> _core.ToolArm:
    """A robot's arm as compiled code knows it.

    Args:
        closed_form: Whether it walks by the closed form, which only an arm alone has, not a robot of two.
    """
    chain = [
        [index, body.q_index, body.prismatic, *body.axis.tolist(), body.multiplier]
        for index in chain_to_base(robot.bodies, robot.tool_body)
        for body in [robot.bodies[index]]
    ]
    arm: _core.ToolArm = load_core().ToolArm(
        robot.body_table,
        robot.tool_body,
        np.array(chain, dtype=np.float64).reshape(-1, 7),
        robot.tool_placement[:3].ravel(),
        length_scale(robot),
        robot.limits.lower,
        robot.limits.upper,
        _numbers(WxaiInverse.of(robot)) if closed_form else [],
        math.hypot,
    )
    return arm


def descended(robot: Robot, pose: Pose, starts: FloatArray, bounds: Bounds | None = None) -> Descent:
    """Move all starts towards configurations that bring the tool to ``pose``.

    Each takes damped steps towards it and ends at the pose, or after 40 of them.

    Args:
        starts: Shape (m, n).
        bounds: Lowest and highest joint values, (n,) each; the joint limits if None.
    """
    arm = tool_arm(robot)
    rows = [value for row, x in zip(pose.rotation_rows, pose.position, strict=True) for value in (*row, x)]
    lower, upper = bounds or (robot.limits.lower, robot.limits.upper)
    q, arrived = arm.descend(np.array(rows), np.ascontiguousarray(starts, dtype=np.float64), lower, upper, STEPS)
    return Descent(q, np.array(arrived, dtype=np.bool_).ravel())


def _numbers(form: WxaiInverse) -> list[float]:
    """In the order of ``ClosedForm`` in native/kinematics/line.hpp."""
    links = [part for link in (form.shoulder, form.upper, form.fore, form.hand) for part in (link.real, link.imag)]
    lower, upper = zip(*form.limits, strict=True)
    fold = form.upper.conjugate() * form.fore
    rows = [value for matrix in (form.waist, (form.base_offset,), form.tool) for row in matrix for value in row]
    squares = [link.real * link.real + link.imag * link.imag for link in (form.upper, form.fore)]
    return [
        *(*links, form.last, *form.signs, *lower, *upper),
        *(*rows, *form.tool_offset, *squares, abs(fold), cmath.phase(fold)),
    ]
