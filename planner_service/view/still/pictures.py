"""A still picture of a plan, a task or a configuration as a PNG file, without a display or a browser.

::

    from planner_service.view.still.pictures import draw_plan

    draw_plan(service, request, service.plan(request), "plan.png")
"""

from __future__ import annotations

import io
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner_service.certify.certifier import clearance_text
from planner_service.collision import CheckCounts, CollisionChecker, Contact
from planner_service.errors import InvalidRequest
from planner_service.files.reading import as_path
from planner_service.files.writing import write_whole
from planner_service.gate.log import Logged
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_paths import Surface
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import PlanResult, Reason
from planner_service.planning.task_result import TaskResult
from planner_service.records.plan_file import SavedTask
from planner_service.robot.kinematic_tree import LinkShape
from planner_service.robot.model import Robot, length_unit
from planner_service.robot_setup.check_robot import FindingKind, RobotCheck
from planner_service.scene.names import Names
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService
from planner_service.view.regions import PLACES
from planner_service.view.still.composition import (
    GOAL,
    KEPT,
    START,
    TOOL_PATH,
    TOUCHING,
    WAY,
    Kind,
    Stand,
    View,
    bounds,
    picture,
    tool_path,
)
from planner_service.view.still.lettering import Caption
from planner_service.view.triangles import Colour

__all__ = [
    "OURS",
    "check_picture",
    "draw_check",
    "draw_plan",
    "draw_refusal",
    "draw_robot_check",
    "draw_task",
    "png_bytes",
    "refusal_caption",
    "refusal_picture",
    "refusal_stands",
    "task_picture",
    "webp_bytes",
    "write_png",
]

OURS = re.compile(rb"\x89PNG")
"""How pictures begin."""

Image = NDArray[np.uint8]
Key = tuple[Colour, str]

SIZE = (1280, 800)
"""Pixels, width and height, of every picture."""

QUALITY = 60
"""Of moving pictures, 0 to 100: thin lines stay sharp."""

FOUND = {
    FindingKind.REFUSED: (218, 44, 44),
    FindingKind.HOME: (218, 44, 44),
    FindingKind.VISUAL_ONLY: (196, 62, 190),
    FindingKind.DEGREES: (232, 176, 0),
    FindingKind.UNITS: (120, 84, 40),
    FindingKind.AXIS: (232, 176, 0),
    FindingKind.SIMPLIFIED: (40, 150, 160),
    FindingKind.OVERHANG: (240, 130, 50),
    FindingKind.FURNITURE: (70, 150, 90),
    FindingKind.FINGERS: (90, 90, 220),
    FindingKind.BLOCKED: (150, 110, 60),
    FindingKind.TOOL: (60, 160, 220),
}
"""Colours of links by what was found about them."""

ON_THE_WAY = 4
"""Robots between start and goal."""


def draw_plan(service: PlannerService, request: PlanRequest, result: PlanResult, file: str | os.PathLike[str]) -> None:
    """A picture of a plan: robot at the start, faint on the way, green at the goal, and its tool path.

    For a failure: start and goal, with what touches there in red.

    Raises:
        InvalidFile: the file cannot be written.
    """
    robot, scene = service.robot, service.scene
    view, caption = _failed(robot, scene, request, result) if result.path is None else _planned(service, result)
    write_png(file, picture(view, caption, SIZE))


def draw_task(service: PlannerService, task: TaskResult | SavedTask, file: str | os.PathLike[str]) -> None:
    """A picture of a task in the scene it begins in: the robot there, faint where motions end, and its tool path.

    Raises:
        InvalidFile: the file cannot be written.
    """
    write_png(file, task_picture(service, task))


def task_picture(service: PlannerService, task: TaskResult | SavedTask) -> Image:
    """The same picture, shape (height, width, 3)."""
    robot, ok = service.robot, task.failure is None
    results = [segment.result for segment in task.segments]
    paths = [result.path for result in results if result.path is not None]
    timed = [result.trajectory.duration for result in results if result.trajectory is not None]
    stands = [Stand(path(0.0)) for path in paths[:1]] + [Stand(path(path.length), WAY) for path in paths[:-1]]
    caption = Caption(
        f"{robot.name}: {task.task}{'' if ok else ': no plan'}",
        (
            _joined(f"{math.fsum(timed):.2f} s of motion in {len(timed)} parts", _counted(task.counts)),
            _proof(results) if ok else str(task.failure),
        ),
        _keys((START, WAY), tool=True),
    )
    lines = tuple(tool_path(robot, path) for path in paths)
    view = View(robot, service.scene, tuple(stands) or (Stand(robot.home),), lines)
    return picture(view, caption, SIZE)


def draw_check(checker: CollisionChecker, q: ArrayLike, file: str | os.PathLike[str]) -> None:
    """A picture of a configuration q (n,), what touches in red.

    Raises:
        InvalidRequest: as ``checker.contacts`` does, which is asked.
        InvalidFile: the file cannot be written.
    """
    file = as_path("file", file)
    write_png(file, check_picture(checker, q))


