"""What clients send: the bodies of requests, read strictly, with the library's own defaults.

A body never holds a path of a file, and never a robot: the server has one. Where the world of a request is asked for,
it is a stored scene, one version of it, or what a finished task has left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, Discriminator, Field, JsonValue, Tag, ValidationInfo, WithJsonSchema

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.json_reader import parse_json
from planner_service.files.schema import (
    ONE_PER_JOINT,
    Count,
    Numbers,
    Record,
    Rows,
    Text,
    Vector2,
    Vector3,
    at_most,
    of_length,
    plain,
    read_record,
    recorded,
)
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.kinematics.tool_line import LINE_POINTS, MAX_JOINT_RATE
from planner_service.memory import Memory
from planner_service.memory.memory_file import MemoryRecord
from planner_service.optimize import Optimise
from planner_service.planning.request import Pace, PlanRequest
from planner_service.planning.task_result import MAX_SUPPORT_GAP, Handling
from planner_service.records.request import (
    MAX_GOALS,
    ONE_OF_BOTH,
    JointGoal,
    PayloadRecord,
    PlannerRecord,
    RoomRecord,
    TimingRecord,
    ToolGoal,
    goals_of,
)
from planner_service.records.result import ExemptRecord
from planner_service.records.scene import AttachedRecord, ObstacleRecord, PlanReading
from planner_service.records.steps import Grasps, Steps, steps_of
from planner_service.records.values import Constraints, PoseRecord, Target
from planner_service.records.visits import Visits
from planner_service.robot.model import Robot
from planner_service.scene.scene import MAX_OBJECTS, Scene
from planner_service.tasks.ordering import Visit
from planner_service.tasks.solver import BEAM, SEARCHES
from planner_service.tasks.task import Task
from planner_service.timing.laws import Trapezoidal

__all__ = [
    "AfterTask",
    "Body",
    "CertifyBody",
    "CheckBody",
    "EditsBody",
    "ExplainBody",
    "HandlingBody",
    "MoveLinearBody",
    "OrderBody",
    "PaceBody",
    "PickBody",
    "PickPlaceBody",
    "PlaceBody",
    "PlanBody",
    "RememberingBody",
    "ReplanBody",
    "RoadmapBody",
    "SceneBody",
    "SceneVersion",
    "SettingsBody",
    "SolveBody",
    "read_body",
    "sent",
]

MAX_TIME_LIMIT = 600.0
"""Seconds; a request without a time limit ends at its deadline."""

MIN_DEADLINE, MAX_DEADLINE = 1e-3, 3_600.0
"""Seconds after acceptance at which a request ends in any case."""

MAX_STATES = 10_000
"""Of one check; so many of its edges, too."""

MAX_POSES = 1_000

DEFAULT = PlanRequest((), ())

B = TypeVar("B", bound="Record")


@dataclass
class BodyReading(PlanReading):
    """What is known while a body is read.

    Attributes:
        robot: The server's, whose named poses may stand for joint values; None where there are none.
    """

    robot: Robot | None = None


def read_body(model: type[B], data: bytes, robot: Robot) -> B:
    """The body that the bytes of a request are.

    Raises:
        InvalidFile: They are no JSON, or do not fit; it lists the problems.
    """
    place = Path("body")
    return read_record(model, parse_json(place, data), place, BodyReading(joints=robot.n, robot=robot))


def sent(model: type[Record], values: Mapping[str, Any]) -> dict[str, Any]:
    """The body that a client sends: values of this package by the names of the fields.

    Raises:
        InvalidRequest: One cannot be sent; the message names its field, or what of it is the reason.
    """
    given = {name: plain(value) for name, value in values.items()}
    document = recorded("", lambda: model.of(given)).document()
    return {name: document[name] for name in given}


# Kinds of values.


def _joints_of(value: Any, info: ValidationInfo) -> Any:
    """The joint values of a pose that is given by its name."""
    if not isinstance(value, str) or not isinstance(info.context, BodyReading) or info.context.robot is None:
        return value
    poses = dict(info.context.robot.named_poses)
    if value not in poses:
        raise UnknownName("pose", value, poses)
    return poses[value].tolist()


Configuration = Annotated[
    Numbers,
    ONE_PER_JOINT,
    BeforeValidator(_joints_of),
    WithJsonSchema({"anyOf": [{"type": "array", "items": {"type": "number"}}, {"type": "string"}]}),
    Field(description="Joint values, or the name of a pose of the robot such as home"),
]


TimeLimit = Annotated[float, Field(ge=0.0, le=MAX_TIME_LIMIT)] | None
Deadline = Annotated[float, Field(ge=MIN_DEADLINE, le=MAX_DEADLINE)] | None


class SceneVersion(Record):
    """One version of a stored scene.

    Attributes:
        name: The name of the scene.
        version: Which version of it; the server keeps the last 20.
    """

    name: Text
    version: Annotated[Count, Field(ge=1)]


class AfterTask(Record):
    """The world that a finished pick, place or pick-and-place leaves, with its gripper as it stands then.

    Attributes:
        after: The id of the finished task.
    """

    after: Text


def _world_kind(value: Any) -> str:
    if isinstance(value, str):
        return "name"
    if isinstance(value, AfterTask) or (isinstance(value, dict) and "after" in value):
        return "after"
    return "version"


SceneReference = Annotated[
    Annotated[Text, Tag("name")] | Annotated[SceneVersion, Tag("version")] | Annotated[AfterTask, Tag("after")],
    Discriminator(_world_kind),
]


class PlannerBody(PlannerRecord):
    """A planner: its name, and those of its settings that are not as usual.

    Attributes:
        settings: Those of its settings that are not as usual.
    """

    settings: dict[str, JsonValue] = Field(default_factory=dict)

    @cached_property
    def value(self) -> Any:
        settings = dict(self.settings)
        if self.name == Optimise.name:
            method = settings.get("method", {"name": Optimise().method.name})
            settings["method"] = {"settings": {}, **method} if isinstance(method, dict) else method
        return PlannerRecord.model_construct(name=self.name, settings=settings).value


class TimingBody(TimingRecord):
    """A timing law: its name, and those of its settings that are not as usual.

    Attributes:
        settings: Those of its settings that are not as usual.
    """

    settings: dict[str, JsonValue] = Field(default_factory=dict)


class RoomBody(RoomRecord):
    """What a goal of the tool leaves open."""

    position_tolerance: float = 0.0
    orientation_tolerance: float = 0.0
    free_axis: Vector3 | None = None
    candidates: Count = PoseGoal(Pose()).candidates


class ToolGoalBody(ToolGoal):
    """A pose of the tool, with room or without."""

    room: RoomBody | None = None


class JointGoalBody(JointGoal):
    """A configuration, or the name of a pose of the robot.

    Attributes:
        joints: Joint values in radians (metres for joints that slide), or the name of a pose of the robot such as
            home.
    """

    joints: Configuration


GoalBody = Annotated[Annotated[JointGoalBody, Tag("joints")] | Annotated[ToolGoalBody, Tag("tool")], ONE_OF_BOTH]
Goals = Annotated[list[GoalBody], Field(min_length=1), at_most(MAX_GOALS)]


class Given(Record):
    """A body whose keys have the library's defaults: only those that were sent are handed on."""

    @property
    def given(self) -> dict[str, Any]:
        """The fields that were sent, by name."""
        return {name: value for name, value in self.arguments.items() if name in self.model_fields_set}


