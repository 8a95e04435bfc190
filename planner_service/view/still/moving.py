"""Motions as a picture that moves: a WebP file that begins again at its end, drawn without a display or a browser.

::

    from planner_service.view.still.moving import draw_motions

    draw_motions([task], "task.webp")
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner_service.certify.certifier import clearance_text
from planner_service.errors import InvalidRequest
from planner_service.files.reading import as_path
from planner_service.files.writing import require_writable, write_whole
from planner_service.gate.log import Logged
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import items, number
from planner_service.path.trajectory import Trajectory
from planner_service.planning.request import World
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import Segment, TaskResult
from planner_service.records.plan_file import SavedTask
from planner_service.robot.model import Robot
from planner_service.service import PlannerService
from planner_service.view.still.camera import Camera
from planner_service.view.still.composition import View, camera_of, floor, picture, tool_path
from planner_service.view.still.lettering import CAPTION, Caption, lettered
from planner_service.view.still.paint import Drawing, Line, paint, placed
from planner_service.view.still.pictures import refusal_caption, refusal_stands, webp_bytes
from planner_service.view.still.sights import Sights
from planner_service.view.triangles import TOOL, Solid, is_ground, placements, robot_solids, scene_solids

__all__ = ["OURS", "draw_motions", "draw_refusals"]

OURS = re.compile(rb"RIFF....WEBP", re.DOTALL)
"""How such pictures begin."""

Image = NDArray[np.uint8]

SIZE = (960, 600)
"""Pixels, width and height."""

RATE = 15
"""Frames a second."""

MAX_FRAMES = 1_000
"""Frames are in memory until all are written, 1.7 MB each."""

MAX_SHOWN = 100
"""Plans and tasks of one picture."""

MAX_REFUSALS = 300
"""Lines of a log in one picture."""

GRIP, END = 0.3, 1.5
"""Seconds shown where an object is taken or left, and of the end, before all begins again."""

SIGHTED = 6
"""Places of each motion that are in view whole."""


def draw_motions(
    motions: Sequence[PlanResult | TaskResult | SavedTask], file: str | os.PathLike[str], *, speed: float = 1.0
) -> None:
    """A picture that moves, of plans and tasks one after another: each motion with its curve and its proven clearance.

    Args:
        motions: The second begins where the first ends, and so on; else the robot jumps.
        file: Called .webp, browsers show it wherever they show a picture.
        speed: Seconds of motion in a second of the picture.

    Raises:
        InvalidRequest: No motion, one that failed or does not know its scene, a speed outside [0.1, 10], or more than
            1,000 frames.
        InvalidFile: The file cannot be written.
    """
    path = as_path("file", file)
    require_writable(path, OURS)  # drawing takes a while
    given: tuple[PlanResult | TaskResult | SavedTask, ...] = items(
        "motions", motions, (PlanResult, TaskResult, SavedTask), "a list of plans and tasks", MAX_SHOWN
    )
    rate = RATE / number("speed", speed, "seconds of motion in a second, in [0.1, 10]", 0.1, 10.0)
    shown = [motion for each in given for motion in _motions(each)]
    frames = [frame for motion in shown for frame in motion.frames(rate)]
    if not 1 <= len(frames) <= MAX_FRAMES:
        raise InvalidRequest("motions", f"{len(frames)} frames", f"1 to {MAX_FRAMES:,}: more speed, fewer motions")
    inner = (SIZE[0], SIZE[1] - CAPTION)
    standing = [solid for motion in shown for solid in motion.standing]
    sights = Sights([s for motion in shown for s in motion.sighted], standing, [motion.curve for motion in shown])
    beneath = () if any(is_ground(solid.vertices) for solid in standing) else floor(sights.points)
    camera = sights.camera(inner)
    pictures = [frame.picture(camera, beneath, inner) for frame in frames]
    write_whole(path, webp_bytes(pictures, RATE, END), OURS)


def draw_refusals(service: PlannerService, logged: Sequence[Logged], file: str | os.PathLike[str]) -> None:
    """A picture that moves, of lines of a gate's log, one a frame: as ``draw_refusal`` draws each.

    Args:
        service: Of the robot and the scene.
        logged: Those that do not say where the robot was are left out; the last 300 are drawn.
        file: Called .webp, browsers show it wherever they show a picture.

    Raises:
        InvalidRequest: no line that says where the robot was.
        InvalidFile: the file cannot be written.
    """
    path = as_path("file", file)
    require_writable(path, OURS)
    lines: tuple[Logged, ...] = items("logged", logged, Logged, "lines of a gate's log")
    known = [line for line in lines if refusal_stands(line)][-MAX_REFUSALS:]
    if not known:
        raise InvalidRequest("logged", f"{len(lines)} lines", "one at least that says where the robot was")
    views = [View(service.robot, service.scene, tuple(stand for stand, _ in refusal_stands(line))) for line in known]
    camera = camera_of(views, SIZE)
    pictures = [
        picture(view, refusal_caption(service, line), SIZE, camera) for view, line in zip(views, known, strict=True)
    ]
    write_whole(path, webp_bytes(pictures, RATE, END), OURS)


@dataclass(frozen=True, eq=False)
class _Motion:
    """One motion: the world it is made in, and the world before it."""

    name: str
    words: str
    world: World
    before: World
    trajectory: Trajectory

    @cached_property
    def links(self) -> tuple[Solid, ...]:
        return robot_solids(self.world.robot)

    @cached_property
    def standing(self) -> tuple[Solid, ...]:
        return tuple(solid for solid in scene_solids(self.world.scene) if solid.frame is None)

    @cached_property
    def carried(self) -> tuple[Solid, ...]:
        return tuple(solid for solid in scene_solids(self.world.scene) if solid.frame == TOOL)

    @cached_property
    def curve(self) -> Line:
        return tool_path(self.world.robot, self.trajectory.path)

    @property
    def sighted(self) -> Iterator[Solid]:
        """The robot at some places of the motion."""
        for t in np.linspace(0.0, self.trajectory.duration, SIGHTED).tolist():
            yield from self.robot_at(self.trajectory(t), self.world.robot, self.links)

    def robot_at(self, q: FloatArray, robot: Robot, links: Sequence[Solid]) -> Iterator[Solid]:
        """The robot and what it carries at q (n,), in the world."""
        poses = placements(robot, q)
        for solid in (*links, *self.carried):
            yield placed(solid, poses[solid.frame or TOOL])

    def frames(self, rate: float) -> Iterator[_Frame]:
        """Its frames, ``rate`` a second of motion: first the gripper's, if it works, while the arm stands."""
        begin, robot = self.trajectory(0.0), self.world.robot
        if self.before.scene != self.world.scene or self.before.robot.gripper_width != robot.gripper_width:
            count = round(GRIP * RATE)
            widths = np.linspace(self.before.robot.gripper_width, robot.gripper_width, count).tolist()
            yield from (_Frame(self, begin, None if robot.gripper is None else width) for width in widths)
        for k in range(max(1, round(self.trajectory.duration * rate))):
            yield _Frame(self, self.trajectory(min(k / rate, self.trajectory.duration)))


