"""How far a curve departs from constraints, by kinematics that are not ours: Pinocchio's, sampled along the curve."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from auditor.checker import IndependentChecker
from planner_service.constraints import Constraint, JointRange, ToolRegion
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot

__all__ = ["largest_share", "shares"]


def largest_share(second: IndependentChecker, robot: Robot, given: Sequence[Constraint], samples: FloatArray) -> float:
    """The largest part of a tolerance that is used at configurations (m, n); 1 at a bound, more beyond it."""
    return max((float(each.max()) for each in shares(second, robot, given, samples)), default=0.0)


def shares(
    second: IndependentChecker, robot: Robot, given: Sequence[Constraint], samples: FloatArray
) -> Iterator[FloatArray]:
    """The part of each tolerance that is used at configurations (m, n), (m,) each.

    A distance from the middle over half the width, or an angle over its bound; of what is bounded on one side alone,
    1 plus the metres beyond it.
    """
    regions = [constraint for constraint in given if isinstance(constraint, ToolRegion)]
    links = {link for r in regions for link in (r.link or robot.tool_frame, r.relative_to) if link is not None}
    poses = _poses(second, robot, sorted(links), samples)
    for constraint in given:
        if isinstance(constraint, JointRange):
            joint = robot.joint_names.index(constraint.joint)
            yield _part(samples[:, joint], constraint.lower, constraint.upper)
    for region in regions:
        base = np.eye(4) if region.relative_to is None else poses[region.relative_to]
        tool = poses[region.link or robot.tool_frame] @ region.tool.matrix
        T = np.linalg.inv(base @ region.frame.matrix) @ tool
        for k, (low, high) in enumerate(zip(region.lower, region.upper, strict=True)):
            if math.isfinite(low) or math.isfinite(high):
                yield _part(T[:, k, 3], low, high)
        if region.tilt is not None:
            yield np.arctan2(np.hypot(T[:, 0, 2], T[:, 1, 2]), T[:, 2, 2]) / region.tilt
        if region.turn is not None:  # the twist about z, of the quaternion's w and z times 4 w
            w, z = 1.0 + T[:, 0, 0] + T[:, 1, 1] + T[:, 2, 2], T[:, 1, 0] - T[:, 0, 1]
            yield 2.0 * np.arctan2(np.abs(z), w) / region.turn


def _part(values: FloatArray, lower: float, upper: float) -> FloatArray:
    if math.isfinite(lower) and math.isfinite(upper):
        return np.abs(2.0 * values - lower - upper) / (upper - lower)
    return 1.0 + np.maximum(lower - values, values - upper)


def _poses(
    second: IndependentChecker, robot: Robot, links: Sequence[str], samples: FloatArray
) -> dict[str, FloatArray]:
    """The poses of links' frames in the base frame at configurations (m, n), (m, 4, 4) each."""
    model, data = second.model, second.model.createData()
    frames = [model.getFrameId(link) for link in links]
    Q = np.zeros((len(samples), model.nq))
    Q[:, [model.joints[model.getJointId(name)].idx_q for name in robot.joint_names]] = samples
    out = np.empty((len(links), len(samples), 4, 4))
    for k, q in enumerate(Q):
        pin.framesForwardKinematics(model, data, q)
        for i, frame in enumerate(frames):
            out[i, k] = data.oMf[frame].homogeneous
    return dict(zip(links, out, strict=True))