class SettingsBody(Given):
    """How motions are planned: a ``PlanRequest`` without its start and its goals.

    Attributes:
        planner: The search, which runs only when no straight line is free; balancedrrtconnect if not given.
            `optimise` does not search but improves straight lines, free or not.
        improve: Further searches for a shorter path, whose best parts are joined: rounds of at most three times the
            states of the first search. They end early once less than 2 % can be gained.
        retries: Further searches with fresh seeds when one gives up, all with equal parts of the checks; null for as
            many as time and checks allow, the later ones longer.
        constraints: What has to hold along the whole motion, ends included, beside what objects that are carried ask
            for. They are searched by balancedrrtconnect, and not optimised.
        payload: What the tool carries, by its mass, all along; for toppra with torque.
        torque_scale: Part in (0, 1] of the joints' efforts that may be used; for toppra with torque.
        padding: Metres that the search keeps from everything, except from what is closer at an end, near that end.
    """

    about = PlanRequest

    planner: PlannerBody = Field(default_factory=lambda: PlannerBody(name=DEFAULT.planner.name))
    timing: TimingBody = Field(default_factory=lambda: TimingBody(name="toppra"))
    improve: Count = DEFAULT.improve
    polish: PlannerBody | None = None
    seed: Count = DEFAULT.seed
    max_checks: Count = DEFAULT.max_checks
    retries: Count | None = None
    padding: float = DEFAULT.padding
    velocity_scale: float = DEFAULT.velocity_scale
    acceleration_scale: float = DEFAULT.acceleration_scale
    blend: float = DEFAULT.blend
    start_tolerance: float = DEFAULT.start_tolerance
    start_overlap: float = DEFAULT.start_overlap
    time_limit: TimeLimit = Field(
        default=DEFAULT.time_limit, description="Seconds for all stages; null for none but the deadline"
    )
    max_tool_speed: float | None = None
    constraints: Constraints = Field(default_factory=list)
    payload: PayloadRecord | None = None
    torque_scale: float = DEFAULT.torque_scale
    evidence: bool = False

    @cached_property
    def value(self) -> PlanRequest:
        return PlanRequest((), (), **self.given)


