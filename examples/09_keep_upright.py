"""Keep a cup upright: the same motion with and without a constraint, and how far the cup tilts on each.

Run: python examples/09_keep_upright.py
"""

from __future__ import annotations

import math

import numpy as np

from planner_service import PlannerService, PlanRequest, Pose, inverse_kinematics
from planner_service.constraints import KeepUpright

TOOL_DOWN = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""A quaternion (w, x, y, z) with which the tool's x axis points down."""

UPRIGHT = KeepUpright(tool_axis=(-1, 0, 0), tolerance=0.1)


def main() -> None:
    """Plan from one side of a post to the other, and print the largest tilt of the tool on the way."""
    service = PlannerService("wxai", "post")
    start = inverse_kinematics(service.robot, Pose((0.25, -0.2, 0.12), TOOL_DOWN))[0]
    for words, constraints in (("without", []), ("with", [UPRIGHT])):
        request = PlanRequest(start, Pose((0.25, 0.2, 0.12), TOOL_DOWN), seed=7, constraints=constraints)
        _, trajectory = (result := service.plan(request)).unwrap()
        times = np.linspace(0.0, trajectory.duration, 2000)
        ups = [-service.robot.tool_pose(trajectory(t))[2, 0] for t in times]  # how far up the tool's -x axis points
        tilt = max(math.acos(min(1.0, up)) for up in ups)
        print(f"{words} a constraint: tilted by up to {tilt:.3f} rad, {trajectory.duration:.2f} s, {result.counts}")


if __name__ == "__main__":
    main()
