"""Arms as compiled inverse kinematics and straight tool lines know them.

Arms built like the WidowX AI have a closed form (native/kinematics/line.cpp). Such an arm has a joint about z (the
waist), three about parallel y axes (shoulder, elbow, forearm), and one about z and one about x whose axes cross in a
point W (the wrist); nothing is offset sideways. The tool pose alone determines W, which lies in the arm's vertical
plane and so gives the waist angle. In that plane, the direction of the tool's approach axis gives the wrist's two
angles and the forearm's pitch. What remains is a planar chain of two links. A point of the plane is the complex number
x + i z; a rotation by b about y multiplies it by exp(-i b).
"""

from __future__ import annotations

import cmath
import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, Vector, vector
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.numeric_inverse import STEPS, Bounds, Descent, length_scale
from planner_service.native.loading import load_core
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import Body, Robot

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["descended", "tool_arm"]

STRAIGHT = 1e-12
"""How far an axis or a sideways offset of the model may differ from the ideal: by the rounding of written numbers."""

AXES: tuple[int, ...] = (2, 1, 1, 1, 2, 0)


@lru_cache(maxsize=32)
def tool_arm(robot: Robot, *, numeric: bool = False) -> _core.ToolArm:
    """A robot's arm as compiled code knows it, with its closed form if ``robot.inverse`` says that it has one.

    Args:
        numeric: Leave that out: only an arm alone has a closed form, not a robot of two.

    Raises:
        InvalidRequest: The robot is built differently from what its closed form needs.
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
        [] if numeric or robot.inverse != "wxai" else _closed_form(robot),
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
    arm = tool_arm(robot, numeric=True)
    rows = [value for row, x in zip(pose.rotation_rows, pose.position, strict=True) for value in (*row, x)]
    lower, upper = bounds or (robot.limits.lower, robot.limits.upper)
    q, arrived = arm.descend(np.array(rows), np.ascontiguousarray(starts, dtype=np.float64), lower, upper, STEPS)
    return Descent(q, np.array(arrived, dtype=np.bool_).ravel())


def _closed_form(robot: Robot) -> list[float]:
    """The numbers of ``ClosedForm`` in native/kinematics/line.hpp, in its order.

    Raises:
        InvalidRequest: The robot is built differently.
    """
    (sx, _, sz), (ux, _, uz), (fx, _, fz), (gx, _, gz), (last, _, lift) = _checked_offsets(robot)
    upper, fore = complex(ux, uz), complex(fx, fz)  # from shoulder to elbow, and from there to the forearm's joint
    hand = gx, gz + lift  # from there to the wrist, whose two axes cross at the height of the last one
    fold = upper.conjugate() * fore
    first, tool = robot.bodies[1].placement[:3], robot.tool_placement[:3]
    signs = [float(body.axis[axis]) for body, axis in zip(robot.bodies[1:], AXES, strict=True)]
    squares = [link.real * link.real + link.imag * link.imag for link in (upper, fore)]
    return [
        *(sx, sz, ux, uz, fx, fz, *hand, last, *signs, *robot.limits.lower.tolist(), *robot.limits.upper.tolist()),
        *first[:, :3].T.ravel().tolist(),  # the waist's axes at q = 0, as rows
        *(*first[:, 3].tolist(), *tool[:, :3].ravel().tolist(), *tool[:, 3].tolist()),
        *(*squares, abs(fold), cmath.phase(fold)),
    ]


def _checked_offsets(robot: Robot) -> list[Vector]:
    """The position of each joint but the first in its parent's frame."""
    bodies = robot.bodies
    problems = []
    if len(bodies) != 7 or robot.tool_body != 6 or [b.parent for b in bodies] != list(range(-1, 6)):
        problems.append("a chain of six joints, the tool on the last")
    else:
        if [body.q_index for body in bodies[1:]] != list(range(6)):
            problems.append("joints listed from the base to the tool")
        for body, axis in zip(bodies[1:], AXES, strict=True):
            unit = [abs(v) for v in body.axis.tolist()]
            if body.prismatic or any(abs(v - (i == axis)) > STRAIGHT for i, v in enumerate(unit)):
                problems.append(f"{body.name} turning about its {'xyz'[axis]} axis")
        problems += [f"{body.name} placed without turn or sideways offset" for body in bodies[2:] if not _plain(body)]
    if problems:
        needs = "; ".join(problems)
        raise InvalidRequest("inverse", robot.inverse, f"'numeric' for robot {robot.name!r}: 'wxai' needs {needs}")
    return [vector(body.placement[:3, 3].tolist()) for body in bodies[2:]]


def _plain(body: Body) -> bool:
    placement = body.placement.tolist()
    turned = any(abs(placement[i][j] - (i == j)) > STRAIGHT for i in range(3) for j in range(3))
    return not turned and abs(placement[1][3]) <= STRAIGHT