class RequestBody(SettingsBody):
    """A ``PlanRequest``.

    Attributes:
        start: Where from: joint values in radians (metres for joints that slide), or the name of a pose.
        goals: Where to; one of them is reached.
    """

    start: Configuration
    goals: Goals

    @classmethod
    def fields_of(cls, value: PlanRequest) -> dict[str, Any]:
        return super().fields_of(value) | {"goals": plain(goals_of(value.goal))}

    @cached_property
    def value(self) -> PlanRequest:
        given = self.given
        goals = given.pop("goals")
        return PlanRequest(goal=goals[0] if len(goals) == 1 else goals, **given)

    def __reduce__(self) -> tuple[Any, ...]:
        """A worker gets the value alone: the records that it was made of would take longer to send than to read."""
        return SentRequest, (self.value,)


@dataclass(frozen=True)
class SentRequest:
    """A ``RequestBody`` in a worker."""

    value: PlanRequest


class PaceBody(Given):
    """How fast a given line is followed."""

    about = Pace

    timing: TimingBody = Field(default_factory=lambda: TimingBody(name=Trapezoidal.name))
    velocity_scale: float = 1.0
    acceleration_scale: float = 1.0
    max_tool_speed: float | None = None
    payload: PayloadRecord | None = None
    torque_scale: float = 1.0

    @cached_property
    def value(self) -> Pace:
        return Pace(**{"timing": Trapezoidal(), **self.given})


class HandlingBody(Given):
    """How an object is taken or set down."""

    about = Handling

    support: Text | None = None
    support_gap: Annotated[float, Field(description=f"Metres, at most {MAX_SUPPORT_GAP:g}")] = 0.005
    open_width: float | None = None
    request: SettingsBody | None = None
    line_timing: TimingBody | None = None
    upright: float | None = None

    @cached_property
    def value(self) -> Handling:
        return Handling(**self.given)


# Bodies.


class Body(Record):
    """What every request for work may say.

    Attributes:
        deadline: Seconds from when it is accepted to when it has ended, planned or not.
    """

    deadline: Deadline = Field(
        default=None, description="Seconds from acceptance to the end, whatever the request's own time limit"
    )


class InWorld(Body):
    """A request for work in a world.

    Attributes:
        scene: The world: the name of a stored scene, one version of it, or what a finished task has left.
        gripper_width: Metres between the finger pads; as the robot or the task left it if not given.
    """

    scene: SceneReference
    gripper_width: float | None = None


