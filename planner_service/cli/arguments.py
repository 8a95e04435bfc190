"""What the command line's texts mean: robots and scenes, configurations, goals, timing laws."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

import numpy as np

from planner_service.cli import plot
from planner_service.errors import InvalidRequest, MissingDependency, UnknownName
from planner_service.files.writing import require_writable
from planner_service.geometry.shapes import FloatArray, Pose
from planner_service.optimize import Optimise, load_solver
from planner_service.path.joint_path import JointPath
from planner_service.planners import PLANNERS, Planner, planner_by_name
from planner_service.planning.request import PlanRequest
from planner_service.records import plan_file
from planner_service.records.plan_file import TIMINGS, SavedPlan, SavedTask
from planner_service.records.recertify import recertify
from planner_service.roadmap.validity import Terms
from planner_service.robot.model import Robot, load_robot, robot_names
from planner_service.scene.scene import Scene
from planner_service.scene.worlds import load_world
from planner_service.service import PlannerService
from planner_service.timing.laws import Timing
from planner_service.view.still import pictures as still

__all__ = [
    "configuration",
    "differences",
    "from_file",
    "goals",
    "load_libraries",
    "optimise",
    "pairs_of_texts",
    "planner_or_optimise",
    "reopened",
    "require_obstacles",
    "require_places",
    "require_proven",
    "service_for",
    "service_of_terms",
    "time_limit_of",
    "timing_by_name",
    "unit_of",
]

T = TypeVar("T")

_POSE = "pose:"

_KINDS = {"--out": plan_file.OURS, "--plan": plan_file.OURS, "--plot": plot.OURS, "--png": still.OURS}
"""How files begin that a command may replace, by its option."""


def configuration(option: str, text: str, robot: Robot) -> FloatArray:
    """The named pose of a robot, or as many comma-separated joint values as it has, shape (n,).

    Raises:
        InvalidRequest: neither; what is finite or within limits is not asked here.
    """
    numbers = _numbers(text)
    if numbers is None:
        if "," in text:
            raise InvalidRequest(option, text, f"{robot.n} numbers, separated by commas")
        try:
            return robot.pose(text)
        except UnknownName as error:
            message = f"{option}: {error}, or give {robot.n} joint values, separated by commas"
            raise InvalidRequest(option, text, "a named pose or joint values", message=message) from None
    if len(numbers) != robot.n:
        message = f"{option}: got {len(numbers)} values ({text}); expected {robot.n}: {', '.join(robot.joint_names)}"
        raise InvalidRequest(option, text, f"{robot.n} joint values", message=message)
    return np.array(numbers)


def goals(texts: Sequence[str], robot: Robot) -> FloatArray | Pose | tuple[FloatArray | Pose, ...]:
    """The goal, or the tuple of them, that ``PlanRequest`` takes: configurations, or ``pose:x,y,z,qw,qx,qy,qz``.

    Raises:
        InvalidRequest: a text is neither.
    """
    found = tuple(
        _goal(f"--goal ({k + 1} of {len(texts)})" if k else "--goal", text, robot) for k, text in enumerate(texts)
    )
    return found[0] if len(found) == 1 else found


def _goal(option: str, text: str, robot: Robot) -> FloatArray | Pose:
    if not text.startswith(_POSE):
        return configuration(option, text, robot)
    numbers = _numbers(text[len(_POSE) :])
    if numbers is None or len(numbers) != 7:
        raise InvalidRequest(option, text, f"{_POSE}x,y,z,qw,qx,qy,qz: metres, and a unit quaternion")
    x, y, z, qw, qx, qy, qz = numbers
    try:
        return Pose((x, y, z), (qw, qx, qy, qz))
    except InvalidRequest as error:
        raise InvalidRequest(option, text, error.expected, message=f"{option}: {error}") from None


def _numbers(text: str) -> list[float] | None:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return None


def pairs_of_texts(option: str, texts: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Pairs of names, each written as A:B.

    Raises:
        InvalidRequest: a text is no such pair.
    """
    pairs = tuple(tuple(text.split(":")) for text in texts)
    for text, names in zip(texts, pairs, strict=True):
        if len(names) != 2 or not all(names) or names[0] == names[1]:
            raise InvalidRequest(option, text, "two different names of links or objects with a colon between them")
    return tuple((names[0], names[1]) for names in pairs)


