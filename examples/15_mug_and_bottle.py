"""Take a bottle from the side and a mug by its handle: under a board the gripper has no room above them.

Run: python examples/15_mug_and_bottle.py
"""

from __future__ import annotations

import math

from planner_service import (
    Box,
    Compound,
    Cylinder,
    Handling,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    TaskResult,
    load_scene,
)
from planner_service.tasks import Task, pick_steps

FOOT = 0.0001  # what stands on the table is this far above it, in metres
BOTTLE = Compound(
    (
        (Cylinder(radius=0.028, length=0.10), Pose((0.0, 0.0, 0.05))),
        (Cylinder(radius=0.013, length=0.05), Pose((0.0, 0.0, 0.125))),
    )
)


def mug(radius: float = 0.045, wall: float = 0.004, height: float = 0.09, staves: int = 16) -> Compound:
    """A mug: its bottom, a wall of flat staves, and a handle of three bars on the side of -x."""
    wide = 2.0 * (radius + wall / 2.0) * math.tan(math.pi / staves)
    pieces: list[tuple[Box | Cylinder, Pose]] = [(Cylinder(radius, wall), Pose((0.0, 0.0, wall / 2.0)))]
    for k in range(staves):
        turn = 2.0 * math.pi * k / staves
        at = (radius * math.cos(turn), radius * math.sin(turn), height / 2.0)
        pieces.append((Box((wall, wide, height)), Pose(at, (math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2)))))
    pieces.append((Box((0.008, 0.012, 0.066)), Pose((-radius - 0.030, 0.0, height / 2.0))))
    arm = Box((0.030, 0.012, 0.008))
    pieces += [(arm, Pose((-radius - 0.015, 0.0, height / 2.0 + z))) for z in (-0.029, 0.029)]
    return Compound(tuple(pieces))


def cell() -> PlannerService:
    """A bottle and a mug on a table, under a board."""
    scene = load_scene("table")
    parts: dict[str, tuple[Box | Compound, tuple[float, float, float], str | None]] = {
        "bottle": (BOTTLE, (0.38, 0.14, FOOT), "#4a7d5e"),
        "mug": (mug(), (0.40, -0.12, FOOT), "#c86432"),
        "board": (Box((0.24, 0.56, 0.012)), (0.44, 0.0, 0.256), None),
        "post_left": (Box((0.24, 0.012, 0.25)), (0.44, 0.28, 0.125), None),
        "post_right": (Box((0.24, 0.012, 0.25)), (0.44, -0.28, 0.125), None),
    }
    for name, (shape, at, colour) in parts.items():
        scene = scene.with_obstacle(Obstacle(name, shape, Pose(at), colour=colour))
    return PlannerService("wxai", scene)


def take(service: PlannerService, name: str) -> TaskResult:
    """What is on the shelf, taken in whichever way has a plan."""
    task, home = Task(pick_steps(name, None, Handling(support="table")), f"take the {name}"), service.robot.home
    return service.solve(task, home, request=PlanRequest(home, home, time_limit=None))  # antipodal grasps take a second


def main() -> None:
    """Take each of them, and say how."""
    service = cell()
    for name in ("bottle", "mug"):
        done = take(service, name)
        print(f"{name}: {done.failure or done.notes[0]}")


if __name__ == "__main__":
    main()
