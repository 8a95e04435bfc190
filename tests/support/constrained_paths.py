"""Paths that keep a constraint, by projection with differences: slow, and with faults to plant.

Kinematics are those of ``Robot``; neither the proof nor the auditor uses them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planner_service.constraints import ToolRegion
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot

__all__ = ["Walker", "rounded"]

INSIDE = 0.5
"""Projected configurations keep to this share of each tolerance."""

STEP = 1e-6


def rounded(path: JointPath, share: float = 0.4) -> JointPath:
    """With blends that take a share of the pieces beside them, except where the path turns back."""
    lengths = np.diff(path.knots)
    inner = range(1, len(path.waypoints) - 1)
    widths = [0.0 if path.turns_back(k) else share * float(min(lengths[k - 1], lengths[k])) for k in inner]
    return path.with_blends([0.0, *widths, 0.0])


@dataclass(frozen=True)
class Walker:
    """Random paths of a robot on a region.

    Attributes:
        step: Distance of waypoints, in joint space.
        seen: What the walker takes the constrained frame to be, given its true pose in the frame of the region; a fault
            that is planted.
    """

    robot: Robot
    region: ToolRegion
    step: float
    seen: Callable[[FloatArray], FloatArray] = lambda pose: pose

    def path(self, rng: np.random.Generator, length: float) -> JointPath:
        """A blended path of about that length."""
        points = [self._start(rng)]
        way, walked, failed = rng.normal(size=self.robot.n), 0.0, 0
        while walked < length:
            way = way / math.sqrt(float((way * way).sum())) + 0.15 * rng.normal(size=self.robot.n)
            way /= math.sqrt(float((way * way).sum()))
            following = self._projected(points[-1] + self.step * way)
            moved = 0.0 if following is None else math.dist(following, points[-1])
            if following is None or not 0.3 * self.step < moved < 2.0 * self.step:
                way, failed = rng.normal(size=self.robot.n), failed + 1
                if failed > 200:
                    return self.path(rng, length)
                continue
            way = following - points[-1]
            walked += moved
            points.append(following)
        return rounded(JointPath(np.array(points)))

    def _start(self, rng: np.random.Generator) -> FloatArray:
        while True:
            q = self._projected(rng.uniform(self.robot.limits.lower, self.robot.limits.upper))
            if q is not None:
                return q

    def _projected(self, q: FloatArray) -> FloatArray | None:
        lower, upper = self.robot.limits.lower, self.robot.limits.upper
        q = np.clip(q, lower, upper)
        for _ in range(30):
            excess = self._excess(q)
            if np.abs(excess).max() < 1e-9:
                return q
            columns = [(self._excess(q + dq) - excess) / STEP for dq in np.eye(self.robot.n) * STEP]
            J = np.stack(columns, axis=1)
            q = np.clip(q - J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(len(excess)), excess), lower, upper)
        return None

    def _excess(self, q: FloatArray) -> FloatArray:
        """What exceeds the tolerances, as far as they are used."""
        region, pose = self.region, self.seen(self._pose(q))
        out: list[float] = []
        for k, (lower, upper) in enumerate(zip(region.lower, region.upper, strict=True)):
            if math.isfinite(lower) and math.isfinite(upper):
                out.append(_beyond(pose[k, 3] - (lower + upper) / 2.0, (upper - lower) / 2.0))
        if region.tilt is not None:
            x, y, z = pose[:3, 2].tolist()
            across = math.hypot(x, y)
            share = _beyond(math.atan2(across, z), region.tilt) / max(across, 1e-9)
            out += [x * share, y * share]
        if region.turn is not None:
            out.append(_beyond(math.atan2(pose[1, 0] - pose[0, 1], pose[0, 0] + pose[1, 1]), region.turn))
        return np.array(out)

    def _pose(self, q: FloatArray) -> FloatArray:
        region, bodies = self.region, self.robot.body_poses(q)

        def world(link: str | None) -> FloatArray:
            body, local = self.robot.link_frame(self.robot.tool_frame if link is None else link)
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = np.reshape(bodies[body][:9], (3, 3)), bodies[body][9:]
            return np.asarray(T @ local)

        inner = region.frame.matrix if region.relative_to is None else world(region.relative_to) @ region.frame.matrix
        return np.asarray(np.linalg.inv(inner) @ world(region.link) @ region.tool.matrix)


def _beyond(value: float, tolerance: float) -> float:
    return math.copysign(max(0.0, abs(value) - INSIDE * tolerance), value)
