"""Carry something heavy: what its weight costs in time, and where the arm cannot hold it.

Run: python examples/10_payload.py
"""

from __future__ import annotations

from planner_service import PlannerService, PlanRequest, ToppRa
from planner_service.robot import Payload

FOLDED, STRETCHED = [0.0, -0.2, 0.0, -2.2, 0.0, 2.0, 0.8], [1.2, 0.9, 0.0, -1.0, 0.0, 1.9, 0.8]


def main() -> None:
    """Plan one motion of a Panda with heavier and heavier loads, and print how close joints come to their torques."""
    service = PlannerService("panda", "table")
    for mass in (0.0, 2.0, 4.0, 6.0):
        load = Payload(mass, com=(0.0, 0.0, 0.05))
        result = service.plan(PlanRequest(FOLDED, STRETCHED, timing=ToppRa(torque=True), payload=load))
        if result.motion is None:
            print(f"{mass:g} kg: {result.failure}")
            continue
        highest = max(result.motion.peaks.torques)
        joint = service.robot.joint_names[highest.joint]
        print(f"{mass:g} kg: {result.motion.duration:.3f} s, {joint} uses {highest.ratio:.1%} of its torque")


if __name__ == "__main__":
    main()