def check_picture(checker: CollisionChecker, q: ArrayLike) -> Image:
    """The same picture, shape (height, width, 3)."""
    instance("checker", checker, CollisionChecker, "a CollisionChecker")
    robot, scene = checker.robot, checker.scene
    contacts, clearance = checker.contacts(q), checker.clearance(q)
    room = "nothing to touch" if clearance == math.inf else f"clearance: at least {clearance * 1000:.1f} mm"
    verdict = "colliding" if contacts else "free"
    words = _joined(*map(str, contacts)) if contacts else room
    caption = Caption(f"{_where(robot, scene)}: {verdict}", (words,), _keys((), contacts))
    stand = Stand(np.asarray(q, dtype=np.float64), START, _names(contacts))
    return picture(View(robot, scene, (stand,)), caption, SIZE)


def draw_refusal(service: PlannerService, logged: Logged, file: str | os.PathLike[str]) -> None:
    """A picture of what a gate refused: the robot where it was, green where it comes to rest, red what would touch.

    Raises:
        InvalidRequest: nothing was refused, or neither where the robot was nor where it would touch is known.
        InvalidFile: the file cannot be written.
    """
    file = as_path("file", file)
    write_png(file, refusal_picture(service, logged))


def refusal_picture(service: PlannerService, logged: Logged) -> Image:
    """The same picture, shape (height, width, 3)."""
    refused, robot, scene = logged.refused, service.robot, service.scene
    shown = refusal_stands(logged)
    if refused is None or not shown:
        raise InvalidRequest("logged", logged, "a refusal that says where the robot was")
    stands = tuple(stand for stand, _ in shown)
    return picture(View(robot, scene, stands), refusal_caption(service, logged), SIZE)


def refusal_caption(service: PlannerService, logged: Logged) -> Caption:
    """What is written below a picture of a line of a gate's log."""
    refused = logged.refused
    said = f"slowed down to {logged.speed:.2f} of its speed" if refused is None else refused.detail
    what = "changed" if refused is None else f"refused ({refused.kind.value})"
    passed = "" if not logged.accepted else f"{logged.accepted} targets pass"
    stays = "" if logged.proven else "the arm is told to stay, without a proof"
    keys = [(stand.kind.colour, meaning) for stand, meaning in refusal_stands(logged) if not stand.touching]
    touching = any(stand.touching for stand, _ in refusal_stands(logged))
    red = [(TOUCHING, "would or could touch")] if touching else []
    return Caption(f"{_where(service.robot, service.scene)}: {what}", (said, _joined(passed, stays)), (*keys, *red))


def refusal_stands(logged: Logged) -> tuple[tuple[Stand, str], ...]:
    """Where the robot is drawn for a line of a gate's log, the first opaque, and what each means."""
    stands = list[tuple[Stand, str]]()
    if logged.q:
        stands.append((Stand(np.array(logged.q), START), "as measured"))
    if logged.rest:
        stands.append((Stand(np.array(logged.rest), GOAL if stands else START), "comes to rest"))
    refused = logged.refused
    if refused is not None and refused.at:
        kind = WAY if stands else START
        stands.append((Stand(np.array(refused.at), kind, frozenset(refused.pair or ())), "refused"))
    return tuple(stands)


def draw_robot_check(check: RobotCheck, file: str | os.PathLike[str]) -> None:
    """A picture of a robot at home, its links in the colours of what was found about them.

    Links that are never checked are drawn as the hulls of what they look like.

    Raises:
        InvalidRequest: nothing could be made of the robot.
        InvalidFile: the file cannot be written.
    """
    if check.robot is None:
        raise InvalidRequest("check", check.path, "the check of a URDF that a robot can be made of")
    kinds = [kind for kind in FOUND if any(finding.kind is kind for finding in check.findings)]
    by_link = {
        link: kind
        for kind in reversed(kinds)
        for finding in check.findings
        if finding.kind is kind
        for link in finding.links
    }
    unchecked = [link for link, kind in by_link.items() if kind is FindingKind.VISUAL_ONLY]
    shown = replace(check.robot, shapes=(*check.robot.shapes, *_looks(check, check.robot, unchecked)))
    drawn = {item.link for item in shown.shapes}
    colours = {link: FOUND[kind] for link, kind in by_link.items() if link in drawn}
    names = Names(shown, Scene())
    counts = Counter(finding.kind.value for finding in check.findings)
    words = ", ".join(f"{count} {kind}" for kind, count in counts.items()) or "nothing found"
    keys = tuple((FOUND[kind], kind.value) for kind in kinds)
    caption = Caption(f"{check.robot.name} at home", (words,), keys)
    stand = Stand(check.robot.home, marked={names.link(link): colour for link, colour in colours.items()})
    write_png(file, picture(View(shown, Scene(), (stand,)), caption, SIZE))


def _looks(check: RobotCheck, robot: Robot, links: Iterable[str]) -> Iterator[LinkShape]:
    """What links look like, as shapes: the hulls of meshes, but for flat ones."""
    for link in links:
        body, T_body_link = check.fingers[link] if link in check.fingers else robot.link_frame(link)
        for item in check.visuals[link]:
            shape = item.appearance
            if isinstance(shape, Surface):
                try:
                    shape = Mesh(shape.vertices)
                except InvalidRequest:
                    continue
            yield LinkShape(link, body, shape, Pose.from_matrix(T_body_link) @ item.pose)


