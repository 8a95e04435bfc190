"""Answers of a server, read as strictly as files are, and its verbs: which body each takes, which answer it gives.

Plans and tasks are files, and so is what they are made of.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal, TypeVar

from pydantic import ConfigDict, Field, JsonValue, WithJsonSchema

from planner_service.collision import CheckCounts, Contact
from planner_service.errors import InvalidRequest
from planner_service.files.schema import Count, Described, GrownRecord, Joints, Prose, Record, Text, at_most
from planner_service.infeasibility.remedies import Explanation, Remedy
from planner_service.planning.request import World
from planner_service.records.cells.cell_file import CellPlanRecord
from planner_service.records.exports.explanation import NoPathRecord, ReachedRecord
from planner_service.records.http import bodies
from planner_service.records.http.bodies import MAX_STATES
from planner_service.records.http.cell_bodies import PlanCellBody
from planner_service.records.http.sections import PlanSections
from planner_service.records.http.trajectories import TRAJECTORIES
from planner_service.records.plan_file import MAX_SEGMENTS, PlanRecord, SavedPlan, StepRecord, TaskRecord
from planner_service.records.recertify import ProvenMotion
from planner_service.records.result import (
    MAX_PAIRS,
    CertificateRecord,
    ContactRecord,
    CountsRecord,
    PairList,
)
from planner_service.records.robot import RobotRecord
from planner_service.records.scene import SceneRecord
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
    "ProblemReply",
    "ProofReply",
    "RoadmapReply",
    "RobotReply",
    "RunsReply",
    "SceneReply",
    "ScenesReply",
    "StoredReply",
    "Verb",
]

R = TypeVar("R", bound=Record)

MAX_REMEDIES = 1_000


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
    """A ``CheckedState``.

    Attributes:
        free: Whether nothing touches.
        contacts: What touches, deepest first; empty if it is free.
    """

    contacts: Annotated[list[ContactRecord], at_most(MAX_PAIRS)]


class CheckReply(Record, makes=Checked):
    """A ``Checked``.

    Attributes:
        states: For each configuration whether it is free, and what touches.
        edges: For each straight motion whether it is free.
    """

    states: Annotated[list[StateReply], at_most(MAX_STATES)]
    edges: Annotated[list[bool], at_most(MAX_STATES)]


class CertificateReply(Record):
    """The proof of waypoints.

    Attributes:
        certificate: What is proven of the curve through the waypoints, or what is not.
    """

    certificate: CertificateRecord


class MotionProof(GrownRecord):
    """A ``ProvenMotion``; with ``gripper`` if the gripper moves before it.

    Attributes:
        name: The name of the motion.
    """

    about = ProvenMotion

    name: Text
    certificate: CertificateRecord
    gripper: CertificateRecord | None = None

    @classmethod
    def fields_of(cls, value: ProvenMotion) -> dict[str, Any]:
        return super().fields_of(value) | {"gripper": value.gripper and value.gripper.certificate}


class ProofReply(Record):
    """What proving a finished plan or task again has found.

    Attributes:
        certified: Whether all motions are proven, and fit to each other.
        problems: What is not, in words; empty if certified.
        motions: The proofs of the motions, as far as they were proven.
    """

    certified: bool
    problems: list[Prose]
    motions: Annotated[list[MotionProof], at_most(MAX_SEGMENTS)]


# Explanations.


class RemedyReply(Record):
    """A ``Remedy``: the plan has its request and its scene.

    Attributes:
        plan: The plan that it gives, with its request and its scene.
    """

    about = Remedy

    text: Prose
    plan: PlanRecord

    @cached_property
    def value(self) -> Remedy:
        plan: SavedPlan = self.plan.value
        if plan.request is None or not plan.result.ok:
            raise InvalidRequest("plan", plan, "a plan with its request")
        return Remedy(self.text, plan.request, plan.scene, plan.result)


class ExplainReply(Record):
    """An ``Explanation``: why the plan ``result`` has failed, and what helps.

    Attributes:
        result: The plan file of the request as it is.
    """

    about = Explanation

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
    """Metres between the finger pads.

    Attributes:
        lower: The smallest.
        upper: The largest.
    """

    lower: float
    upper: float


class RobotReply(Record):
    """The robot, whole in ``robot`` as plan files have it, and how its motions are checked.

    Attributes:
        name: The name of the robot.
        hash: SHA-256 of all that decides about motions; plans of this robot have the same.
        joint_names: The joints that move, in the order of all joint values.
        named_poses: Joint values by the name of the pose, in radians (metres for joints that slide).
        gripper: How wide the gripper opens; null without one.
        robot: The whole robot, as plan files have it.
        allowed: Pairs of names that may touch.
        edge_step: How far apart edges are sampled by the search; null if that is not known. Proofs do not sample.
    """

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
    """A scene as it is stored now.

    Attributes:
        name: The name of the scene.
        version: Counts from 1.
        hash: SHA-256 of all that is in it.
    """

    name: Text
    version: Version
    hash: Text


class ScenesReply(Record):
    """All scenes.

    Attributes:
        scenes: The latest version of each.
    """

    scenes: list[StoredReply]


Settings = Annotated[
    dict[str, JsonValue], WithJsonSchema({"type": "object", "additionalProperties": {"type": "number"}})
]


class BuiltReply(Record):
    """How a roadmap was grown.

    Attributes:
        planner: The name of the planner that grew it.
        settings: The planner's settings.
        seed: The seed of its random choices.
        counts: What growing it took.
    """

    planner: Text
    settings: Settings
    seed: Count
    counts: CountsRecord


class RoadmapReply(Record):
    """A roadmap that the server keeps under its hash.

    Attributes:
        id: Its hash, which names it: `{"name": "roadmap", "settings": {"hash": ID}}` is a planner that searches it.
        milestones: Configurations in it.
        edges: Straight motions between them.
        built: How it was grown; null if that is not known.
    """

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
    """A request that has no answer yet; ``position`` counts those before it in the queue.

    Attributes:
        id: Names the request; its answer will be at `/plans/ID`.
        kind: What was asked for: the address without its slash, such as plans or pick_place.
        state: Whether it waits for a worker or runs.
        position: Requests before it in the queue; null once it runs.
        links: Addresses by purpose: `self` of the answer, `events` of its stages as they end.
    """

    id: str
    kind: str
    state: Literal["queued", "running"]
    position: int | None
    links: dict[str, str]


class JobReply(Record):
    """A request in a list.

    Attributes:
        id: Names the request.
        kind: What was asked for, such as plans or pick_place.
        state: Where it is; lost if two workers died of it.
        created: When it was accepted, in seconds since 1970-01-01 UTC.
        ok: Whether the answer is a plan, a proof or another success; null as long as there is no answer.
        reason: Why it is not; null if it is or there is no answer.
    """

    id: str
    kind: str
    state: Literal["queued", "running", "done", "cancelled", "lost"]
    created: float
    ok: bool | None
    reason: str | None


class JobsReply(Record):
    """Requests, newest first; ``next`` is what to ask for as ``after`` to get more.

    Attributes:
        plans: Those of this page.
        next: What to ask for as `after` to get the next page; null on the last.
    """

    plans: list[JobReply]
    next: str | None


class RunsReply(Record):
    """That the server runs, or is ready.

    Attributes:
        ok: Always true: a problem says if it does not, or is not.
    """

    ok: Literal[True]


class ProblemReply(Described):
    """What is wrong with a request (RFC 9457); some kinds have more members.

    Attributes:
        type: Tells kinds of problems apart: `urn:problem-type:planner-service:` and the kind.
        title: What kind of problem it is, in words.
        status: The HTTP status.
        detail: What is wrong, in a sentence that names the field, the value and what would be right.
        field: The field that is wrong, such as request.start.
        value: What was found there; a text if it is long.
        expected: What would be right.
        problems: All problems of a body, each with its place.
        reason: Why a request has ended without an answer, such as WORKER_LOST.
        kind: Of an unknown name, what it should be the name of.
        name: The name that is unknown.
        available: Names that are known.
        package: The package that is not installed on the server.
        extra: The extra of planner-service that brings it.
    """

    model_config = ConfigDict(extra="allow")

    type: str
    title: str
    status: int
    detail: str
    field: str | None = None
    value: JsonValue = None
    expected: str | None = None
    problems: list[str] | None = None
    reason: str | None = None
    kind: str | None = None
    name: JsonValue = None
    available: list[str] | None = None
    package: str | None = None
    extra: str | None = None


OTHERS: tuple[type[Described], ...] = (
    *(AcceptedReply, JobsReply, RunsReply, ProblemReply),
    *(RobotReply, SceneReply, ScenesReply, StoredReply, PlanSections),
    *TRAJECTORIES,
)
"""Those that no verb has; the sections are those of plans and tasks."""


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
    "solve": Verb("Solve a task that is composed of steps", bodies.SolveBody, (TaskRecord,)),
    "order": Verb("Put visits in the order that takes least time", bodies.OrderBody, (TaskRecord,)),
    "move_linear": Verb("Plan straight motions of the tool", bodies.MoveLinearBody, (PlanRecord,)),
    "replan": Verb("Plan a new motion for a robot that is moving", bodies.ReplanBody, (PlanRecord,)),
    "explain": Verb("Explain why there is no plan, and what would help", bodies.ExplainBody, (ExplainReply,)),
    "plan_cell": Verb("Plan for several arms, each on its own clock", PlanCellBody, (CellPlanRecord,)),
    "roadmaps": Verb("Grow a roadmap", bodies.RoadmapBody, (RoadmapReply,)),
}
"""By route and kind."""

ANSWERS = tuple(dict.fromkeys(model for verb in VERBS.values() for model in verb.answers))
"""All of their models."""