class RememberingBody(InWorld):
    """A task, with what was remembered of the tasks before it.

    Attributes:
        memory: The section `memory` of an answer before, as it is, or the content of a memory's file: motions are tried
            first that are like those in it, and each is proven anew. If not given, nothing is remembered.
    """

    memory: MemoryRecord | None = None

    @property
    def remembered(self) -> Memory | None:
        """The memory that was sent."""
        return None if self.memory is None else self.memory.value


class PlanBody(InWorld):
    """A motion to be planned.

    Attributes:
        request: Where from, where to, and how.
    """

    request: RequestBody


class CertifyBody(Body):
    """Waypoints in a scene, or a finished plan or task, to be proven free.

    Attributes:
        scene: The world of the waypoints.
        gripper_width: Metres between the finger pads; as the robot or the task left it if not given.
        waypoints: Configurations of the polyline, in radians (metres for joints that slide).
        blends: For each waypoint the path length before and after it that is rounded, in radians; sharp corners if
            not given.
        padding: Metres by which every pair has to be apart.
        exempt: Stretches on which pairs need not be apart.
        constraints: What else has to hold on the whole curve.
        part: Path lengths s from which to which it is judged, in radians; null for all of it.
    """

    plan: Text | None = Field(default=None, description="The id of a finished plan or task, instead of waypoints")
    scene: SceneReference | None = None
    gripper_width: float | None = None
    waypoints: Rows | None = None
    blends: Numbers | None = None
    padding: float = 0.0
    exempt: Annotated[list[ExemptRecord], at_most(MAX_POSES)] = Field(default_factory=list)
    constraints: Constraints = Field(default_factory=list)
    part: Vector2 | None = None

    @cached_property
    def value(self) -> None:
        line = self.scene is not None and self.waypoints is not None
        if line == (self.plan is not None) or (self.plan is not None and self.model_fields_set - {"plan", "deadline"}):
            expected = "either plan alone, or scene and waypoints"
            raise InvalidRequest("plan", self.plan, expected, message=f"expected {expected}")


Edge = Annotated[list[Configuration], of_length(2, "two configurations")]


class CheckBody(InWorld):
    """Configurations and straight edges to be checked.

    Attributes:
        states: Configurations to be checked.
        edges: Straight motions to be checked, each as its two ends.
    """

    states: Annotated[list[Configuration], at_most(MAX_STATES)] = Field(default_factory=list)
    edges: Annotated[list[Edge], at_most(MAX_STATES)] = Field(default_factory=list)


Poses = Annotated[list[PoseRecord], Field(min_length=1), at_most(MAX_POSES)]


class PickBody(RememberingBody):
    """An object to be taken.

    Attributes:
        q: Where the robot stands: joint values in radians (metres for joints that slide), or the name of a pose.
        target: The name of the obstacle to be taken.
        grasps: Poses of the tool in the robot's base frame, best first, or which kinds of grasps are looked for; if not
            given, those from above, and where none of them has a plan those of other kinds.
        handling: How it is taken.
    """

    q: Configuration
    target: Text
    grasps: Grasps | None = Field(
        default=None,
        description="Poses of the tool, best first, or kinds; if not given, from above first, then of other kinds",
    )
    handling: HandlingBody | None = None


class PlaceBody(RememberingBody):
    """A carried object to be set down.

    Attributes:
        carried: The name of the attached object.
        poses: Poses of the object in the robot's base frame, best first.
        handling: How it is set down.
    """

    q: Configuration | None = Field(default=None, description="Where the robot stands; where the task before ended")
    carried: Text
    poses: Poses
    handling: HandlingBody | None = None

    @cached_property
    def value(self) -> None:
        if self.q is None and not isinstance(self.scene, AfterTask):
            raise InvalidRequest("q", None, "joint values, as the scene is not what a task left")


