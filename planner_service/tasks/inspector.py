"""What was in the way of each step of a task, and of each visit to a stage of it."""

from __future__ import annotations

import enum
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.planning.result import Failure, PlanResult
from planner_service.planning.task_result import StepReport
from planner_service.service import PlannerService
from planner_service.tasks.motions import NoMotion
from planner_service.tasks.task import ChoiceStage, ContactStage, MotionStage, Numbered, Stage

__all__ = ["Inspector", "Rank", "Visit", "steps_of"]

MAX_REASONS = 20
"""Of a step, that are reported."""

MAX_KINDS = 1_000
"""Of a step, that are counted apart."""


class Rank(enum.IntEnum):
    """How far a way has come before it was refused."""

    POSE = 0
    """Out of reach, or something would touch at the contact."""
    LINE = 1
    """The arm cannot go the lines."""
    GRIPPER = 2
    """The gripper cannot move there."""
    PROOF = 3
    """The lines are not free."""
    AHEAD = 4
    """What is taken could not be set down again."""
    SEARCH = 5
    """There is no way there."""


@dataclass(eq=False)
class _Tally:
    """What is known of one step."""

    label: str
    tried: int = 0
    failed: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    refused: PlanResult | None = None

    def report(self) -> StepReport:
        return StepReport(
            self.label, self.tried, self.failed, tuple(self.reasons.most_common(MAX_REASONS)), self.refused
        )


class Inspector:
    """Counts for each step of a task how often it was tried, and why it failed."""

    def __init__(self, stages: Sequence[Stage]) -> None:
        self._tallies: dict[str, _Tally] = {}
        self._steps = {numbered.number: numbered for stage in stages for numbered in steps_of(stage)}
        for number, numbered in self._steps.items():
            self._tallies[number] = _Tally(numbered.label)

    def reports(self) -> tuple[StepReport, ...]:
        """Of all steps, in their order."""
        return tuple(tally.report() for tally in self._tallies.values())

    def blocked(self) -> tuple[Numbered, StepReport] | None:
        """The last of the steps that failed whenever they were tried; None if each had a way once."""
        for number, tally in reversed(self._tallies.items()):
            if 0 < tally.failed == tally.tried:
                return self._steps[number], tally.report()
        return None

    def tried(self, numbered: Numbered) -> None:
        """A step is tried."""
        self._tallies[numbered.number].tried += 1

    def failed(self, numbered: Numbered, why: str, result: PlanResult | None) -> None:
        """What was tried last of a step has failed."""
        tally = self._tallies[numbered.number]
        tally.failed += 1
        tally.refused = result or tally.refused
        if why in tally.reasons or len(tally.reasons) < MAX_KINDS:
            tally.reasons[why] += 1


def steps_of(stage: Stage) -> Iterator[Numbered]:
    """The steps of a stage in their order, of all alternatives."""
    if isinstance(stage, ChoiceStage):
        for branch in stage.branches:
            for inner in branch:
                yield from steps_of(inner)
        return
    middle = (*stage.approaches, stage.act, *stage.retreats) if isinstance(stage, ContactStage) else (stage.motion,)
    yield from (each for each in (stage.connect, *middle) if each is not None)


@dataclass(eq=False)
class Visit:
    """What was tried of one stage from one state.

    Attributes:
        stage: Which.
        service: What plans there.
        q: Where the robot stands, (n,).
        noted: What did not work, in words, in order, each with the number of its step and its kind of grasp.
        unreached: Tool poses out of reach, by the number of their way.
        kinds: The kinds of grasps that were looked for, or the placements, and how many of each there are.
        farthest: The step at which the way ended that had come farthest, and how far.
        failure: Why nothing could begin there, or the one motion has no plan.
        ahead: The visit of a later stage without which this one is in vain; of several, the first that came farthest.
    """

    inspector: Inspector
    stage: ContactStage | MotionStage
    service: PlannerService
    q: FloatArray
    noted: list[tuple[str, str, str]] = field(default_factory=list)
    unreached: dict[int, Pose] = field(default_factory=dict)
    kinds: list[tuple[str, int]] = field(default_factory=list)
    farthest: tuple[Rank, Numbered] | None = None
    failure: Failure | None = None
    ahead: Visit | None = None

    @property
    def tried(self) -> list[str]:
        """What did not work, in words, in order."""
        return [told for _, told, _ in self.noted]

    @property
    def kind(self) -> str:
        """The kind of grasp that is tried; empty for the usual one, and for what is no grasp."""
        return self.kinds[-1][0] if self.kinds else ""

    @property
    def ways(self) -> int:
        """How many grasps or placements there are, of the kinds that were looked for."""
        return sum(count for _, count in self.kinds)

    def begins(self, kind: str, count: int) -> None:
        """Grasps of a kind are tried from here on, or placements."""
        self.kinds.append((kind, count))

    def leads_to(self, ahead: Visit) -> None:
        """A way of this stage is in vain, as a later stage then has none."""
        if self.ahead is None or ahead.rank > self.ahead.rank:
            self.ahead = ahead

    @property
    def rank(self) -> int:
        """How far it has come; -1 if nothing was tried."""
        return -1 if self.farthest is None else self.farthest[0]

    def refuse(
        self, numbered: Numbered, why: str, told: str | None = None, rank: Rank = Rank.POSE, *, known: bool = False
    ) -> None:
        """Something of a step is not possible.

        Args:
            told: The same for the list of what was tried.
            known: Whether an earlier visit has found that out.
        """
        if not known:
            self.inspector.tried(numbered)
            self.inspector.failed(numbered, self._of_kind(why), None)
        self._note(numbered, told or why, rank)

    @contextmanager
    def trying(self, numbered: Numbered, prefix: str, rank: Rank) -> Iterator[None]:
        """A step is tried in the block, and has failed if that raises ``NoMotion``.

        Args:
            prefix: What the reason begins with in the list of what was tried.
        """
        self.inspector.tried(numbered)
        try:
            yield
        except NoMotion as none:
            self.inspector.failed(numbered, self._of_kind(str(none)), none.result)
            self._note(numbered, f"{prefix}{none}", rank)
            raise

    def _of_kind(self, why: str) -> str:
        """A reason with the kind of grasp, where that is not the usual one and there are some."""
        return f"{self.kind}: {why}" if self.kind and self.kinds[-1][1] else why

    def _note(self, numbered: Numbered, told: str, rank: Rank) -> None:
        self.noted.append((numbered.number, told, self.kind))
        if self.farthest is None or rank > self.farthest[0]:
            self.farthest = rank, numbered
