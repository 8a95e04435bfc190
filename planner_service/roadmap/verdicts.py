"""Verdicts on milestones and edges, the obstacles that block them, and the terms on which these depend."""

from __future__ import annotations

import enum
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner_service.collision import CollisionChecker
from planner_service.collision.edge_sampling import EdgeStep, FinestStep, JointStep, MotionStep
from planner_service.geometry.arrays import BoolArray
from planner_service.search.problem import SELF

__all__ = ["SELF", "UNKNOWN_BLOCKER", "Knowledge", "Lesson", "Terms", "Verdict"]


Verdicts = NDArray[np.int8]
Blockers = NDArray[np.int32]

UNKNOWN_BLOCKER = -1
"""The index of an unknown blocker."""

Lesson = tuple["Verdict", str | None]
"""A verdict and, if it is BLOCKED, the obstacle in the way, ``SELF``, or None if that is not known."""


class Verdict(enum.IntEnum):
    """The verdict on a milestone or an edge."""

    UNKNOWN = 0
    """Not checked."""
    FREE = 1
    """Free at its samples."""
    BLOCKED = 2
    """Not free."""
    FREE_BEFORE = 3
    """Free before some obstacles came or moved."""
    BLOCKED_BEFORE = 4
    """Blocked by an obstacle that has since gone or moved."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """The verdicts on all milestones, or on all edges.

    Attributes:
        verdicts: A ``Verdict`` for each, (k,), read-only.
        blockers: For each that is BLOCKED the index in ``names`` of what blocks it, or -1, (k,), read-only.
        names: Names of obstacles, and ``SELF``.
    """

    verdicts: Verdicts
    blockers: Blockers
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.verdicts, self.blockers):
            array.flags.writeable = False

    @classmethod
    def none(cls, count: int) -> Knowledge:
        """``count`` unknown verdicts."""
        return cls(np.zeros(count, dtype=np.int8), np.full(count, UNKNOWN_BLOCKER, dtype=np.int32))

    def with_lessons(self, lessons: Mapping[int, Lesson]) -> Knowledge:
        """These verdicts updated with new ones, by their numbers; numbers beyond the last are added."""
        if not lessons:
            return self
        count = max(len(self.verdicts), max(lessons) + 1)
        verdicts = np.concatenate([self.verdicts, np.zeros(count - len(self.verdicts), dtype=np.int8)])
        blockers = np.concatenate([self.blockers, np.full(count - len(self.blockers), UNKNOWN_BLOCKER, dtype=np.int32)])
        names = {name: k for k, name in enumerate(self.names)}
        for at, (verdict, blocker) in lessons.items():
            verdicts[at] = verdict
            known = verdict is Verdict.BLOCKED and blocker is not None
            blockers[at] = names.setdefault(str(blocker), len(names)) if known else UNKNOWN_BLOCKER
        return Knowledge(verdicts, blockers, tuple(names))

    def elsewhere(self) -> Knowledge:
        """What remains where no verdict holds: unknown verdicts."""
        return self.none(len(self.verdicts))

    def nearer(self) -> Knowledge:
        """What remains with less padding: what was free still is."""
        verdicts = self.verdicts.copy()
        verdicts[(verdicts == Verdict.BLOCKED) | (verdicts == Verdict.BLOCKED_BEFORE)] = Verdict.UNKNOWN
        return replace(self, verdicts=verdicts)._tidy()

    def after(self, come: Collection[str], gone: Collection[str], pending: Collection[str]) -> Knowledge:
        """What remains after some obstacles have ``come`` and some have ``gone``; one that moved did both.

        Args:
            pending: All obstacles that came since anything FREE_BEFORE was checked and have not gone.
        """
        verdicts = self.verdicts.copy()
        if come:
            verdicts[verdicts == Verdict.FREE] = Verdict.FREE_BEFORE
        if not pending:
            verdicts[verdicts == Verdict.FREE_BEFORE] = Verdict.FREE
        if gone:
            doubtful = np.array([name in gone for name in self.names] + [True], dtype=bool)  # -1: may have been any
            verdicts[(verdicts == Verdict.BLOCKED) & doubtful[self.blockers]] = Verdict.BLOCKED_BEFORE
        return replace(self, verdicts=verdicts)._tidy()

    def _tidy(self) -> Knowledge:
        """The same without names of obstacles that block nothing any more."""
        blockers = np.where(self.verdicts == Verdict.BLOCKED, self.blockers, UNKNOWN_BLOCKER)
        used = np.unique(blockers[blockers >= 0]).tolist()
        number = np.full(len(self.names) + 1, UNKNOWN_BLOCKER, dtype=np.int32)  # the last is for -1
        number[used] = np.arange(len(used))
        return replace(self, blockers=number[blockers], names=tuple(self.names[k] for k in used))

    @cached_property
    def free(self) -> BoolArray:
        """Which are FREE or FREE_BEFORE."""
        return np.asarray((self.verdicts == Verdict.FREE) | (self.verdicts == Verdict.FREE_BEFORE))

    @cached_property
    def possible(self) -> BoolArray:
        """Which are not BLOCKED."""
        return np.asarray(self.verdicts != Verdict.BLOCKED)

    def count(self, verdict: Verdict) -> int:
        """How many have a verdict."""
        return int(np.count_nonzero(self.verdicts == verdict))


@dataclass(frozen=True)
class Terms:
    """Everything that a verdict depends on.

    Attributes:
        robot: Its name.
        robot_hash: ``Robot.hash``, which includes the gripper's width.
        joint_names: The joints of q.
        scene: Its name.
        scene_hash: ``Scene.hash``.
        obstacles: Name and hash of each obstacle, sorted by name.
        attached: Hash of what is attached to the tool.
        allowed: Pairs that may touch, in addition to those that the robot allows.
        padding: The padding in metres.
        step: How finely edges are sampled, in words; empty for a rule of the user, which cannot be compared.
    """

    robot: str
    robot_hash: str
    joint_names: tuple[str, ...]
    scene: str
    scene_hash: str
    obstacles: tuple[tuple[str, str], ...]
    attached: str
    allowed: tuple[tuple[str, str], ...]
    padding: float
    step: str

    @classmethod
    def of(cls, checker: CollisionChecker) -> Terms:
        """What a checker's verdicts depend on."""
        robot, scene = checker.robot, checker.scene
        return cls(
            robot.name,
            robot.hash,
            robot.joint_names,
            scene.name,
            scene.hash,
            tuple(sorted(scene.obstacle_hashes.items())),
            scene.attached_hash,
            checker.allowed,
            checker.padding,
            _in_words(checker.edge_step),
        )

    def same(self, other: Terms) -> bool:
        """Whether the same verdicts hold in both; False if the edge step cannot be compared."""
        return self == other and self.step != ""

    def same_but_for_obstacles(self, other: Terms) -> bool:
        """Whether they differ in obstacles at most."""
        named = {"scene": "", "scene_hash": "", "obstacles": ()}
        return replace(self, **named).same(replace(other, **named))  # type: ignore[arg-type]

    def changed(self, other: Terms) -> tuple[frozenset[str], frozenset[str]]:
        """The obstacles that are new or changed in the other, and those that are gone or changed."""
        before, after = dict(self.obstacles), dict(other.obstacles)
        come = frozenset(name for name, content in after.items() if before.get(name) != content)
        return come, frozenset(name for name, content in before.items() if after.get(name) != content)


def _in_words(step: EdgeStep) -> str:
    """One of our own rules with its fields; "" for a user's rule, whatever its ``repr``."""
    if isinstance(step, FinestStep):
        rules = [_in_words(rule) for rule in step.rules]
        return f"finest of {', '.join(rules)}" if all(rules) else ""
    return repr(step) if type(step) in (MotionStep, JointStep) else ""