@dataclass(frozen=True, eq=False)
class _Frame:
    """One frame: where the robot is, and how wide its gripper is if that is not as during the motion."""

    motion: _Motion
    q: FloatArray
    width: float | None = None

    def picture(self, camera: Camera, beneath: tuple[Line, ...], inner: tuple[int, int]) -> Image:
        motion, robot, links = self.motion, self.motion.world.robot, self.motion.links
        if self.width is not None:
            robot = robot.with_gripper(self.width)
            links = robot_solids(robot)
        solids = (*motion.robot_at(self.q, robot, links), *motion.standing)
        image, _ = paint(Drawing(solids, (), (motion.curve,), beneath), camera, inner)
        return lettered(image, (), Caption(motion.name, (motion.words,)))


def _motions(shown: PlanResult | TaskResult | SavedTask) -> Iterator[_Motion]:
    if shown.failure is not None:
        raise InvalidRequest("motions", str(shown.failure), "plans and tasks that succeeded")
    if not isinstance(shown, PlanResult):
        before, segments, what = shown.begin, shown.segments, shown.task
    elif shown.origin is None:
        raise InvalidRequest("motions", shown, "a plan that knows its scene, as one that was planned here")
    else:
        before = shown.origin.world
        segments = (Segment("plan", shown, before.robot.gripper_width),)
        what = f"{before.robot.name} in {before.scene.name or 'a scene'}"
    for segment in segments:
        _, trajectory = segment.result.unwrap()
        proof, world = segment.result.certificate, segment.world_after(before)
        proven = "" if proof is None else f" \u00b7 proven: {clearance_text(proof.clearance)}, between samples too"
        yield _Motion(segment.name, f"{what}{proven}", world, before, trajectory)
        before = world
