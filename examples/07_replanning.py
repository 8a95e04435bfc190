"""Replan while moving: a robot passes a post that moves, and its motion is replanned ten times a second without a stop.

Run: python examples/07_replanning.py
"""

from __future__ import annotations

import numpy as np

from planner_service import PlannerService, PlanRequest, PlanResult, Pose, load_scene
from planner_service.replanning import Replanned

START = (1.02, 1.51, 1.35, -0.65, 0.06, -0.31)
GOAL = (-1.02, 1.51, 1.35, -0.65, 0.06, -0.31)
PERIOD = 0.1
"""Seconds between two updates of the scene."""


def main() -> None:
    """Replan until the robot has arrived, and print the outcome of each step."""
    service, world = PlannerService("wxai", "post"), load_scene("post")
    request = PlanRequest(START, GOAL, padding=0.02, max_checks=20_000)
    plan = service.plan(request)
    print(f"plan: {plan.unwrap()[1].duration:.2f} s")
    motion: PlanResult | Replanned = plan
    for step in range(100):
        scene = world.moved("post_ahead", Pose((0.3 + 0.01 * min(step, 12), 0.0, 0.25)))
        answer = service.replan(motion, at_time=0.0, latency=PERIOD, scene=scene, request=request)
        if motion.trajectory is None or answer.trajectory is None:
            print(f"{step * PERIOD:.1f} s: {answer.result.failure}")
            return
        before, after = motion.trajectory, answer.trajectory
        if before.duration <= PERIOD:
            print(f"{step * PERIOD:.1f} s: arrived")
            return
        jumps = [float(np.abs(before(PERIOD, order) - after(0.0, order)).max()) for order in range(3)]
        line = f"{answer.outcome.value}, {after.duration:.2f} s to go, {answer.counts.states} states"
        print(f"{step * PERIOD:.1f} s: {line}, largest jump {max(jumps):.0e}")
        motion = answer


if __name__ == "__main__":
    main()
