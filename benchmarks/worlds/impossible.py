"""Twenty tasks that cannot be done, each for a reason that was checked by hand: what a report of it must say."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import planner_service as ps
from planner_service.planning.task_result import Handling
from planner_service.tasks import (
    Approach,
    Connect,
    Grasp,
    MoveCircular,
    MoveLinear,
    MoveTo,
    Release,
    Retreat,
    Task,
    pick_steps,
    place_steps,
)

__all__ = ["Impossible", "impossible"]

HALF = math.sqrt(0.5)
SIDE = 0.04
"""Of the block, in metres."""

TRAY = (0.25, 0.25)


@dataclass(frozen=True, eq=False)
class Impossible:
    """A task without a plan.

    Attributes:
        name: What is wrong.
        why: How that was found by hand.
        scene: Where it is to be done.
        task: What is to be done.
        step: How the step is called at which it fails.
        says: What the report must say of the cause: each of these words somewhere in it.
        robot: Whose task it is.
        start: Where it stands; home if None.
        max_checks: Of each motion.
        searches: Of the task.
    """

    name: str
    why: str
    scene: ps.Scene
    task: Task
    step: str
    says: tuple[str, ...]
    robot: str = "wxai"
    start: tuple[float, ...] | None = None
    max_checks: int = 100_000
    searches: int = 1_000


def _about_z(angle: float) -> ps.Pose:
    return ps.Pose(quaternion=(math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)))


def impossible() -> tuple[Impossible, ...]:
    """All of them."""
    table = ps.Obstacle("table", ps.Box((1.4, 1.4, 0.1)), ps.Pose((0.0, 0.0, -0.051)))
    tray = ps.Obstacle("tray", ps.Box((0.14, 0.14, 0.01)), ps.Pose((*TRAY, 0.005)))
    cube = ps.Box((SIDE, SIDE, SIDE))

    def block(x: float = 0.3, y: float = 0.0, shape: Any = cube, height: float = SIDE) -> ps.Obstacle:
        return ps.Obstacle("block", shape, ps.Pose((x, y, height / 2)))

    def box(name: str, size: tuple[float, float, float], at: tuple[float, float, float]) -> ps.Obstacle:
        return ps.Obstacle(name, ps.Box(size), ps.Pose(at))

    def scene(*things: ps.Obstacle) -> ps.Scene:
        return ps.Scene((table, *things))

    def pick(**given: Any) -> Task:
        return Task(pick_steps("block", None, Handling(support="table", **given)))

    def moved(*places: tuple[float, float, float], support: str | None = "tray", **given: Any) -> Task:
        poses = [ps.Pose(at) for at in places]
        put = place_steps("block", poses, Handling(support=support))
        return Task((*pick_steps("block", None, Handling(support="table", **given)), *put))

    on_tray = (*TRAY, 0.011 + SIDE / 2)
    home = ps.load_robot("wxai").home
    down = ps.Pose((0.3, 0.0, SIDE / 2), (HALF, 0.0, HALF, 0.0))  # the tool points straight down
    sector = [
        ps.Obstacle(name, ps.Box((1.0, 0.02, 1.2)), _about_z(angle) @ ps.Pose((0.58, 0.0, 0.72)))
        for name, angle in (("wall_left", math.radians(45.0)), ("wall_right", math.radians(-100.0)))
    ]
    shelf = (
        box("board", (0.16, 0.3, 0.012), (0.5, 0.0, 0.144)),
        box("shelf_back", (0.012, 0.3, 0.2), (0.587, 0.0, 0.25)),
        box("rack", (0.1, 0.1, 0.15), (0.1, 0.48, 0.075)),
    )
    leaning = ps.Pose((0.3, 0.15, 0.1), (math.cos(math.pi / 12), 0.0, -math.sin(math.pi / 12), 0.0))
    rod = ps.Box((0.03, 0.26, 0.03))
    into = ps.Pose((0.5, 0.0, 0.1515 + 0.015), (HALF, 0.0, 0.0, -HALF))
    outward = ps.Pose((0.1, 0.335, 0.1665), (HALF, 0.0, 0.0, HALF))
    return (
        Impossible(
            "the object is out of reach",
            "0.80 m from the base; the arm reaches 0.7",
            scene(block(0.8)),
            pick(),
            "Grasp",
            ("out of reach", "mm"),
        ),
        Impossible(
            "its place is out of reach",
            "0.80 m from the base",
            scene(block(), tray),
            moved((0.0, 0.8, on_tray[2])),
            "Release",
            ("out of reach",),
        ),
        Impossible(
            "the object is too wide",
            "0.12 m in all directions; the fingers open 0.08",
            scene(block(shape=ps.Box((0.12, 0.12, 0.06)), height=0.06)),
            pick(),
            "Grasp",
            ("0.12", "0.08"),
        ),
        Impossible(
            "a lid lies on the object",
            "a plate 5 mm above it, 0.4 m wide, on all sides of it walls",
            scene(
                block(),
                box("lid", (0.4, 0.4, 0.02), (0.3, 0.0, 0.055)),
                box("left", (0.4, 0.02, 0.04), (0.3, 0.19, 0.021)),
                box("right", (0.4, 0.02, 0.04), (0.3, -0.19, 0.021)),
                box("front", (0.02, 0.36, 0.04), (0.11, 0.0, 0.021)),
                box("back", (0.02, 0.36, 0.04), (0.49, 0.0, 0.021)),
            ),
            pick(),
            "Grasp",
            ("lid",),
        ),
        Impossible(
            "the object stands in a tube",
            "walls of 12 cm all around at 6 mm; a finger is 15 mm thick, the hand above it 19 cm wide",
            scene(
                block(),
                box("tube_left", (0.09, 0.02, 0.12), (0.3, 0.036, 0.06)),
                box("tube_right", (0.09, 0.02, 0.12), (0.3, -0.036, 0.06)),
                box("tube_front", (0.02, 0.05, 0.12), (0.264, 0.0, 0.06)),
                box("tube_back", (0.02, 0.05, 0.12), (0.336, 0.0, 0.06)),
            ),
            pick(),
            "Grasp",
            ("tube",),
        ),
        Impossible(
            "the object is clamped between neighbours",
            "four equal blocks 2 mm beside it",
            scene(
                block(),
                *(
                    box(f"neighbour_{k}", (SIDE, SIDE, SIDE), (0.3 + x, y, SIDE / 2))
                    for k, (x, y) in enumerate(((0.042, 0.0), (-0.042, 0.0), (0.0, 0.042), (0.0, -0.042)))
                ),
            ),
            pick(),
            "Grasp",
            ("finger", "neighbour"),
        ),
        Impossible(
            "its place is occupied",
            "another block stands there",
            scene(block(), tray, box("other", (SIDE, SIDE, SIDE), on_tray)),
            moved(on_tray),
            "Release",
            ("other",),
        ),
        Impossible(
            "every arm posture at the object collides",
            "it stands 1 cm below a beam over the elbow and forearm",
            scene(
                block(0.3),
                box("beam", (0.06, 0.6, 0.02), (0.17, 0.0, 0.13)),
                box("beam_2", (0.06, 0.6, 0.02), (0.26, 0.0, 0.13)),
                box("beam_3", (0.06, 0.6, 0.02), (0.36, 0.0, 0.13)),
                box("beam_4", (0.06, 0.6, 0.02), (0.45, 0.0, 0.13)),
            ),
            pick(),
            "Grasp",
            ("beam",),
            start=tuple(home.tolist()),
        ),
        Impossible(
            "it is to lean but must stay upright",
            "its place leans by 30 degrees; 0.2 rad (11 degrees) are allowed",
            scene(block(), tray),
            Task(
                (
                    *pick_steps("block", None, Handling(support="table", upright=0.2)),
                    *place_steps("block", [leaning]),
                )
            ),
            "lower",
            ("upright", "0.524"),
        ),
        Impossible(
            "nothing is below its place",
            "6 cm above the tray",
            scene(block(), tray),
            moved((on_tray[0], on_tray[1], on_tray[2] + 0.06)),
            "Release",
            ("tray", "5 mm"),
        ),
        Impossible(
            "its place is inside its support",
            "1 cm deep in the tray",
            scene(block(), tray),
            moved((on_tray[0], on_tray[1], on_tray[2] - 0.009)),
            "Release",
            ("inside tray",),
        ),
        Impossible(
            "the rod is longer than the shelf is deep",
            "0.26 m, held by its end, 0.16 m to the back",
            scene(*shelf, ps.Obstacle("block", rod, ps.Pose((0.1, 0.45, 0.1665)))),
            Task(
                (
                    Connect("to pregrasp"),
                    Approach("in"),
                    Grasp("block", (outward,), support="rack"),
                    Retreat("out"),
                    Connect("transfer"),
                    Approach("in"),
                    Release("block", (into,), support="board"),
                    Retreat("out"),
                )
            ),
            "",
            ("shelf_back",),
        ),
        Impossible(
            "walls close the way",
            "two walls from the base outwards, 1.3 m high, one on either side of where it begins",
            scene(block(), ps.Obstacle("tray", tray.shape, ps.Pose((0.0, 0.3, 0.005))), *sector),
            moved((0.0, 0.3, on_tray[2])),
            "transfer",
            ("wall_left",),
            max_checks=20_000,
            searches=3,
        ),
        Impossible(
            "the cup has no flat face",
            "a ball",
            scene(block(0.5, 0.0, ps.Sphere(0.04), 0.08)),
            pick(),
            "Grasp",
            ("flat",),
            robot="ur5_vacuum",
        ),
        Impossible(
            "the face is smaller than the cup",
            "a rod of 2 cm; the cup has 3 cm",
            scene(block(0.5, 0.0, ps.Box((0.02, 0.02, 0.02)), 0.02)),
            pick(),
            "Grasp",
            ("flat", "0.030"),
            robot="ur5_vacuum",
        ),
        Impossible(
            "the given grasp is beside the object",
            "6 cm to its left",
            scene(block()),
            Task(pick_steps("block", [ps.Pose((0.3, 0.06, SIDE / 2), down.quaternion)])),
            "Grasp",
            ("fingertips", "away from block"),
        ),
        Impossible(
            "a straight line goes through a post",
            "it stands on the line",
            scene(ps.Obstacle("post", ps.Cylinder(0.02, 0.5), ps.Pose((0.25, 0.1, 0.25)))),
            Task((MoveLinear((0.05, 0.25, 0.0), name="across"),)),
            "MoveLinear across",
            ("post",),
        ),
        Impossible(
            "a straight line leaves the arm's reach",
            "half a metre outwards from 0.22 m",
            scene(),
            Task((MoveLinear((0.7, 0.0, 0.0), name="outwards"),)),
            "MoveLinear outwards",
            ("%",),
        ),
        Impossible(
            "the tool is to go where a block is",
            "the goal is in its middle",
            scene(block(0.35, 0.1, ps.Box((0.1, 0.1, 0.2)), 0.2)),
            Task((MoveTo(ps.Pose((0.35, 0.1, 0.1), down.quaternion), name="inside"),)),
            "MoveTo inside",
            ("block",),
        ),
        Impossible(
            "a door opens into a wall",
            "the arc ends where the wall stands",
            scene(box("wall", (0.02, 0.3, 0.6), (0.38, 0.2, 0.3))),
            Task((MoveCircular((0.06, 0.14, 0.0), (0.2, 0.2, 0.0), name="open"),)),
            "MoveCircular open",
            ("wall",),
        ),
    )
