"""Execute a pick-and-place on the simulated arm, with the vendor's driver, and measure it.

Needs the extra sim: pip install 'planner-service[sim]'. Run: python examples/08_execute_in_simulation.py
"""

from __future__ import annotations

import math

from planner_service import PlannerService, PlanRequest, load_robot, load_scene
from planner_service.execute import SimulatedArm, Streaming, rehearse
from planner_service.tasks import plan_pick_place

PADDING = 0.005
"""Metres that the plan keeps from everything, because the arm leaves its path by one to three millimetres."""


def main() -> None:
    """Move the block from the bin to the tray, and print how closely the arm followed the plan."""
    robot = load_robot("wxai")
    with SimulatedArm(robot, load_scene("bin"), loose=("blue_block",)) as arm:
        service = PlannerService(robot, arm.seen())
        request = PlanRequest(robot.home, robot.home, padding=PADDING)
        task = plan_pick_place(service, "blue_block", "tray", request)
        print(f"{task.task}: {task.failure or 'planned'}")
        if task.failure is not None:
            return
        done = rehearse(arm, task, robot, Streaming(latest=0.5, gripper_time=0.6))
    for motion in done.report.motions:
        final, off = motion.final_error.max() * 1000.0, motion.tool_off_path * 1000.0
        print(f"{motion.name:17} {motion.duration:.2f} s, ends {final:.1f} mrad off, at most {off:.1f} mm off its path")
    print(f"unexpected contacts: {len(done.contacts)}", *done.contacts, sep="\n")
    (x, y, _), (u, v, _) = done.loose["blue_block"].position, service.scene.obstacle("tray").pose.position
    print(f"the block is {math.hypot(x - u, y - v) * 1000.0:.1f} mm from the tray's middle")


if __name__ == "__main__":
    main()