class PickPlaceBody(RememberingBody):
    """An object to be taken and set down on another one.

    Attributes:
        target: The name of the obstacle to be taken.
        onto: The name of the obstacle that it is set down on.
        poses: Poses of the object in the robot's base frame, best first; the middle of `onto` if not given.
        start: Where the robot starts and ends: joint values in radians (metres for joints that slide), or the name of
            a pose.
        request: Planner, timing, seed, padding and limits of all motions.
        upright: Radians by which the object may lean while it is carried from how it stood; null for any.
    """

    target: Text
    onto: Text
    poses: Poses | None = Field(default=None, description="Where it may be set down, best first; the middle of onto")
    start: Annotated[Configuration, Field(validate_default=True)] = "home"  # type: ignore[assignment]
    request: SettingsBody | None = None
    upright: float | None = None

    @property
    def plan_request(self) -> PlanRequest:
        """The request of all motions."""
        settings = {} if self.request is None else self.request.given
        return PlanRequest(self.start, self.start, **settings)


class SolveBody(RememberingBody):
    """A task to be solved.

    Attributes:
        q: Where the robot stands: joint values in radians (metres for joints that slide), or the name of a pose.
        steps: What is to be done, in order.
        name: What is to be done, in words.
        request: Planner, timing, seed, padding and limits of all motions.
        line_timing: The timing law along straight lines of the tool; that of the request if not given.
        beam: Ways of one step that are carried forward before the step before it has to offer another.
        searches: Searches that may be tried in all.
    """

    q: Configuration | None = Field(default=None, description="Where the robot stands; where the task before ended")
    steps: Steps
    name: Text = ""
    request: SettingsBody | None = None
    line_timing: TimingBody | None = None
    beam: Annotated[Count, Field(ge=1, le=1_000)] = BEAM
    searches: Annotated[Count, Field(ge=1, le=1_000_000)] = SEARCHES

    @cached_property
    def value(self) -> Task:
        if self.q is None and not isinstance(self.scene, AfterTask):
            raise InvalidRequest("q", None, "joint values, as the scene is not what a task left")
        return Task(steps_of(self.steps), self.name)


class OrderBody(InWorld):
    """Visits to be put in order.

    Attributes:
        q: Where the robot starts: joint values in radians (metres for joints that slide), or the name of a pose.
        visits: What is to be visited, with the branches of each.
        end: Where it ends, likewise; where it starts if not given.
        request: Planner, timing, seed, padding and limits of all motions.
        gap: Share of the bound by which the order may be longer than the best; no more is looked for then.
        plans: Legs that may be planned.
    """

    q: Configuration | None = Field(default=None, description="Where the robot starts; where the task before ended")
    visits: Visits
    end: Configuration | None = Field(default=None, description="Where the robot ends; where it starts if not given")
    request: SettingsBody | None = None
    gap: Annotated[float, Field(ge=0.0, le=10.0)] = 0.05
    plans: Annotated[Count, Field(ge=1, le=1_000_000)] = 3000

    @cached_property
    def value(self) -> tuple[Visit, ...]:
        if self.q is None and not isinstance(self.scene, AfterTask):
            raise InvalidRequest("q", None, "joint values, as the scene is not what a task left")
        return tuple(visit.value for visit in self.visits)


def _target_kind(value: Any) -> str:
    if isinstance(value, list):
        return "displacement" if all(isinstance(entry, int | float) for entry in value) else "several"
    return "pose"


Targets = Annotated[
    Annotated[PoseRecord, Tag("pose")]
    | Annotated[Vector3, Tag("displacement")]
    | Annotated[list[Target], at_most(MAX_POSES), Tag("several")],
    Discriminator(_target_kind),
]


class MoveLinearBody(InWorld):
    """A straight motion of the tool, or several with rounded corners.

    Attributes:
        zone: Metres before and after a corner of the line that may be rounded; 0 stops at each corner.
        points: Points of the tool line at which inverse kinematics is solved, on every straight piece.
        max_joint_rate: Radians that a joint may turn per metre of the line, beyond which the line is refused as too
            near a singularity.
        free_axis: Axis x, y, z in the tool frame about which the tool may turn as it likes; null for none.
        partial: Whether a part of the line is an answer, if not all of it can be followed.
        pace: How fast it is followed.
        padding: Metres that everything has to keep.
        constraints: What else has to hold on the whole line.
    """

    start: Configuration
    goal: Targets = Field(description="A pose, a displacement in metres, or a list of these")
    zone: float = 0.0
    points: Count = LINE_POINTS
    max_joint_rate: float = MAX_JOINT_RATE
    free_axis: Vector3 | None = None
    partial: bool = False
    pace: PaceBody | None = None
    padding: float = 0.0
    constraints: Constraints = Field(default_factory=list)


