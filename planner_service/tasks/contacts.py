"""Where the gripper closes or opens: grasps and placements, each with what it changes in the world.

Contact is meant there and nowhere else. On the last approach to what is taken, and on the first retreat from what is
left, the fingers may touch it if that motion goes along the gripper's own axis; so they may while they close or open.
What is carried may touch its support on the first retreat, and on the last approach, within ``support_gap`` of where it
stood or will stand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

from planner_service.collision import CollisionChecker
from planner_service.constraints import Constraint, KeepUpright
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.grasping.grasps import width_across
from planner_service.grasping.guards import grasp_objection, unwanted
from planner_service.grasping.kinds import GraspKind, GraspKinds
from planner_service.grasping.openings import opened, openings
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import Robot
from planner_service.scene.names import Names
from planner_service.scene.scene import Attached, Obstacle
from planner_service.service import PlannerService
from planner_service.tasks.motions import Motions, NoMotion, Touch
from planner_service.tasks.steps import Grasp, GraspSource, Release

__all__ = [
    "Choices",
    "Contact",
    "choices_of",
    "contact_here",
    "fingers_of",
    "frame_of",
    "gripper_of",
    "kept_upright",
    "placed_poses",
]

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Contact:
    """One place where the gripper closes or opens.

    Attributes:
        tool: The tool's pose there.
        width: Metres between the fingers on the way in.
        then: The same on the way out.
        services: Make the services that plan the way in, and the way out.
        less: Makes the same with the opening of another rank, None if that is no other.
        objection: Why a configuration there would not do, as the checker of the way in sees it; empty if it would.
        fingers: What the fingers may touch.
        standing: What the object may touch: before it is released, or once it is taken.
        gap: Metres within which it may.
        takes: Whether the object is taken there, not left.
        note: What every reason says of an opening that is less than usual.
        usual: What reasons about fingers say of the usual one, where it is open at the contact.
    """

    tool: Pose
    width: float
    then: float
    services: tuple[Callable[[], PlannerService], Callable[[], PlannerService]]
    less: Callable[[int], Contact | None]
    objection: Callable[[CollisionChecker, FloatArray], str]
    fingers: Touch
    standing: tuple[Touch, ...]
    gap: float
    takes: bool
    note: str = ""
    usual: str = ""

    def says(self, reason: str, *, fingers: bool) -> str:
        """A reason with how wide the gripper is open, where that is less than usual or fingers are what it is about."""
        return f"{self.note or (self.usual if fingers else '')}{reason}"

    @cached_property
    def before(self) -> PlannerService:
        """What plans the way in; made when first needed, as most grasps turn out to be out of reach before that."""
        return self.services[0]()

    @cached_property
    def after(self) -> PlannerService:
        """What plans the way out."""
        return self.services[1]()

    def touches(self, *, inward: bool, along_axis: bool) -> tuple[Touch, ...]:
        """What may touch on the line to the contact, or from it."""
        fingers = (self.fingers,) if inward == self.takes and along_axis else ()
        standing = self.standing if inward != self.takes else ()
        return (*fingers, *standing)


class Choices:
    """The grasps or placements of one kind, best first, each made when it is first asked for.

    Attributes:
        kind: What reasons call it; empty for the usual one, and for poses that were given.
        count: How many there are.
        why: Why there are none.
    """

    def __init__(self, kind: str, poses: Sequence[Pose], make: Callable[[Pose], Contact], why: str = "") -> None:
        self.kind, self.count, self.why = kind, len(poses), why
        self._poses, self._make = poses, make
        self._made: dict[int, Contact | NoMotion] = {}

    def contact(self, k: int) -> Contact:
        """The one of number k, with the usual opening.

        Raises:
            NoMotion: The gripper cannot be opened as it should be.
        """
        if k not in self._made:
            try:
                self._made[k] = self._make(self._poses[k])
            except NoMotion as none:
                self._made[k] = none
        made = self._made[k]
        if isinstance(made, NoMotion):
            raise made
        return made


def choices_of(motions: Motions, service: PlannerService, step: Grasp | Release) -> Iterator[Choices]:
    """The grasps or placements of a step, kind by kind; a kind is looked for once the ones before it are not enough.

    Raises:
        NoMotion: There can be none.
    """
    if isinstance(step, Release):
        held = _held(service, step.object)
        yield Choices("", placed_poses(service, step), partial(_placing, motions, service, held, step=step))
        return
    obstacle = service.scene.obstacle(step.object)
    make = partial(_grasping, motions, service, obstacle, step=step)
    if isinstance(step.grasps, GraspKinds | None):
        kinds = GraspKinds() if step.grasps is None else step.grasps
        for kind, poses, why in _found(partial(motions.grasps, kinds, service.robot, obstacle)):
            none = f"no {kind.value} grasp: expected {why}" if why else ""
            yield Choices("" if kind is GraspKind.TOP else kind.value, poses, make, none)
        return
    if isinstance(step.grasps, GraspSource):
        given: Sequence[Pose] = _found(partial(step.grasps.poses, service.robot, obstacle))
    else:
        frame = frame_of(service, step.frame)
        given = step.grasps if frame is None else [frame @ pose for pose in step.grasps]
    yield Choices("", given, make, "" if given else f"no grasp of {step.object} was found")


def _found(find: Callable[[], T]) -> T:
    try:
        return find()
    except InvalidRequest as error:
        raise NoMotion(str(error)) from error


def _grasping(
    motions: Motions, service: PlannerService, target: Obstacle, grasp: Pose, *, step: Grasp, rank: int = 0
) -> Contact:
    """A grasp, with the opening of a rank, the widest first."""
    gripper = gripper_of(service.robot)
    width = width_across(target, grasp, service.robot)
    widths = _openings(gripper, width, step.open_width)

    def before() -> PlannerService:
        return motions.changed(service, gripper=widths[rank])

    def after() -> PlannerService:
        kept = () if step.upright is None else (kept_upright(grasp, step.upright),)
        pose = grasp.inverse() @ target.pose
        held = Attached(target.name, target.shape, pose, touch_links=fingers_of(service), constraints=kept)
        scene = service.scene.without(target.name).with_attached(held)
        return motions.changed(service, gripper=width, scene=scene)

    touch = Touch(_touching(service, target.name), None, gripper.touching(target.name, "take"))

    def objection(checker: CollisionChecker, q: FloatArray) -> str:
        return grasp_objection(target, grasp, service.robot) or unwanted(checker, q, touch.pairs)

    return Contact(
        tool=grasp,
        width=widths[rank],
        then=width,
        services=(before, after),
        less=lambda other: (
            _grasping(motions, service, target, grasp, step=step, rank=other) if other < len(widths) else None
        ),
        objection=objection,
        fingers=touch,
        standing=_standing(service, step),
        gap=step.support_gap,
        takes=True,
        note=f"{opened(gripper, widths[rank])}: " if rank else "",
        usual="" if rank or gripper.kind == "vacuum" else f"{opened(gripper, widths[rank])}: ",
    )


def _openings(gripper: Gripper, width: float, wanted: float | None) -> tuple[float, ...]:
    try:
        return openings(gripper, width, wanted)
    except InvalidRequest as error:
        raise NoMotion(str(error)) from error


def contact_here(motions: Motions, service: PlannerService, step: Grasp | Release, q: FloatArray) -> Contact:
    """The contact with the tool where it is at q (n,), and for a grasp with the gripper opened as it is.

    Raises:
        NoMotion: The gripper is not open enough, or the object is not carried.
    """
    tool = Pose.from_matrix(service.robot.tool_pose(q))
    if isinstance(step, Release):
        held = _held(service, step.object)
        return _placing(motions, service, held, tool @ held.pose, step=step)
    obstacle, robot = service.scene.obstacle(step.object), service.robot
    if gripper_of(robot).kind != "vacuum":
        step = replace(step, open_width=robot.gripper_width)
    return _grasping(motions, service, obstacle, tool, step=step)


def kept_upright(grasp: Pose, tolerance: float) -> Constraint:
    """What an object keeps that was taken at a grasp and may lean by so many radians from how it stood."""
    up = grasp.inverse().rotation[:, 2]  # in the tool frame
    return KeepUpright(up.tolist(), tolerance)


# Placements.


def placed_poses(service: PlannerService, step: Release) -> Sequence[Pose]:
    """Where the object of a release may be set down, in the base frame.

    Raises:
        NoMotion: The frame in which the poses are given does not stand anywhere.
    """
    frame, poses = frame_of(service, step.frame), step.poses or ()
    return poses if frame is None else [frame @ pose for pose in poses]


def _placing(
    motions: Motions, service: PlannerService, held: Attached, pose: Pose, *, step: Release, rank: int = 0
) -> Contact:
    """A placement, with the opening of a rank, the widest first."""
    gripper, names = gripper_of(service.robot), Names(service.robot, service.scene)
    widths = _openings(gripper, service.robot.gripper_width, step.open_width)

    def after() -> PlannerService:
        scene = service.scene.without_attached(held.name).with_obstacle(Obstacle(held.name, held.shape, pose))
        return motions.changed(service, gripper=widths[rank], scene=scene)

    def objection(checker: CollisionChecker, q: FloatArray) -> str:
        if step.support is None:
            return ""
        pair = (names.object(held.name), names.object(step.support))
        roomy = checker.variant(padding=step.support_gap)
        if pair not in roomy.touching(q):
            return f"{held.name} would not come within {step.support_gap * 1000:g} mm of {step.support}"
        return unwanted(checker, q, (pair,))

    return Contact(
        tool=pose @ held.pose.inverse(),
        width=service.robot.gripper_width,
        then=widths[rank],
        services=(lambda: service, after),
        less=lambda other: (
            _placing(motions, service, held, pose, step=step, rank=other) if other < len(widths) else None
        ),
        objection=objection,
        fingers=Touch(_touching(service, held.name), None, gripper.touching(held.name, "leave")),
        standing=_standing(service, step),
        gap=step.support_gap,
        takes=False,
        note=f"{opened(gripper, widths[rank])}: " if rank else "",
    )


def _held(service: PlannerService, name: str) -> Attached:
    held = next((each for each in service.scene.attached if each.name == name), None)
    if held is None:
        raise NoMotion(f"{name} is not carried")
    return held


# What both have in common.


def gripper_of(robot: Robot) -> Gripper:
    """The gripper of a robot.

    Raises:
        InvalidRequest: It has none.
    """
    if robot.gripper is None:
        raise InvalidRequest("robot", robot.name, "a robot with a gripper")
    return robot.gripper


def frame_of(service: PlannerService, name: str) -> Pose | None:
    """Where an obstacle's frame is in the base frame; None for the base.

    Raises:
        NoMotion: It does not stand anywhere: it is carried.
    """
    if not name:
        return None
    found = next((obstacle for obstacle in service.scene.obstacles if obstacle.name == name), None)
    if found is None:
        raise NoMotion(f"{name} is carried, and has no frame")
    return found.pose


def fingers_of(service: PlannerService) -> tuple[str, ...]:
    """The finger links that can touch anything."""
    shaped = {shape.link for shape in service.robot.shapes}
    return tuple(link for link in gripper_of(service.robot).links if link in shaped)


def _touching(service: PlannerService, name: str) -> tuple[tuple[str, str], ...]:
    """The labels of each finger and an object."""
    names = Names(service.robot, service.scene)
    return tuple((names.link(finger), names.object(name)) for finger in fingers_of(service))


def _standing(service: PlannerService, step: Grasp | Release) -> tuple[Touch, ...]:
    if step.support is None:
        return ()
    names = Names(service.robot, service.scene)
    standing, support = names.object(step.object), names.object(service.scene.obstacle(step.support).name)
    return (Touch(((standing, support),), step.support_gap, f"{standing} stands on {support}"),)
