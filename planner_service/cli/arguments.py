"""Turns the texts of the command line into robots, scenes, configurations, goals, planners and timing laws."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from planner_service.cli.options import RobotChoice
from planner_service.constraints import Constraint, KeepUpright, load_constraints
from planner_service.errors import InvalidRequest, MissingDependency, UnknownName
from planner_service.files.writing import require_writable
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.optimize import Optimise, load_solver
from planner_service.path.joint_path import JointPath
from planner_service.planners import PLANNERS, Planner, planner_by_name
from planner_service.planning.request import PlanRequest
from planner_service.planning.task_result import Handling
from planner_service.roadmap.verdicts import Terms
from planner_service.robot.inertia import Dynamics, Payload
from planner_service.robot.model import Robot, joint_vector, robot_names
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService
from planner_service.timing.laws import TIMINGS, Timing, ToppRa

if TYPE_CHECKING:
    from planner_service.records.plan_file import SavedPlan, SavedTask

__all__ = [
    "configuration",
    "constraints",
    "differences",
    "from_file",
    "goals",
    "load_libraries",
    "optimise",
    "pairs_of_texts",
    "payload",
    "planner_or_optimise",
    "reopened",
    "require_obstacles",
    "require_outputs",
    "require_proven",
    "service_for",
    "service_of_terms",
    "time_limit_of",
    "timing_by_name",
]

T = TypeVar("T")

_POSE = "pose:"


def configuration(option: str, text: str, robot: Robot) -> FloatArray:
    """A named pose of the robot, or comma-separated joint values, shape (n,); limits are not checked here.

    Raises:
        InvalidRequest: the text is neither.
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
    """The goal of a ``PlanRequest``, or a tuple of goals: configurations, or ``pose:x,y,z,qw,qx,qy,qz``.

    Raises:
        InvalidRequest: a text is neither.
    """
    parsed = tuple(
        _goal(f"--goal ({k + 1} of {len(texts)})" if k else "--goal", text, robot) for k, text in enumerate(texts)
    )
    return parsed[0] if len(parsed) == 1 else parsed


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
        InvalidRequest: a text is not of this form.
    """
    pairs = tuple(tuple(text.split(":")) for text in texts)
    for text, names in zip(texts, pairs, strict=True):
        if len(names) != 2 or not all(names) or names[0] == names[1]:
            raise InvalidRequest(option, text, "A:B, two different names of links or objects")
    return tuple((names[0], names[1]) for names in pairs)


def optimise(clearance: float | None) -> Optimise:
    """An optimisation that keeps this clearance in metres, or its default."""
    return Optimise() if clearance is None else Optimise(clearance=clearance)


def planner_or_optimise(name: str, clearance: float | None, *, polish: bool) -> Planner | Optimise:
    """The planner of that name (in any case) with its default settings; ``optimise`` is one of them.

    Raises:
        UnknownName: there is none; the message offers the nearest.
        InvalidRequest: a clearance without an optimisation, or --polish with a planner that optimises anyway.
    """
    if name.lower() == Optimise.name:
        if polish:
            raise InvalidRequest("--polish", True, "another planner: optimise needs no --polish")
        return optimise(clearance)
    if clearance is not None and not polish:
        raise InvalidRequest("--clearance", clearance, "--polish, or --planner optimise")
    if name.lower() not in PLANNERS:
        raise UnknownName("planner", name, [*PLANNERS, Optimise.name])
    return planner_by_name(name)


def timing_by_name(name: str, *, torque: bool = False) -> Timing:
    """The timing law of that name (in any case) with its default settings, or keeping torque limits as well.

    Raises:
        UnknownName: there is none; the message offers the nearest.
        InvalidRequest: torque limits with a law that does not keep any.
    """
    if name.lower() not in TIMINGS:
        raise UnknownName("timing law", name, TIMINGS)
    if torque and name.lower() != ToppRa.name:
        raise InvalidRequest("--timing", name, f"{ToppRa.name} with --torque and --payload: no other law keeps torques")
    law: Timing = ToppRa(torque=True) if torque else TIMINGS[name.lower()]()
    return law


def payload(text: str | None) -> Payload | None:
    """What the tool carries, from ``KG`` or ``KG,X,Y,Z``.

    Raises:
        InvalidRequest: the text is neither, or no such load.
    """
    if text is None:
        return None
    numbers = _numbers(text)
    if numbers is None or len(numbers) not in (1, 4):
        raise InvalidRequest("--payload", text, "KG or KG,X,Y,Z: kilograms, and metres in the tool frame")
    mass, *com = numbers
    try:
        return Payload(mass, (com[0], com[1], com[2])) if com else Payload(mass)
    except InvalidRequest as error:
        raise InvalidRequest("--payload", text, error.expected) from None


def constraints(
    upright: float | None, region: str | None, robot: Robot, start: FloatArray
) -> tuple[tuple[Constraint, ...], list[str]]:
    """The constraints of ``--upright`` and ``--region``, and a line that says which axis is kept upright.

    Raises:
        InvalidRequest: The tolerance is out of range.
        InvalidFile: The file cannot be used.
    """
    asked = () if region is None else load_constraints(region)
    if upright is None:
        return asked, []
    ups = robot.tool_pose(joint_vector("--start", start, robot))[2, :3]  # how far up each axis of the tool points
    k = int(np.argmax(np.abs(ups)))
    axis = np.where(np.arange(3) == k, np.sign(ups[k]), 0.0)
    try:
        kept = KeepUpright(axis.tolist(), upright)
    except InvalidRequest as error:
        raise InvalidRequest("--upright", upright, error.expected) from None
    line = f"upright: the tool's {'+-'[int(ups[k] < 0.0)]}{'xyz'[k]} axis points up, within {upright:g} rad"
    return (kept, *asked), [line]


def lean(upright: float | None) -> float | None:
    """How far what is carried may lean, in radians; None for any.

    Raises:
        InvalidRequest: It is out of range.
    """
    try:
        return Handling(upright=upright).upright
    except InvalidRequest as error:
        raise InvalidRequest("--upright", upright, error.expected.removesuffix(", or None")) from None


def time_limit_of(seconds: float) -> float | None:
    """A time limit in seconds; None, no limit, if it is infinite."""
    return None if seconds == math.inf else seconds


def service_for(robot: RobotChoice, scene: str) -> PlannerService:
    """A service for a robot and a scene, by name or file.

    Raises:
        InvalidRequest: there is no such robot or scene.
    """
    return PlannerService(robot.load(), load_scene(scene))


def require_obstacles(scene: Scene, names: Mapping[str, str]) -> None:
    """Check that the scene has the obstacle named by each option.

    Raises:
        UnknownName: it has not; the message names the option.
    """
    for option, name in names.items():
        if name not in (known := [obstacle.name for obstacle in scene.obstacles]):
            raise UnknownName(f"obstacle for {option}", name, known)


def require_outputs(files: Mapping[str, str | None]) -> None:
    """Check that the file named by each option can be written, before the work whose result would be lost.

    Raises:
        InvalidFile: a file cannot be written there, or would overwrite one of another kind.
        InvalidRequest: a picture is not called .png or .webp, or two options name the same file.
    """
    taken: dict[str, str] = {}
    for option, file in files.items():
        if file is not None:
            ending = f".{option[2:]}"
            if option in ("--png", "--webp") and not file.lower().endswith(ending):
                raise InvalidRequest(option, file, f"a name that ends in {ending}")
            require_writable(file, _beginning_of(option))
            other = taken.setdefault(os.path.realpath(file), option)
            if other != option:
                raise InvalidRequest(option, file, f"a different file from {other}")


def _beginning_of(option: str) -> re.Pattern[bytes]:
    """The beginning of the files that an option may overwrite."""
    if option == "--png":
        from planner_service.view.still.pictures import OURS
    elif option == "--webp":
        from planner_service.view.still.moving import OURS
    elif option == "--plot":
        from planner_service.view.still.motion_plot import OURS
    elif option == "--memory":
        from planner_service.memory.memory_file import OURS
    else:
        from planner_service.records.plan_file import OURS
    return OURS


def from_file(saved: SavedPlan | SavedTask) -> str:
    """The note of every command that uses the scene in a file."""
    return f"using the scene in this file: {saved.scene.name or 'unnamed'}"


def reopened(
    saved: SavedPlan | SavedTask, robot: RobotChoice | None, scene: str | None
) -> tuple[SavedPlan | SavedTask, list[str]]:
    """A plan or task from a file, with the robot or scene given instead of those in the file, and notes on differences.

    Raises:
        InvalidRequest: there is no such robot or scene.
    """
    from planner_service.records.plan_file import SavedTask

    begin, notes = saved.begin, [from_file(saved)]
    notes += differences(begin.robot) if robot is None else []
    if robot is not None:
        arm, before = robot.load(), begin.robot
        arm = arm.opened_like(before)
        notes += [] if arm.hash == before.hash else [f"made for another robot: {before.name}, {before.hash[:12]}"]
        begin = replace(begin, robot=arm)
    if scene is not None:
        world = load_scene(scene)
        notes[0] = f"using --scene {scene} instead of the scene in this file"
        if world.hash != begin.scene.hash:
            notes.append(f"made for another scene: {saved.scene.name}, {saved.scene.hash[:12]}")
        begin = replace(begin, scene=world)
    if begin.edge_step is None:
        notes.append("planned with a custom edge step, which files do not store; MotionStep() is used instead")
    return saved.within(begin) if isinstance(saved, SavedTask) else replace(saved, begin=begin), notes


def differences(robot: Robot) -> list[str]:
    """Notes on a robot from a file that differs from the robot of the same name in this package."""
    if robot.name not in robot_names():
        return []
    try:
        ours = load_robot(robot.name).opened_like(robot)
    except MissingDependency as error:
        return [f"robot {robot.name} in this file cannot be compared with {robot.name} of this package: {error}"]
    known = robot.link_frames in ((), ours.link_frames)  # files of 0.2.0 have no frames
    if ours.hash == robot.hash and known and _same_dynamics(robot.dynamics, ours.dynamics):
        return []
    allowed, allowed_in_file = _allowed_pairs(ours), _allowed_pairs(robot)
    added = [
        f"robot {robot.name} in this file allows {a} x {b} to touch; {robot.name} of this package does not"
        for a, b in sorted(allowed_in_file - allowed)
    ]
    return [f"robot {robot.name} in this file differs from {robot.name} of this package", *added]


def _same_dynamics(in_file: Dynamics | None, ours: Dynamics | None) -> bool:
    """Whether masses and efforts are the same, or those in the file are not known, as in files of 0.2.0."""
    if in_file is None or ours is None:
        return in_file is None
    return in_file.links == ours.links and np.array_equal(in_file.effort, ours.effort)


def _allowed_pairs(robot: Robot) -> set[tuple[str, str]]:
    """Pairs of links that may touch, always or while leaving a pose."""
    pairs = [contact.links for contact in robot.allowed_contacts]
    pairs += [pair for retreat in robot.retreats for pair in retreat.pairs]
    return {(min(pair), max(pair)) for pair in pairs}


def require_proven(saved: SavedPlan | SavedTask, allow: Sequence[str] | None) -> None:
    """Check that the motions in a file, if there are any, are proven in the scene in the file.

    Args:
        allow: Pairs confirmed by the user, each written as A:B.

    Raises:
        NotProven: they are not.
    """
    from planner_service.records.plan_file import SavedTask
    from planner_service.records.recertify import recertify

    allowed = pairs_of_texts("--allow", allow or ())
    if isinstance(saved, SavedTask):
        planned = tuple(segment for segment in saved.segments if segment.result.ok)
        saved = replace(saved, segments=planned, failure=None)
        if not planned:
            return
    elif not saved.result.ok:
        return
    recertify(saved, allowed=allowed).required()


def service_of_terms(terms: Terms, robot: RobotChoice | None, scene: str | None) -> tuple[PlannerService, list[str]]:
    """The service that a roadmap was built for, or one for the robot or scene given instead, and notes on differences.

    Raises:
        InvalidRequest: robot or scene, loaded by the name in the roadmap, are missing or not those it was built for.
    """
    arm = robot.load() if robot is not None else _load_named("--robot", terms.robot, load_robot)
    world = load_scene(scene) if scene is not None else _load_named("--scene", terms.scene, load_scene)
    notes = []
    rows = (
        ("--robot", robot, terms.robot, terms.robot_hash, arm.hash),
        ("--scene", scene, terms.scene, terms.scene_hash, world.hash),
    )
    for option, given, name, before, now in rows:
        if before != now and given is None:
            raise InvalidRequest(option, name, f"{_built_for(option)}: this one differs")
        if before != now:
            notes.append(f"the roadmap was built for another {option[2:]}: {name}, {before[:12]}")
    return PlannerService(arm, world), notes


def _load_named(option: str, name: str, load: Callable[[str], T]) -> T:
    try:
        return load(name)
    except UnknownName as error:
        raise InvalidRequest(option, name, f"{_built_for(option)}: {error}") from None


def _built_for(option: str) -> str:
    return f"the file of the {option[2:]} that the roadmap was built for"


def load_libraries(request: PlanRequest, robot: Robot) -> None:
    """Time a trivial motion: it loads the libraries, which would otherwise count as time of the first stage."""
    law = replace(request.timing, torque=False) if isinstance(request.timing, ToppRa) else request.timing
    law.time_path(JointPath(np.array([robot.limits.lower, robot.limits.upper])), robot.limits)
    if request.optimise is not None:
        load_solver()