def optimise(clearance: float | None) -> Optimise:
    """An optimisation that keeps so many metres, or as many as it does by itself."""
    return Optimise() if clearance is None else Optimise(clearance=clearance)


def planner_or_optimise(name: str, clearance: float | None, *, polish: bool) -> Planner | Optimise:
    """The planner of that name (any case) with its default settings, ``optimise`` among them.

    Raises:
        UnknownName: there is none; the message offers the nearest.
        InvalidRequest: a clearance for a planner that takes none, or a polish of one that optimises.
    """
    if name.lower() == Optimise().name:
        if polish:
            raise InvalidRequest("--polish", True, "another planner with it: optimise optimises by itself")
        return optimise(clearance)
    if clearance is not None and not polish:
        raise InvalidRequest("--clearance", clearance, "--polish, or --planner optimise")
    if name.lower() not in PLANNERS:
        raise UnknownName("planner", name, [*PLANNERS, Optimise().name])
    return planner_by_name(name)


def timing_by_name(name: str) -> Timing:
    """The timing law of that name (any case) with its default settings.

    Raises:
        UnknownName: there is none; the message offers the nearest.
    """
    if name.lower() not in TIMINGS:
        raise UnknownName("timing law", name, TIMINGS)
    law: Timing = TIMINGS[name.lower()]()
    return law


def time_limit_of(seconds: float) -> float | None:
    """The limit that a number of seconds means: None, none at all, if it is infinite."""
    return None if seconds == math.inf else seconds


def service_for(robot: str, scene: str) -> PlannerService:
    """The service for a robot and a scene, by name or file.

    Raises:
        InvalidRequest: no such robot or scene.
    """
    return PlannerService(load_robot(robot), load_world(scene))


def require_obstacles(scene: Scene, names: Mapping[str, str]) -> None:
    """Return if the scene has an obstacle of each name that was given, by its option, or that the option has if not.

    Raises:
        UnknownName: it has none of that name; the message has the option.
    """
    for option, name in names.items():
        if name not in (known := [obstacle.name for obstacle in scene.obstacles]):
            raise UnknownName(f"obstacle for {option}", name, known)


def require_places(files: Mapping[str, str | None]) -> None:
    """Return if a file can be put at each place that was given, by its option, and no two of them are one.

    Raises:
        InvalidFile: an option names a place where no file can be, or one of another kind is.
        InvalidRequest: a picture's name is none, or two options name one place.
    """
    taken: dict[str, str] = {}
    for option, file in files.items():
        if file is not None:
            if option == "--png" and not file.lower().endswith(".png"):
                raise InvalidRequest(option, file, "a name that ends in .png")
            require_writable(file, _KINDS[option])
            other = taken.setdefault(os.path.realpath(file), option)
            if other != option:
                raise InvalidRequest(option, file, f"another file than {other}")


def from_file(saved: SavedPlan | SavedTask) -> str:
    """What every command says that uses the scene in a file."""
    return f"against the scene in this file: {saved.scene.name or 'unnamed'}"


def reopened(
    saved: SavedPlan | SavedTask, robot: str | None, scene: str | None
) -> tuple[SavedPlan | SavedTask, list[str]]:
    """A plan or task from a file in the world that it brings, or in what is given in place of that; and what is to be
    said of it.

    Raises:
        InvalidRequest: no such robot or scene.
    """
    made_for, notes = saved.made_for, [from_file(saved)]
    notes += differences(made_for.robot) if robot is None else []
    if robot is not None:
        arm, before = load_robot(robot), made_for.robot
        arm = arm if arm.gripper is None or before.gripper is None else arm.with_gripper(before.gripper_width)
        notes += [] if arm.hash == before.hash else [f"made for another robot: {before.name}, {before.hash[:12]}"]
        made_for = replace(made_for, robot=arm)
    if scene is not None:
        world = load_world(scene)
        notes[0] = f"against --scene {scene}, not the scene in this file"
        if world.hash != made_for.scene.hash:
            notes.append(f"made for another scene: {saved.scene.name}, {saved.scene.hash[:12]}")
        made_for = replace(made_for, scene=world)
    if made_for.edge_step is None:
        notes.append("planned with a custom edge step, which files do not hold; MotionStep() is used here")
    return saved.within(made_for) if isinstance(saved, SavedTask) else replace(saved, made_for=made_for), notes