def write_png(file: str | os.PathLike[str], image: Image) -> None:
    """Write a picture (height, width, 3); the file is there whole or not at all.

    Raises:
        InvalidFile: it cannot be written.
    """
    write_whole(as_path("file", file), png_bytes(image), OURS)


def png_bytes(image: Image) -> bytes:
    """A picture (height, width, 3) as the bytes of a PNG file."""
    from PIL import Image as Pictures

    content = io.BytesIO()
    Pictures.fromarray(image).save(content, "PNG", optimize=True)
    return content.getvalue()


def webp_bytes(images: Sequence[Image], rate: float, end: float) -> bytes:
    """Pictures (height, width, 3), ``rate`` of them a second, as the bytes of a WebP file that begins again at its end.

    Args:
        end: Seconds for which the last one stays.
    """
    from PIL import Image as Pictures

    first, *rest = map(Pictures.fromarray, images)
    shown = [*[round(1000 / rate)] * len(rest), round(1000 * end)]
    content = io.BytesIO()
    first.save(
        content, "WEBP", save_all=True, append_images=rest, duration=shown, loop=0, quality=QUALITY, method=4, kmax=0
    )
    return content.getvalue()


def _planned(service: PlannerService, result: PlanResult) -> tuple[View, Caption]:
    robot, (path, trajectory) = service.robot, result.unwrap()
    places = [path(path.length * k / (ON_THE_WAY + 1)) for k in range(ON_THE_WAY + 2)]
    kinds = [START, *[WAY] * ON_THE_WAY, GOAL]
    moved = f"{trajectory.duration:.2f} s of motion", f"path {path.length:.2f} {length_unit(robot)}".rstrip()
    words = (_joined(*moved, _counted(result.counts)), _proof([result]))
    region = bounds(robot, result.constraints, path(np.linspace(0.0, path.length, PLACES)))
    keys = _keys((START, WAY, GOAL), tool=True, region=bool(region))
    caption = Caption(f"{_where(robot, service.scene)}: planned", words, keys)
    stands = tuple(Stand(q, kind) for q, kind in zip(places, kinds, strict=True))
    return View(robot, service.scene, stands, (tool_path(robot, path), *region)), caption


def _failed(robot: Robot, scene: Scene, request: PlanRequest, result: PlanResult) -> tuple[View, Caption]:
    """The start and the goals of a failed plan, and why it failed."""
    failure = result.failure
    contacts = () if failure is None else failure.contacts
    at_start = failure is not None and failure.reason is Reason.START_IN_COLLISION
    stands = [Stand(np.asarray(request.start, dtype=np.float64), START, _names(contacts if at_start else ()))]
    poses = [goal for goal in request.goals(robot) if isinstance(goal, Pose | PoseGoal)]
    frames = tuple(goal.pose if isinstance(goal, PoseGoal) else goal for goal in poses)
    joint_goals = [goal for goal in request.goals(robot) if not isinstance(goal, Pose | PoseGoal)]
    stands += [Stand(goal, GOAL, _names(() if at_start else contacts)) for goal in joint_goals]
    words = "" if failure is None else failure.detail
    reason = "" if failure is None else f" ({failure.reason.value})"
    kinds = [stand.kind for stand in stands]
    title = f"{_where(robot, scene)}: no plan{reason}"
    region = bounds(robot, result.constraints, np.array([stand.q for stand in stands]))
    caption = Caption(title, (words, _counted(result.counts)), _keys(kinds, contacts, region=bool(region)))
    return View(robot, scene, tuple(stands), region, frames), caption


def _where(robot: Robot, scene: Scene) -> str:
    return f"{robot.name} in {scene.name or 'a scene'}"


def _names(contacts: Iterable[Contact]) -> frozenset[str]:
    return frozenset(name for contact in contacts for name in (contact.a, contact.b))


MEANINGS = ((START, "start"), (WAY, "on the way"), (GOAL, "goal"))


def _keys(
    kinds: Sequence[Kind], contacts: Sequence[Contact] = (), *, tool: bool = False, region: bool = False
) -> tuple[Key, ...]:
    """What the colours mean."""
    keys = [(kind.colour, meaning) for kind, meaning in MEANINGS if kind in kinds]
    keys += [(TOOL_PATH, "tool path")] if tool else []
    keys += [(KEPT, "constraints")] if region else []
    return (*keys, *([(TOUCHING, "touching")] if contacts else []))


def _joined(*parts: str) -> str:
    return " \u00b7 ".join(filter(None, parts))


def _counted(counts: CheckCounts) -> str:
    return f"checked: {', '.join(f'{name} {count:,}' for name, count in counts.named.items())}"


def _proof(results: Iterable[PlanResult]) -> str:
    """What is proven of motions, in words."""
    proofs = [result.certificate for result in results if result.certificate is not None and result.ok]
    least = min((proof.clearance for proof in proofs), default=None)
    return "" if least is None else f"proven: {clearance_text(least)}, between samples too"
