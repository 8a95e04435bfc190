"""Open a drawer and a door: what the gripper holds moves with it, along a line and along an arc.

Run: python examples/13_doors_and_drawers.py
"""

from __future__ import annotations

import math

from planner_service import Box, Compound, Obstacle, PlannerService, Pose, Scene, TaskResult, load_scene
from planner_service.tasks import (
    Approach,
    Connect,
    Grasp,
    MoveCircular,
    MoveLinear,
    MoveTo,
    Release,
    Retreat,
    Step,
    Task,
)

FRONT, HEIGHT = 0.43, 0.16  # where the cabinet's front is, and how high the middle of what opens, in metres
WIDE, HIGH, DEEP = 0.20, 0.10, 0.20
GAP, WALL = 0.004, 0.012

BAR = Box((0.012, 0.012, 0.08))
"""A handle: an upright bar, which fingers take from either side."""


def main() -> None:
    """Open both, and say how far."""
    task = open_drawer()
    show(task)
    x = task.world.scene.obstacle("drawer").pose.position[0]
    print(f"the drawer is {(FRONT - x) * 1000:.0f} mm open\n")
    task = open_door()
    show(task)
    w, *_, z = task.world.scene.obstacle("door").pose.quaternion
    print(f"the door is {math.degrees(2.0 * math.atan2(z, w)):.0f} degrees open")


def open_drawer() -> TaskResult:
    """Pull it straight out by its handle."""
    box = Box((DEEP - 0.02, WIDE, HIGH)), Pose((DEEP / 2 - 0.01, 0.0, 0.0))
    drawer = Obstacle("drawer", Compound((box, *handle(-0.03, 0.0))), Pose((FRONT, 0.0, HEIGHT)))
    return opened(drawer, Pose((FRONT - 0.03, 0.0, HEIGHT)), MoveLinear((-0.06, 0.0, 0.0), name="pull"))


def open_door() -> TaskResult:
    """Swing it about its hinge: the handle goes along an arc, and the tool turns with it."""
    panel = Box((WALL, WIDE, HIGH)), Pose((WALL / 2, 0.0, 0.0))
    door = Obstacle("door", Compound((panel, *handle(-0.03, 0.06))), Pose((FRONT, 0.0, HEIGHT)))
    hinge, grasp = (FRONT + WALL / 2, -WIDE / 2, HEIGHT), Pose((FRONT - 0.03, 0.06, HEIGHT))
    half, full = (turned_about(hinge, math.radians(angle)) @ grasp for angle in (10.0, 20.0))
    return opened(door, grasp, MoveCircular(half, full, name="swing"))


def opened(front: Obstacle, grasp: Pose, motion: Step) -> TaskResult:
    """Take the handle, move, let go, and go home."""
    service, name = PlannerService("wxai", cabinet(front)), front.name
    steps = (
        *(Connect("to the handle"), Approach("onto it", (0.05, 0.04)), Grasp(name, [grasp])),
        *(motion, Release(name), Retreat("off it", (0.03, 0.02)), MoveTo("home", name="home")),
    )
    return service.solve(Task(steps, f"open the {name}"), service.robot.home)


def handle(x: float, y: float) -> tuple[tuple[Box, Pose], ...]:
    """An upright bar in front of what it belongs to, on two stalks."""
    stalk = Box((-x, 0.006, 0.006))
    return (BAR, Pose((x, y, 0.0))), *((stalk, Pose((x / 2, y, z))) for z in (-0.035, 0.035))


def cabinet(front: Obstacle) -> Scene:
    """A cabinet on the table, with what opens at its front."""
    x, half, rim = FRONT + DEEP / 2, HIGH / 2 + GAP + WALL / 2, WIDE / 2 + GAP + WALL / 2
    board, side = Box((DEEP, WIDE + 2 * (GAP + WALL), WALL)), Box((DEEP, WALL, HIGH + 2 * GAP))
    walls = {
        "bottom": (board, (x, 0.0, HEIGHT - half)),
        "top": (board, (x, 0.0, HEIGHT + half)),
        "left": (side, (x, rim, HEIGHT)),
        "right": (side, (x, -rim, HEIGHT)),
        "back": (Box((WALL, WIDE, HIGH)), (FRONT + DEEP + WALL / 2, 0.0, HEIGHT)),
    }
    scene = load_scene("table").with_obstacle(front)
    for name, (shape, position) in walls.items():
        scene = scene.with_obstacle(Obstacle(name, shape, Pose(position)))
    return scene


def turned_about(hinge: tuple[float, float, float], angle: float) -> Pose:
    """What turns poses about an upright axis."""
    x, y, z = hinge
    turn = Pose((0.0, 0.0, 0.0), (math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)))
    return Pose(hinge) @ turn @ Pose((-x, -y, -z))


def show(task: TaskResult) -> None:
    """Print each motion with its proven clearance, or why there is none."""
    print(task.task)
    for segment in task.segments:
        proof = segment.result.certificate
        print(f"  {segment.name:<14}{segment.result.counts.states:>6,} states", end="")
        print("" if proof is None else f"{proof.clearance * 1000:8.2f} mm clear")
    if task.failure is not None:
        print(task)


if __name__ == "__main__":
    main()
