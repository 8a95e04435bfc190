"""What worked before: motions as hints for plans between nearby ends, and where the gripper closed and opened.

Nothing here is believed. A motion that a hint leads to is proven anew, in the scene as it is and with all of the
padding; a hint that is refused costs this proof, and the plan goes on as it would have without. Where a gripper closed
decides only which grasp or placement is tried first.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, joint_distance, read_only, set_fields
from planner_service.geometry.validation import (
    MAX_LENGTH,
    checked_name,
    finite_numbers,
    instance,
    items,
    number,
    numbers,
)
from planner_service.provided import Provided
from planner_service.robot.model import Robot

__all__ = [
    "MAX_GRIPS",
    "MAX_JOINTS",
    "MAX_MOTIONS",
    "MAX_WAYPOINTS",
    "NOTHING",
    "Hint",
    "Memory",
    "checked_memory",
    "gripped_near",
    "hints",
    "knows",
    "load_memory",
    "save_memory",
]

save_memory: Provided[[Memory, str | os.PathLike[str]], None] = Provided()
load_memory: Provided[[str | os.PathLike[str]], Memory] = Provided()

MAX_MOTIONS = 1_000
"""Motions that a memory keeps, those longest unused forgotten first: a pallet of 100 places has about 300."""

MAX_GRIPS = 1_000
"""Places where the gripper closed or opened that it keeps, forgotten likewise."""

MAX_WAYPOINTS = 100
"""Waypoints of a motion that is kept: more come of constraints, and would hardly be kept where the ends differ."""

MAX_JOINTS = 100

SAME = 0.05
"""Radians, summed over both ends, up to which a newer motion takes the place of another; between two grips."""

NEAR = 0.6
"""Radians, summed over both ends, up to which a motion is a hint."""

NEAR_GRIP, SAME_WIDTH = 0.3, 1e-4
"""Radians between two configurations up to which a grip at one is a hint for the other; metres of an opening."""

MAX_HINTS = 3
"""Of a plan: each that is refused costs a proof."""


class Hint(NamedTuple):
    """The inner waypoints (m, n) of a motion between nearby ends, and the number of the goal to which it leads."""

    inner: FloatArray
    goal: int


@dataclass(frozen=True, eq=False, repr=False)
class Memory:
    """Motions and grips that worked, as hints for the next: a value, which plans do not change.

    Pass it to ``PlannerService.plan``, or to a task; ``result.memory`` is what is known after it. The same memory and
    request give the same plan and counts in any process.

    Attributes:
        joint_names: Those of the robot; none as long as nothing is remembered.
        motions: Waypoints (k, n) of each, those used last at the end.
        grips: Where tasks closed or opened the gripper, (n + 2,) each: q, and its opening before and after in metres.

    Raises:
        InvalidRequest: There are more than 1,000 motions or grips, a motion is not 2 to 100 rows of finite values of
            the joints, or a grip not one and two openings.
    """

    joint_names: tuple[str, ...] = ()
    motions: tuple[FloatArray, ...] = ()
    grips: tuple[FloatArray, ...] = ()

    def __post_init__(self) -> None:
        names = items("joint_names", self.joint_names, str, "names of joints", MAX_JOINTS)
        given = items("motions", self.motions, object, "a list of waypoints (k, n)", MAX_MOTIONS)
        joint_names = tuple(checked_name(f"joint_names[{k}]", name) for k, name in enumerate(names))
        motions = tuple(_checked(f"motions[{k}]", motion, len(names)) for k, motion in enumerate(given))
        taken: tuple[Any, ...] = items("grips", self.grips, object, "a list of grips (n + 2,)", MAX_GRIPS)
        grips = tuple(_grip(f"grips[{k}]", grip, len(names)) for k, grip in enumerate(taken))
        set_fields(self, joint_names=joint_names, motions=motions, grips=grips)

    def __repr__(self) -> str:
        return f"<Memory: {len(self.motions)} motions, {len(self.grips)} grips>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Memory, (self.joint_names, self.motions, self.grips)

    def require_joints(self, joint_names: Sequence[str]) -> Memory:
        """The memory itself, if it can be of a robot with these joints.

        Raises:
            InvalidRequest: It is another robot's.
        """
        if self.joint_names not in ((), tuple(joint_names)):
            raise InvalidRequest("memory", f"motions of {', '.join(self.joint_names)}", f"of {', '.join(joint_names)}")
        return self

    def with_motion(self, waypoints: ArrayLike, joint_names: Sequence[str]) -> Memory:
        """What is known with another motion, (k, n), which takes the place of one between the same ends.

        Raises:
            InvalidRequest: It is not 2 rows or more of finite values of the joints, or these are another robot's.
        """
        names = items("joint_names", joint_names, str, "names of joints", MAX_JOINTS)
        self.require_joints(names)
        motion = _checked("waypoints", waypoints, len(names), math.inf)
        if len(motion) > MAX_WAYPOINTS or not np.any(motion[0] != motion[-1]):
            return self
        kept = self.motions
        if kept:
            forth, _ = _away(self, motion[0], motion[-1:])
            same = (forth <= SAME)[:, 0].tolist()
            kept = tuple(known for known, gone in zip(kept, same, strict=True) if not gone)
        return self._with(names, (*kept[1 - MAX_MOTIONS :], motion), self.grips)

    def with_grip(self, grip: ArrayLike, joint_names: Sequence[str]) -> Memory:
        """What is known with another grip, (n + 2,), which takes the place of the same one.

        Raises:
            InvalidRequest: It is not n finite values of the joints and two openings, or the joints are another robot's.
        """
        names = items("joint_names", joint_names, str, "names of joints", MAX_JOINTS)
        self.require_joints(names)
        row = _grip("grip", grip, len(names))
        kept = tuple(known for known in self.grips if not _same_grip(known, row))
        return self._with(names, self.motions, (*kept[1 - MAX_GRIPS :], row))

    @staticmethod
    def _with(names: tuple[str, ...], motions: tuple[FloatArray, ...], grips: tuple[FloatArray, ...]) -> Memory:
        """A memory of what is known to be right."""
        known = object.__new__(Memory)
        set_fields(known, joint_names=names, motions=motions, grips=grips)
        return known

    @cached_property
    def ends(self) -> FloatArray:
        """Where the motions begin, then where they end, (2 N, n)."""
        return np.array([*(motion[0] for motion in self.motions), *(motion[-1] for motion in self.motions)])

    @cached_property
    def closed(self) -> list[tuple[list[float], float, float]]:
        """The grips: joint values, and the opening before and after."""
        return [(row[:-2], row[-2], row[-1]) for row in (grip.tolist() for grip in self.grips)]

    @cached_property
    def hash(self) -> str:
        """SHA-256 of all that is remembered; equal in every process."""
        content = hashlib.sha256(repr(self.joint_names).encode())
        for kind in (self.motions, self.grips):
            content.update(repr(len(kind)).encode())
            for each in kind:
                content.update(repr(each.shape).encode())
                content.update(each.tobytes())
        return content.hexdigest()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it to a JSON file, whole or not at all; ``load`` returns one with the same hash.

        Raises:
            InvalidFile: It cannot be written.
        """
        save_memory(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Memory:
        """The memory in a file that ``save`` wrote.

        Raises:
            InvalidFile: It is not such a file, it is truncated or was changed, or another version of the package wrote
                it.
        """
        return load_memory(path)


NOTHING = Memory()
"""Where a memory begins."""


def checked_memory(memory: object, robot: Robot) -> Memory:
    """The memory that a caller gave, an empty one for None.

    Raises:
        InvalidRequest: It is no memory, or that of another robot.
    """
    if memory is None:
        return NOTHING
    return instance("memory", memory, Memory, "a Memory, or None").require_joints(robot.joint_names)


def knows(memory: Memory, start: FloatArray, end: FloatArray) -> bool:
    """Whether a motion from near one of these configurations (n,) to near the other is remembered."""
    if not memory.motions:
        return False
    forth, back = _away(memory, start, end[None])
    return bool(min(forth.min(), back.min()) <= NEAR)


def hints(memory: Memory, start: FloatArray, goals: Sequence[FloatArray]) -> list[Hint]:
    """Motions from near a start (n,) to near one of the goals, or back, the nearest first; three at most."""
    if not memory.motions or not len(goals):
        return []
    away = np.concatenate(_away(memory, start, np.array(goals)))
    rows, columns = np.nonzero(away <= NEAR)
    count = len(memory.motions)
    order = np.lexsort((columns, -(rows % count), away[rows, columns]))[:MAX_HINTS]
    return [
        Hint(memory.motions[row % count][:: 1 if row < count else -1][1:-1], column)
        for row, column in zip(rows[order].tolist(), columns[order].tolist(), strict=True)
    ]


def _checked(name: str, motion: object, joints: int, most: float = MAX_WAYPOINTS) -> FloatArray:
    """The waypoints of a motion, (k, n), read-only."""
    expected = f"2 to {MAX_WAYPOINTS} rows of {joints} finite joint values"
    rows = numbers(name, motion, expected)
    if rows.ndim != 2 or rows.shape[1] != joints or not 2 <= len(rows) <= most or not np.isfinite(rows).all():
        raise InvalidRequest(name, rows.shape, expected)
    return read_only(np.ascontiguousarray(rows))


def _grip(name: str, grip: ArrayLike, joints: int) -> FloatArray:
    """A grip, (joints + 2,), read-only."""
    row = finite_numbers(name, grip, joints + 2)
    for width in row[-2:].tolist():
        number(name, width, "openings of at least 0 m after the joint values", 0.0, MAX_LENGTH)
    return read_only(row)


def _same_grip(a: FloatArray, b: FloatArray) -> bool:
    return joint_distance(a[:-2].tolist(), b[:-2].tolist()) <= SAME and bool(np.all(np.abs(a - b)[-2:] <= SAME_WIDTH))


def gripped_near(memory: Memory, q: FloatArray, before: float, after: float) -> bool:
    """Whether the gripper closed or opened like this near q (n,)."""
    at = q.tolist()
    return any(
        joint_distance(grip, at) <= NEAR_GRIP
        for grip, opened, closed in memory.closed
        if abs(opened - before) <= SAME_WIDTH and abs(closed - after) <= SAME_WIDTH
    )


def _away(memory: Memory, start: FloatArray, goals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radians, summed over both ends, between N remembered motions and those from a start (n,) to goals (m, n), and
    between the same motions the other way round and those, (N, m) each."""
    count = len(memory.motions)
    apart = _apart(memory.ends, np.concatenate([start[None], goals]))
    begins, ends = apart[:count], apart[count:]
    return begins[:, :1] + ends[:, 1:], ends[:, :1] + begins[:, 1:]


def _apart(a: FloatArray, b: FloatArray) -> FloatArray:
    """L2 distances between configurations a (N, n) and b (m, n), (N, m), summed in joint order."""
    total = np.zeros((len(a), len(b)))
    for one, two in zip(a.T, b.T, strict=True):
        difference = one[:, None] - two[None, :]
        total = total + difference * difference
    return np.asarray(np.sqrt(total))