def differences(robot: Robot) -> list[str]:
    """What is to be said of a robot from a file that has the name of one of this package, and is another."""
    if robot.name not in robot_names():
        return []
    try:
        ours = load_robot(robot.name)
    except MissingDependency as error:
        return [f"robot {robot.name} in this file is not compared with the {robot.name} of this package: {error}"]
    with suppress(InvalidRequest):  # no gripper, or one of another range
        ours = ours.with_gripper(robot.gripper_width)
    if ours.hash == robot.hash:
        return []
    known, told = _lenient(ours), _lenient(robot)
    added = [
        f"robot {robot.name} in this file lets {a} x {b} touch; that of this package does not"
        for a, b in sorted(told - known)
    ]
    return [f"robot {robot.name} in this file is not the {robot.name} of this package", *added]


def _lenient(robot: Robot) -> set[tuple[str, str]]:
    """Pairs of links that a robot says may touch, always or on its way out of a pose."""
    pairs = [*(contact.links for contact in robot.allowed_contacts), *(p for way in robot.retreats for p in way.pairs)]
    return {(min(pair), max(pair)) for pair in pairs}


def require_proven(saved: SavedPlan | SavedTask, allow: Sequence[str] | None) -> None:
    """Return if the motions of a file are proven again, as far as there are any, in the scene that it brings.

    Args:
        allow: Pairs that are named again, each written as A:B.

    Raises:
        NotProven: they are not.
    """
    allowed = pairs_of_texts("--allow", allow or ())
    if isinstance(saved, SavedTask):
        planned = tuple(segment for segment in saved.segments if segment.result.ok)
        saved = replace(saved, segments=planned, failure=None)
        if not planned:
            return
    elif not saved.result.ok:
        return
    recertify(saved, allowed=allowed).required()


def service_of_terms(terms: Terms, robot: str | None, scene: str | None, made: str) -> tuple[PlannerService, list[str]]:
    """The service for which a roadmap holds, or for what was given in its place, with what is to be said of that.

    Raises:
        InvalidRequest: robot or scene, taken by the name in the roadmap, is not there or not what it was ``made`` for.
    """
    arm = load_robot(robot) if robot is not None else _found("--robot", terms.robot, load_robot, made)
    world = load_world(scene) if scene is not None else _found("--scene", terms.scene, load_world, made)
    notes = []
    rows = (
        ("--robot", robot, terms.robot, terms.robot_hash, arm.hash),
        ("--scene", scene, terms.scene, terms.scene_hash, world.hash),
    )
    for option, given, name, before, now in rows:
        if before != now and given is None:
            raise InvalidRequest(option, name, f"the file of the {option[2:]} that {made}: this one differs")
        if before != now:
            notes.append(f"{made} another {option[2:]}: {name}, {before[:12]}")
    return PlannerService(arm, world), notes


def _found(option: str, name: str, load: Callable[[str], T], made: str) -> T:
    try:
        return load(name)
    except UnknownName as error:
        raise InvalidRequest(option, name, f"the file of the {option[2:]} that {made}: {error}") from None


def load_libraries(request: PlanRequest, robot: Robot) -> None:
    """Time a motion that nobody asked for: libraries load when first used, and no stage is to be charged for that."""
    request.timing.time_path(JointPath(np.array([robot.limits.lower, robot.limits.upper])), robot.limits)
    if request.optimise is not None:
        load_solver()


def unit_of(robot: Robot) -> str:
    """Of path lengths: rad, nothing where joints slide."""
    return "" if any(body.prismatic for body in robot.bodies) else "rad"
