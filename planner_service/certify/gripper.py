"""The proof of a gripper that opens or closes while the arm stands still.

This is the motion of a robot with one more joint, which moves the fingers, while all others stand still; s is how far
they have moved: by half of what the width changes, or, if they turn, by an angle of their leader.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify.certifier import LIMIT_SLACK, Certificate, Certifier, ExemptInterval, Refusal, Trail
from planner_service.certify.pairs import pairs_of_names
from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import instance, items, number, numbers
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import AllowedContact, JointLimits, Robot
from planner_service.scene.scene import Scene

__all__ = ["GripperCertifier", "GripperMotion", "certify_gripper"]

FINGERS = "gripper"
"""The joint that moves the fingers."""


@dataclass(frozen=True)
class GripperMotion:
    """The gripper opening or closing while the arm stands still, and what is proven of it.

    Attributes:
        start: Metres between the finger pads before.
        end: The same after.
        certificate: The proof; its s is how far each finger has moved, in metres, or the leader of turning fingers, in
            radians.
        seconds: Wall time of the proof.
        travel: The largest s, where it is not half of what the width changes; None where it is.
    """

    start: float
    end: float
    certificate: Certificate
    seconds: float = field(default=0.0, compare=False)
    travel: float | None = None

    @property
    def name(self) -> str:
        """What it is, in words."""
        return "gripper opens" if self.end > self.start else "gripper closes"

    @property
    def refused(self) -> str:
        """Which pair could not be proven apart, and at what width; empty if all is proven."""
        refusal = self.certificate.refusal
        if not isinstance(refusal, Refusal):
            return ""
        verb, sign = ("open", 2.0) if self.end > self.start else ("close", -2.0)
        width = self.start + sign * refusal.s
        if self.travel is not None:
            width = self.start + (self.end - self.start) * refusal.s / self.travel
        motion = f"the gripper cannot {verb} from {self.start * 1e3:.1f} to {self.end * 1e3:.1f} mm"
        return f"{motion}: {refusal.a} x {refusal.b} are not proven apart at a width of {width * 1e3:.1f} mm"


class GripperCertifier:
    """Proves motions of the gripper of one robot, however far it is open now, in one scene.

    Args:
        allowed: Pairs of links or objects that may touch anyway.

    Raises:
        InvalidRequest: the robot has no gripper.
        UnknownName: a pair names nothing that is there.
    """

    def __init__(self, robot: Robot, scene: Scene, *, allowed: Iterable[tuple[str, str]] = ()) -> None:
        self._robot, gripper = instance("robot", robot, Robot, "a Robot"), robot.gripper
        if gripper is None:
            raise InvalidRequest("robot", robot.name, "a robot with a gripper")
        self._gripper = gripper
        self._certifier = Certifier(_with_fingers(robot.unopened), scene, allowed=allowed, still=robot.joint_names)

    def certify(
        self,
        q: ArrayLike,
        widths: tuple[float, float],
        *,
        touching: Sequence[tuple[str, str]] = (),
        reason: str = "",
        charge: Callable[[int], None] | None = None,
        trail: Trail | None = None,
    ) -> GripperMotion:
        """See ``certify_gripper``.

        Raises:
            InvalidRequest: q is outside the joint limits, or a width outside the gripper's range.
            UnknownName: a pair names nothing that is there.
        """
        began, gripper, stands = time.perf_counter(), self._gripper, _within(self._robot, q)
        expected = f"a gap between the finger pads in [{gripper.lower:g}, {gripper.upper:g}] m"
        given = items("widths", widths, object, expected, 2)
        if len(given) != 2:
            raise InvalidRequest("widths", widths, "one before and one after")
        start, end = (number("width", width, expected, gripper.lower, gripper.upper) for width in given)
        path = JointPath(np.array([[*stands.tolist(), gripper.position(width)] for width in (start, end)]))
        pairs = pairs_of_names("touching", touching)
        exempt = [ExemptInterval(0.0, path.length, pairs, reason)] if pairs else []
        certificate = self._certifier.certify(path, exempt=exempt, charge=charge, trail=trail)
        travel = None if gripper.kind == "parallel" else path.length
        return GripperMotion(start, end, certificate, time.perf_counter() - began, travel)


def certify_gripper(
    robot: Robot,
    scene: Scene,
    q: ArrayLike,
    widths: tuple[float, float],
    *,
    allowed: Iterable[tuple[str, str]] = (),
    touching: Sequence[tuple[str, str]] = (),
    reason: str = "",
    charge: Callable[[int], None] | None = None,
    trail: Trail | None = None,
) -> GripperMotion:
    """The proof that no finger comes near anything between two widths while the arm stands at q (n,), or its refusal.

    What does not move meanwhile is not judged. What the robot holds stands where it is.

    Args:
        widths: Metres between the finger pads, before and after.
        allowed: Pairs of links or objects that may touch anyway.
        touching: Pairs that may touch on this motion, such as fingers and what they close on.
        reason: Why they may.
        trail: Filled with what the proof rests on.

    Raises:
        InvalidRequest: the robot has no gripper, q is outside its joint limits, or a width outside the gripper's range.
        UnknownName: a pair names nothing that is there.
    """
    certifier = GripperCertifier(robot, scene, allowed=allowed)
    return certifier.certify(q, widths, touching=touching, reason=reason, charge=charge, trail=trail)


def _within(robot: Robot, q: ArrayLike) -> FloatArray:
    """A configuration, its rounding beyond the limits taken off."""
    expected = f"{robot.n} joint values within the limits of {robot.name}"
    values, (lower, upper) = numbers("q", q, expected), robot.bounds
    if values.shape != (robot.n,):
        raise InvalidRequest("q", values.tolist(), expected)
    inside = np.clip(values, lower, upper)
    if not np.all(np.abs(inside - values) <= LIMIT_SLACK):  # False for NaN
        raise InvalidRequest("q", values.tolist(), expected)
    return np.asarray(inside)


@lru_cache(maxsize=16)
def _with_fingers(robot: Robot) -> Robot:
    """The robot, its fingers being moved by one more joint.

    A finger and what else is on the body that carries it slide in each other, and are not judged, as ever.
    """
    gripper = robot.gripper
    if gripper is None:
        raise BrokenInvariant("a robot without a gripper has no fingers to move")
    moving, fingers = gripper.finger_bodies(len(robot.bodies), robot.n)
    rest = [item for item in robot.shapes if item.link not in gripper.links]
    guides = [
        AllowedContact((carried.link, item.link), "on one body")
        for carried in gripper.closed
        for item in (*rest, *gripper.closed)
        if item.body == carried.body and item.link != carried.link
    ]
    ends = sorted(gripper.position(width) for width in (gripper.lower, gripper.upper))
    extent = dict(zip(("lower", "upper"), ends, strict=True))
    limits = {
        item.name: np.append(getattr(robot.limits, item.name), extent.get(item.name, 1.0))
        for item in fields(JointLimits)
    }
    return replace(
        robot,
        joint_names=(*robot.joint_names, FINGERS),
        limits=JointLimits(**limits),
        named_poses=(),
        bodies=(*robot.bodies, *moving),
        shapes=(*rest, *fingers),
        allowed_contacts=(*robot.allowed_contacts, *guides),
        gripper=None,
        retreats=(),
        continuous=(*robot.continuous, False) if robot.continuous else (),
        dynamics=None,
    )