class ReplanBody(Body):
    """A robot that executes a plan, for which a new motion is wanted.

    Attributes:
        plan: The id of the plan that the robot executes, or of what replanning returned before.
        at_time: Seconds on the clock of that motion at which the robot is now.
        latency: Seconds from now until the new motion may begin.
        scene: The world from now on; that of the plan if not given.
        goals: Where to; the goals of the plan if not given.
        request: Planner, timing, seed, padding and limits of the new motion; those of the plan if not given.
    """

    plan: Text = Field(description="The id of the plan, or of what replanning returned before")
    at_time: float
    latency: float = 0.1
    scene: SceneReference | None = Field(default=None, description="From now on; that of the plan if not given")
    goals: Goals | None = None
    request: SettingsBody | None = None

    @property
    def goal(self) -> Any:
        """The goal as ``replan`` takes it."""
        if self.goals is None:
            return None
        goals = [goal.value for goal in self.goals]
        return goals[0] if len(goals) == 1 else goals


class ExplainBody(InWorld):
    """A request, to explain why it has no plan.

    Attributes:
        request: The request that has no plan.
        plans: Plans that may be tried at most.
        remedies: Remedies after which no more are looked for.
        time_limit: Seconds for all of it; null for as long as it takes.
    """

    request: RequestBody
    plans: Annotated[Count, Field(ge=1, le=1_000)] = 60
    remedies: Annotated[Count, Field(ge=1, le=1_000)] = 3
    time_limit: Annotated[float, Field(ge=0.0, le=86_400.0)] | None = None


class RoadmapBody(InWorld):
    """A roadmap to be grown.

    Attributes:
        planner: The planner that grows it: prm, prmstar or lazyprm.
        seed: Decides every random choice.
        padding: Metres that the roadmap keeps from everything.
    """

    planner: PlannerBody
    seed: Count = 0
    padding: float = 0.001


class SceneBody(Record):
    """A scene to be stored.

    Attributes:
        description: What it is, for a person.
        obstacles: What stands in it.
        attached: What the tool carries.
    """

    description: str = ""
    obstacles: Annotated[list[ObstacleRecord], at_most(MAX_OBJECTS)]
    attached: Annotated[list[AttachedRecord], at_most(MAX_OBJECTS)] = Field(default_factory=list)

    def scene(self, name: str) -> Scene:
        """The scene, under its name."""
        return Scene(name=name, **self.arguments)


class AddEdit(Record):
    """Adds an obstacle.

    Attributes:
        op: Tells kinds of changes apart.
        obstacle: What is added; no other obstacle has its name.
    """

    op: Literal["add"]
    obstacle: ObstacleRecord


class RemoveEdit(Record):
    """Takes an obstacle away.

    Attributes:
        op: Tells kinds of changes apart.
        name: The obstacle that is taken away.
    """

    op: Literal["remove"]
    name: Text


class MoveEdit(Record):
    """Puts an obstacle somewhere else.

    Attributes:
        op: Tells kinds of changes apart.
        name: The obstacle that is moved.
        pose: Its new pose, in the robot's base frame.
    """

    op: Literal["move"]
    name: Text
    pose: PoseRecord


class EditsBody(Record):
    """Changes to a scene, made in their order, all of them or none.

    Attributes:
        edits: Each applies to what those before it left.
    """

    edits: Annotated[
        list[Annotated[AddEdit | RemoveEdit | MoveEdit, Field(discriminator="op")]],
        Field(min_length=1),
        at_most(MAX_OBJECTS),
    ]

    def applied(self, scene: Scene) -> Scene:
        """The scene with all changes."""
        for edit in self.edits:
            if isinstance(edit, AddEdit):
                scene = scene.with_obstacle(edit.obstacle.value)
            elif isinstance(edit, RemoveEdit):
                scene = scene.without(edit.name)
            else:
                scene = scene.moved(edit.name, edit.pose.value)
        return scene
