"""A task as a value: its steps in an order that makes sense, which is checked when it is made."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import set_fields
from planner_service.geometry.validation import text, unusable_text
from planner_service.planning.result import load_steps, save_steps
from planner_service.tasks.steps import (
    MAX_STEPS,
    Alternatives,
    Approach,
    Connect,
    Follow,
    Grasp,
    Release,
    Repeat,
    Retreat,
    Step,
    flat_steps,
)

__all__ = ["ChoiceStage", "ContactStage", "MotionStage", "Numbered", "Stage", "Task"]

MAX_TITLE = 1_000


@dataclass(frozen=True)
class Task:
    """Steps in their order, as one value that is checked when it is made, kept in a file, and solved.

    Attributes:
        steps: Steps; sequences of steps among them are made one with the others.
        name: What is to be done, in words.

    Raises:
        InvalidRequest: A step stands where it has no meaning, or there are none, or too many; the message names it.
    """

    steps: Sequence[Any]
    name: str = ""

    def __post_init__(self) -> None:
        set_fields(self, steps=flat_steps("steps", self.steps))
        if not self.steps:
            raise InvalidRequest("steps", self.steps, "at least one step")
        if len(text("name", self.name)) > MAX_TITLE or not self.name.isprintable():
            raise unusable_text("name", self.name, f"at most {MAX_TITLE:,} printable characters")
        self.stages  # noqa: B018 - refuses what has no order

    @cached_property
    def stages(self) -> tuple[Stage, ...]:
        """What is solved one after the other: each contact with the motions to and from it, and each other motion."""
        return _stages(self.steps, "", Room(MAX_STEPS))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it to a JSON file.

        Raises:
            InvalidRequest: A step has no place in a file, such as a source of grasps of your own.
            InvalidFile: The file cannot be written.
        """
        save_steps(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Task:
        """The task in a file.

        Raises:
            InvalidFile: The file cannot be used; it lists all problems found, not the first.
        """
        task: Task = load_steps(path)
        return task


# The order of steps.


@dataclass(frozen=True)
class Numbered:
    """A step with where it stands in its task, such as ``3`` or ``4.2.1``, by which reports name it."""

    number: str
    step: Any

    @property
    def label(self) -> str:
        """Number and step, in words."""
        return f"{self.number} {self.step}"


@dataclass(frozen=True)
class ContactStage:
    """The gripper closes or opens, with the motions to there and away.

    Attributes:
        connect: To where the first approach begins; None if there is no approach.
        approaches: One after the other.
        act: ``Grasp`` or ``Release``.
        retreats: One after the other.
    """

    connect: Numbered | None
    approaches: tuple[Numbered, ...]
    act: Numbered
    retreats: tuple[Numbered, ...]


@dataclass(frozen=True)
class MotionStage:
    """A motion, and how to get to where it begins."""

    connect: Numbered | None
    motion: Numbered


@dataclass(frozen=True)
class ChoiceStage:
    """Ways to go on."""

    branches: tuple[tuple[Stage, ...], ...]


Stage = ContactStage | MotionStage | ChoiceStage


class Room:
    """How many steps a task may still have, repetitions and alternatives included."""

    def __init__(self, steps: int) -> None:
        self.left = steps

    def take(self) -> None:
        """One more step.

        Raises:
            InvalidRequest: There is no room for it.
        """
        self.left -= 1
        if self.left < 0:
            raise InvalidRequest("steps", "more", f"at most {MAX_STEPS:,} steps, repetitions and alternatives included")


def _stages(steps: Sequence[Step], where: str, room: Room) -> tuple[Stage, ...]:
    """The stages of a sequence of steps.

    Args:
        where: What the numbers of its steps begin with.

    Raises:
        InvalidRequest: A step stands where it has no meaning.
    """
    numbered = [Numbered(f"{where}{k}", step) for k, step in enumerate(steps, start=1)]
    stages: list[Stage] = []
    k = 0
    while k < len(numbered):
        each, step = numbered[k], numbered[k].step
        room.take()
        if isinstance(step, Alternatives):
            inner = [_stages(branch, f"{each.number}.{n}.", room) for n, branch in enumerate(step.branches, start=1)]
            stages.append(ChoiceStage(tuple(inner)))
            k += 1
        elif isinstance(step, Repeat):
            for _ in range(step.times):
                stages += _stages(step.steps, f"{each.number}.", room)
            k += 1
        else:
            stage, taken = _stage(numbered[k:])
            stages.append(stage)
            k += taken
    return tuple(stages)


def _stage(steps: Sequence[Numbered]) -> tuple[ContactStage | MotionStage, int]:
    """The first stage of steps, and how many of them it takes."""
    k = 0
    connect = steps[0] if isinstance(steps[0].step, Connect) else None
    k += connect is not None
    approaches = _run(steps[k:], Approach)
    k += len(approaches)
    act = steps[k] if k < len(steps) else None
    if approaches and connect is None:
        raise _misplaced(steps[0], "a Connect before it")
    if connect is not None and not approaches and not (act and isinstance(act.step, Follow)):
        raise _misplaced(connect, "an Approach or a Follow after it; MoveTo goes to a place of its own")
    if approaches and not (act and isinstance(act.step, Grasp | Release)):
        raise _misplaced(approaches[-1], "a Grasp or a Release after it")
    assert act is not None
    if isinstance(act.step, Retreat):
        raise _misplaced(act, "a Grasp or a Release before it")
    if not isinstance(act.step, Grasp | Release):
        return MotionStage(connect, act), k + 1
    _require_places(act, approaches)
    retreats = _run(steps[k + 1 :], Retreat)
    return ContactStage(connect, approaches, act, retreats), k + 1 + len(retreats)


def _run(steps: Sequence[Numbered], kind: type[Step]) -> tuple[Numbered, ...]:
    """The steps of one kind that come first."""
    count = next((k for k, each in enumerate(steps) if not isinstance(each.step, kind)), len(steps))
    return tuple(steps[:count])


def _require_places(act: Numbered, approaches: Sequence[Numbered]) -> None:
    """Refuse a release whose place is not said, and places that nothing goes to."""
    step, field = act.step, "grasps" if isinstance(act.step, Grasp) else "poses"
    given = getattr(step, field)
    if approaches and given is None and isinstance(step, Release):
        raise InvalidRequest(f"steps: {act.label}: poses", None, "at least one Pose, as there is an approach")
    if not approaches and given is not None:
        raise _misplaced(act, "an Approach before it, as it says where")


def _misplaced(step: Numbered, expected: str) -> InvalidRequest:
    return InvalidRequest("steps", step.label, expected, message=f"steps: {step.label}: expected {expected}")
