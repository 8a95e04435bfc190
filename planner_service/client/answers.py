"""What is received, read as strictly as files are: verdicts, certificates, and what plans and tasks do not hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np

from planner_service.certify import Certificate
from planner_service.client.problems import ServerUnavailable
from planner_service.collision import CheckCounts, Contact, EdgeStep
from planner_service.collision.budget import Cancelled
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.schema import Count, Prose, Record, Rows, Text, at_most, read_record
from planner_service.geometry.arrays import read_only
from planner_service.infeasibility.remedies import Explanation, Remedy
from planner_service.path.trajectory import Trajectory
from planner_service.planning.result import PlanResult, Reason
from planner_service.records.exports.explanation import NoPathRecord, ReachedRecord
from planner_service.records.failure import MAX_PAIRS, ContactRecord, FailureRecord
from planner_service.records.plan_file import PlanRecord, SavedPlan, StepRecord
from planner_service.records.result import CertificateRecord, CountsRecord, PairList, PathRecord, TrajectoryRecord
from planner_service.records.robot import RobotRecord
from planner_service.records.scene import PlanReading
from planner_service.replanning.result import Outcome, Replanned
from planner_service.robot.model import Robot

__all__ = [
    "Checked",
    "CheckedState",
    "ServedRobot",
    "read_certificate",
    "read_checked",
    "read_explanation",
    "read_fraction",
    "read_replanned",
    "read_robot",
]

R = TypeVar("R", bound=Record)

MAX_STATES, MAX_REMEDIES = 100_000, 1_000


@dataclass(frozen=True)
class CheckedState:
    """Whether a configuration is free, and what touches if it is not, deepest first."""

    free: bool
    contacts: tuple[Contact, ...]


@dataclass(frozen=True)
class Checked:
    """The verdicts of configurations and of straight edges, in the order they were asked for.

    Attributes:
        counts: What it took, finding the contacts included.
    """

    states: tuple[CheckedState, ...]
    edges: tuple[bool, ...]
    counts: CheckCounts


class StateRecord(Record):
    """A ``CheckedState``."""

    makes = CheckedState

    free: bool
    contacts: Annotated[list[ContactRecord], at_most(MAX_PAIRS)]


class CheckedRecord(Record):
    """A ``Checked``."""

    makes = Checked

    states: Annotated[list[StateRecord], at_most(MAX_STATES)]
    edges: Annotated[list[bool], at_most(MAX_STATES)]
    counts: CountsRecord


def read_checked(document: Mapping[str, Any], source: str, states: int, edges: int) -> Checked:
    """The verdicts of so many configurations and edges.

    Raises:
        InvalidFile: The document is something else.
    """
    checked: Checked = _read(CheckedRecord, document, source).value
    if (len(checked.states), len(checked.edges)) != (states, edges):
        raise InvalidFile(source, [f"expected {states} states and {edges} edges"])
    return checked


class CertifiedRecord(Record):
    """A certificate alone."""

    certificate: CertificateRecord


def read_certificate(document: Mapping[str, Any], source: str) -> Certificate:
    """A certificate.

    Raises:
        InvalidFile: The document is something else.
    """
    certificate: Certificate = _read(CertifiedRecord, document, source).certificate.value
    return certificate


class FractionRecord(Record):
    """The fraction of a ``PlanResult``."""

    fraction: float | None = None


def read_fraction(plan: SavedPlan, source: str) -> float | None:
    """The share of the tool's path that a motion along it covers; None if the plan does not say.

    Raises:
        InvalidFile: It is no number.
    """
    known = {name: plan.sections[name] for name in ("fraction",) if name in plan.sections}
    return _read(FractionRecord, known, source).fraction


@dataclass(frozen=True)
class ServedRobot:
    """The robot of a server, and how its motions are checked.

    Attributes:
        allowed: Pairs that may touch.
        edge_step: How finely edges are sampled.
    """

    robot: Robot
    allowed: tuple[tuple[str, str], ...]
    edge_step: EdgeStep | None


class ServedRobotRecord(Record):
    """A ``ServedRobot``."""

    makes = ServedRobot

    robot: RobotRecord
    allowed: PairList
    edge_step: StepRecord | None


def read_robot(document: Mapping[str, Any], source: str) -> ServedRobot:
    """The robot of a server.

    Raises:
        InvalidFile: The document is something else.
    """
    own = {name: document[name] for name in ("robot", "allowed", "edge_step") if name in document}
    served: ServedRobot = _read(ServedRobotRecord, own, source).value
    return served


# Replanning.


class StopRecord(Record):
    """A stop that is not proven, with its path."""

    path: PathRecord
    trajectory: TrajectoryRecord

    @cached_property
    def value(self) -> Trajectory:
        return self.trajectory.along(self.path.value)


class ReplannedRecord(Record):
    """What a ``Replanned`` holds beside its motion."""

    outcome: Text
    splice: float
    ahead: Rows
    failure: FailureRecord | None
    stop: StopRecord | None

    @cached_property
    def value(self) -> Outcome:
        names = [outcome.value for outcome in Outcome]
        if self.outcome not in names:
            raise InvalidRequest("outcome", self.outcome, f"one of {', '.join(names)}")
        return Outcome(self.outcome)


def read_replanned(plan: SavedPlan, source: str) -> Replanned:
    """What replanning has made, of the plan that its motion is.

    Raises:
        Cancelled: It was cancelled before a worker began.
        ServerUnavailable: No worker came to it before its deadline, or workers were lost.
        InvalidFile: The plan is another one.
    """
    section, n, failure = plan.sections.get("replanned"), plan.robot.n, plan.result.failure
    if section is None and failure is not None:
        if failure.reason is Reason.PREEMPTED:
            raise Cancelled(failure.detail)
        raise ServerUnavailable(source, failure.detail)
    record = _read(ReplannedRecord, section, source, n)
    outcome: Outcome = record.value
    if plan.request is None or (outcome is Outcome.UNSAFE) == plan.result.ok:
        raise InvalidFile(source, ["replanned: expected a request, and a motion unless nothing is safe"])
    return Replanned(
        outcome,
        plan.result,
        record.splice,
        plan.request,
        None if record.failure is None else record.failure.value,
        read_only(np.array(record.ahead, dtype=np.float64).reshape(-1, n)),
        None if record.stop is None else record.stop.value,
    )


# Explanations.


class RemedyRecord(Record):
    """A ``Remedy``: the plan has its request and its scene."""

    text: Prose
    plan: PlanRecord

    @cached_property
    def value(self) -> Remedy:
        plan: SavedPlan = self.plan.value
        if plan.request is None or not plan.result.ok:
            raise InvalidRequest("plan", plan, "a plan with its request")
        return Remedy(self.text, plan.request, plan.scene, plan.result)


class HelpRecord(Record):
    """What an ``Explanation`` holds beside its result."""

    no_path: NoPathRecord | None
    reached: ReachedRecord | None
    way: PlanRecord | None
    remedies: Annotated[list[RemedyRecord], at_most(MAX_REMEDIES)]
    plans: Count
    complete: bool = True


def read_explanation(document: Mapping[str, Any], source: str, result: PlanResult) -> Explanation:
    """Why the plan that ``result`` is has failed, and what helps.

    Raises:
        InvalidFile: The document is something else.
    """
    said = {name: document[name] for name in HelpRecord.model_fields if name in document}
    helped = _read(HelpRecord, said, source).arguments
    way: SavedPlan | None = helped.pop("way")
    return Explanation(result, way=None if way is None else way.result, **helped)


def _read(model: type[R], document: Any, source: str, joints: int | None = None) -> R:
    return read_record(model, document, Path(source), PlanReading(joints=joints))
