"""Answers of a server, read as strictly as files are, and its verbs: which body each takes, which answer it gives.

Plans and tasks are files, and so is what they are made of.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, Field, JsonValue

from planner_service.collision import CheckCounts, Contact
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.schema import Count, GrownRecord, Joints, Prose, Record, Rows, Text, at_most, read_record
from planner_service.geometry.arrays import read_only
from planner_service.infeasibility.remedies import Explanation, Remedy
from planner_service.path.trajectory import Trajectory
from planner_service.planning.request import World
from planner_service.records.exports.explanation import NoPathRecord, ReachedRecord
from planner_service.records.http import bodies
from planner_service.records.http.bodies import MAX_STATES, PaceBody
from planner_service.records.plan_file import MAX_SEGMENTS, PlanRecord, SavedPlan, StepRecord, TaskRecord
from planner_service.records.recertify import ProvenMotion
from planner_service.records.result import (
    MAX_PAIRS,
    CertificateRecord,
    ContactRecord,
    CountsRecord,
    FailureRecord,
    PairList,
    PathRecord,
    TrajectoryRecord,
)
from planner_service.records.robot import RobotRecord
from planner_service.records.scene import PlanReading, SceneRecord
from planner_service.replanning.result import Outcome, Replanned
from planner_service.roadmap import Roadmap
from planner_service.scene.scene import Scene

__all__ = [
    "ANSWERS",
    "OTHERS",
    "VERBS",
    "AcceptedReply",
    "CertificateReply",
    "CheckReply",
    "Checked",
    "CheckedState",
    "ExplainReply",
    "JobsReply",
    "LineSections",
    "MessageReply",
    "ProblemReply",
    "ProofReply",
    "ReplannedRecord",
    "RoadmapReply",
    "RobotReply",
    "RunsReply",
    "SampledReply",
    "SceneReply",
    "ScenesReply",
    "StoredReply",
    "Verb",
    "read_reply",
]

R = TypeVar("R", bound=Record)

MAX_REMEDIES = 1_000


def read_reply(model: type[R], document: Any, source: str, joints: int | None = None) -> R:
    """The answer that a document is; InvalidFile, naming ``source``, if it is something else."""
    return read_record(model, document, Path(source), PlanReading(joints=joints))


# Checks and proofs.


@dataclass(frozen=True)
class CheckedState:
    """Whether a configuration is free, and what touches if it is not, deepest first."""

    free: bool
    contacts: tuple[Contact, ...]


@dataclass(frozen=True)
class Checked:
    """The verdicts of configurations and of straight edges, in the order of the request.

    Attributes:
        counts: What it took, finding the contacts included.
    """

    states: tuple[CheckedState, ...]
    edges: tuple[bool, ...]
    counts: CheckCounts


class StateReply(Record, makes=CheckedState):
    """A ``CheckedState``."""

    contacts: Annotated[list[ContactRecord], at_most(MAX_PAIRS)]


class CheckReply(Record, makes=Checked):
    """A ``Checked``."""

    states: Annotated[list[StateReply], at_most(MAX_STATES)]
    edges: Annotated[list[bool], at_most(MAX_STATES)]


class CertificateReply(Record):
    """The proof of waypoints."""

    certificate: CertificateRecord


class MotionProof(GrownRecord):
    """A ``ProvenMotion``; with ``gripper`` if the gripper moves before it."""

    name: Text
    certificate: CertificateRecord
    gripper: CertificateRecord | None = None

    @classmethod
    def fields_of(cls, value: ProvenMotion) -> dict[str, Any]:
        return super().fields_of(value) | {"gripper": value.gripper and value.gripper.certificate}


class ProofReply(Record):
    """What proving a finished plan or task again has found."""

    certified: bool
    problems: list[Prose]
    motions: Annotated[list[MotionProof], at_most(MAX_SEGMENTS)]


# What plans hold beside what was asked: sections of plan files.


class LineSections(GrownRecord):
    """Those of a motion along a line: how fast it was to be, and the share of the line that it covers, if not all."""

    fraction: float | None = None
    pace: PaceBody | None = None

    @classmethod
    def of_plan(cls, plan: SavedPlan, source: str) -> LineSections:
        """Those of a plan; InvalidFile if they are something else."""
        known = {name: plan.sections[name] for name in cls.model_fields if name in plan.sections}
        return read_reply(cls, known, source)


class StopRecord(Record):
    """A stop that is not proven, with its path."""

    path: PathRecord
    trajectory: TrajectoryRecord

    @classmethod
    def fields_of(cls, value: Trajectory) -> dict[str, Any]:
        return {"path": value.path, "trajectory": value}

    @cached_property
    def value(self) -> Trajectory:
        return self.trajectory.along(self.path.value)


class ReplannedRecord(Record):
    """What a ``Replanned`` holds beside its motion; the section ``replanned`` of a plan file."""

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

    @classmethod
    def of_plan(cls, plan: SavedPlan, source: str) -> Replanned:
        """What replanning has made, of the plan that its motion is.

        Raises:
            InvalidFile: The plan is another one.
        """
        n = plan.robot.n
        record = read_reply(cls, plan.sections.get("replanned"), source, n)
        outcome, arguments = record.value, record.arguments
        if plan.request is None or (outcome is Outcome.UNSAFE) == plan.result.ok:
            raise InvalidFile(source, ["replanned: expected a request, and a motion unless nothing is safe"])
        ahead = read_only(np.array(record.ahead, dtype=np.float64).reshape(-1, n))
        return Replanned(
            **arguments | {"outcome": outcome, "ahead": ahead, "result": plan.result, "request": plan.request}
        )


# Explanations.


class RemedyReply(Record):
    """A ``Remedy``: the plan has its request and its scene."""

    text: Prose
    plan: PlanRecord

    @cached_property
    def value(self) -> Remedy:
        plan: SavedPlan = self.plan.value
        if plan.request is None or not plan.result.ok:
            raise InvalidRequest("plan", plan, "a plan with its request")
        return Remedy(self.text, plan.request, plan.scene, plan.result)


class ExplainReply(Record):
    """An ``Explanation``: why the plan ``result`` has failed, and what helps."""

    result: PlanRecord
    no_path: NoPathRecord | None
    reached: ReachedRecord | None
    way: PlanRecord | None
    remedies: Annotated[list[RemedyReply], at_most(MAX_REMEDIES)]
    plans: Count
    complete: bool = True

    @classmethod
    def fields_of(cls, value: tuple[Explanation, World]) -> dict[str, Any]:
        why, world = value
        remedies = [
            {"text": each.text, "plan": SavedPlan(replace(world, scene=each.scene), each.request, each.result)}
            for each in why.remedies
        ]
        plans = {"result": SavedPlan.of(why.result), "way": why.way and SavedPlan.of(why.way)}
        return super().fields_of(why) | plans | {"remedies": remedies}

    @cached_property
    def value(self) -> Explanation:
        arguments = self.arguments
        way: SavedPlan | None = arguments["way"]
        return Explanation(**arguments | {"result": arguments["result"].result, "way": way and way.result})


# What a server has.


class WidthRange(Record):
    """Metres between the finger pads."""

    lower: float
    upper: float


class RobotReply(Record):
    """The robot, whole in ``robot`` as plan files have it, and how its motions are checked."""

    name: Text
    hash: Text
    joint_names: list[Text]
    named_poses: dict[Text, Joints]
    gripper: WidthRange | None
    robot: RobotRecord
    allowed: PairList
    edge_step: StepRecord | None

    @classmethod
    def fields_of(cls, value: World) -> dict[str, Any]:
        robot = value.robot
        poses = {name: q.tolist() for name, q in robot.named_poses}
        how = {"allowed": [list(pair) for pair in value.allowed], "edge_step": StepRecord.find(value.edge_step)}
        return super().fields_of(robot) | {"named_poses": poses, "robot": robot, **how}

    @cached_property
    def value(self) -> World:
        """The robot in an empty scene."""
        arguments = self.arguments
        return World(arguments["robot"], Scene(), arguments["allowed"], arguments["edge_step"])


Version = Annotated[int, Field(ge=1, description="a whole number from 1")]


class SceneReply(SceneRecord):
    """One version of a scene, with all that is in it."""

    version: Version

    @property
    def arguments(self) -> dict[str, Any]:
        """Those of the scene."""
        return {name: value for name, value in super().arguments.items() if name != "version"}


class StoredReply(Record):
    """A scene as it is stored now."""

    name: Text
    version: Version
    hash: Text


class ScenesReply(Record):
    """All scenes."""

    scenes: list[StoredReply]


class BuiltReply(Record):
    """How a roadmap was grown."""

    planner: Text
    settings: dict[str, JsonValue]
    seed: Count
    counts: CountsRecord


class RoadmapReply(Record):
    """A roadmap that the server keeps under its hash."""

    id: Text
    milestones: Count
    edges: Count
    built: BuiltReply | None

    @classmethod
    def fields_of(cls, value: Roadmap) -> dict[str, Any]:
        numbers = {"milestones": len(value.milestones), "edges": len(value.edges)}
        return {"id": value.hash, **numbers, "built": value.built}


# What a server says of requests and of itself.


class AcceptedReply(Record):
    """A request that has no answer yet; ``position`` counts those before it in the queue."""

    id: str
    kind: str
    state: Literal["queued", "running"]
    position: int | None
    links: dict[str, str]


class JobReply(Record):
    """A request in a list."""

    id: str
    kind: str
    state: Literal["queued", "running", "done", "cancelled", "lost"]
    created: float
    ok: bool | None
    reason: str | None


class JobsReply(Record):
    """Requests, newest first; ``next`` is what to ask for as ``after`` to get more."""

    plans: list[JobReply]
    next: str | None


class MotionSamples(Record):
    """A motion in time: seconds from its own beginning, and rows of one number for each joint."""

    name: Text
    begin: Annotated[float, Field(description="Seconds of motion before it")]
    duration: Annotated[float, Field(description="Seconds")]
    t: Annotated[list[float], Field(description="Seconds, the first 0, the last the duration")]
    positions: Annotated[list[list[float]], Field(description="rad, or m of a joint that slides")]
    velocities: Annotated[list[list[float]], Field(description="rad/s, or m/s")]
    accelerations: Annotated[list[list[float]], Field(description="rad/s^2, or m/s^2")]


class GripperEvent(GrownRecord):
    """What the gripper does while the arm stands before a motion."""

    at: Annotated[float, Field(description="Seconds of motion before it")]
    before: Annotated[str, Field(description="The name of the motion that follows")]
    width: Annotated[float | None, Field(description="Metres between the fingers")] = None
    suction: Annotated[bool | None, Field(description="Whether it sucks from now on")] = None


class DeviationReply(Record):
    """Bounds of how far a joint can be from the proven curve, in rad (or m), by what is drawn between points."""

    linear: float
    cubic: float
    quintic: float


class SampledReply(Record):
    """Motions ready to run, format json."""

    robot: Text
    joint_names: list[str]
    units: Annotated[list[Literal["rad", "m"]], Field(description="Of each joint")]
    dt: Annotated[float, Field(description="Seconds between points")]
    deviation: DeviationReply
    motions: list[MotionSamples]
    events: list[GripperEvent]


class MessageReply(BaseModel):
    """Motions in the shape of a message of ROS, or as actions of LeRobot; which members there are depends on it."""

    motions: list[dict[str, JsonValue]] | None = None
    header: dict[str, JsonValue] | None = None
    joint_names: list[str] | None = None
    points: list[dict[str, JsonValue]] | None = None
    trajectory: JsonValue = None
    joint_trajectory: dict[str, JsonValue] | None = None
    actions: list[dict[str, float]] | None = None
    fps: float | None = None


class RunsReply(Record):
    """That the server runs, or is ready."""

    ok: Literal[True]


class ProblemReply(BaseModel):
    """What is wrong with a request (RFC 9457); some kinds have more members."""

    type: str
    title: str
    status: int
    detail: str
    field: str | None = None
    value: Any = None
    expected: str | None = None
    problems: list[str] | None = None
    reason: str | None = None


OTHERS: tuple[type[BaseModel], ...] = (
    *(AcceptedReply, JobsReply, RunsReply, ProblemReply, SampledReply, MessageReply),
    *(RobotReply, SceneReply, ScenesReply, StoredReply),
    *(LineSections, ReplannedRecord),
)
"""Those that no verb has; the last two are sections of plans."""


@dataclass(frozen=True)
class Verb:
    """A kind of request for work.

    Attributes:
        body: The model of what is sent.
        answers: The models of what comes back, one of them.
    """

    summary: str
    body: type[bodies.Body]
    answers: tuple[type[Record], ...]

    @property
    def is_task(self) -> bool:
        """Whether the answer is a task file."""
        return TaskRecord in self.answers

    @property
    def is_file(self) -> bool:
        """Whether the answer is a plan file or a task file, also if the request is not carried out."""
        return self.is_task or PlanRecord in self.answers


VERBS: Mapping[str, Verb] = {
    "plans": Verb("Plan a motion", bodies.PlanBody, (PlanRecord,)),
    "certify": Verb(
        "Prove that a path, or a finished plan or task, is free",
        bodies.CertifyBody,
        (CertificateReply, ProofReply),
    ),
    "check": Verb("Check configurations and straight edges", bodies.CheckBody, (CheckReply,)),
    "pick": Verb("Plan to take an object", bodies.PickBody, (TaskRecord,)),
    "place": Verb("Plan to set a carried object down", bodies.PlaceBody, (TaskRecord,)),
    "pick_place": Verb("Plan a whole pick-and-place", bodies.PickPlaceBody, (TaskRecord,)),
    "move_linear": Verb("Plan straight motions of the tool", bodies.MoveLinearBody, (PlanRecord,)),
    "replan": Verb("Plan a new motion for a robot that is moving", bodies.ReplanBody, (PlanRecord,)),
    "explain": Verb("Explain why there is no plan, and what would help", bodies.ExplainBody, (ExplainReply,)),
    "roadmaps": Verb("Grow a roadmap", bodies.RoadmapBody, (RoadmapReply,)),
}
"""By route and kind."""

ANSWERS = tuple(dict.fromkeys(model for verb in VERBS.values() for model in verb.answers))
"""All of their models."""
