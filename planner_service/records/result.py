"""Results and failures as JSON objects, and back, without the loss of a bit.

A plan is ``q(t) = path(s(t))``: ``waypoints`` is the polyline, ``blends`` what of it before and after each waypoint is
rounded (``planner_service.path.corner_blend`` has the formula), and row i of ``coefficients`` holds c0 to c3 of
``s = c0 + c1 x + c2 x^2 + c3 x^3``, x the time since that piece began, for ``durations[i]`` seconds; s is the L2 length
along the polyline.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, WithJsonSchema

from planner_service.certify import (
    Certificate,
    ExemptInterval,
    GripperMotion,
    Kept,
    KeptBound,
    KeptRefusal,
    Refusal,
)
from planner_service.certify.colliding_solutions import CollidingSolution
from planner_service.collision import CheckCounts, Contact
from planner_service.errors import InvalidRequest
from planner_service.files import schema
from planner_service.geometry.arrays import read_only
from planner_service.kinematics.reachability import Cause, LimitExcess, Slip, Suggestion, Unreachable
from planner_service.optimize import Figures
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import LimitPeaks, Peak, Trajectory
from planner_service.planning.result import (
    Failure,
    ImproveReport,
    MotionReport,
    NearEnd,
    PlanResult,
    PolishReport,
    Reason,
    Stage,
    StageReport,
)
from planner_service.records.values import Constraints, PoseRecord

__all__ = [
    "MAX_PAIRS",
    "CountsRecord",
    "FailureRecord",
    "GripperMotionRecord",
    "PairList",
    "ResultRecord",
    "StageName",
    "certificate_record",
    "result_record",
]

MAX_PAIRS = 100_000


def _one_of(kind: type[enum.Enum]) -> Callable[[str], str]:
    values = [member.value for member in kind]

    def checked(value: str) -> str:
        if value not in values:
            raise ValueError(f"one of {', '.join(values)}")
        return value

    return checked


def _listed(kind: type[enum.Enum]) -> WithJsonSchema:
    return WithJsonSchema({"type": "string", "enum": [member.value for member in kind]})


StageName = Annotated[str, AfterValidator(_one_of(Stage)), _listed(Stage)]
ReasonName = Annotated[str, AfterValidator(_one_of(Reason)), _listed(Reason)]
CauseName = Annotated[str, AfterValidator(_one_of(Cause)), _listed(Cause)]
SlipName = Annotated[str, AfterValidator(_one_of(Slip)), _listed(Slip)]


class ContactRecord(schema.Record, makes=Contact):
    """A ``Contact``."""

    depth: float = Field(alias="depth_at_most")


class BlockedRecord(schema.Record):
    """One entry of ``Failure.blocked_by``.

    Attributes:
        a: The link, or the carried object.
        b: What it hit.
        share: Part in (0, 1] of the configurations found colliding in which these two touch.
    """

    a: schema.Text
    b: schema.Text
    share: float

    @cached_property
    def value(self) -> tuple[str, str, float]:
        return self.a, self.b, self.share


class LimitExcessRecord(schema.Record, makes=LimitExcess):
    """A ``LimitExcess``.

    Attributes:
        joint: Its name.
        needed: The position that it would need, in radians (metres if it slides).
        limit: Its limit, which that is beyond, likewise.
    """


class SuggestionRecord(schema.Record, makes=Suggestion):
    """A ``Suggestion``.

    Attributes:
        slips: The mistakes.
        pose: The pose that may have been meant, in the robot's base frame.
    """

    slips: Annotated[list[SlipName], schema.at_most(len(Slip))]
    pose: PoseRecord

    @cached_property
    def value(self) -> Suggestion:
        return Suggestion(tuple(map(Slip, self.slips)), self.pose.value)


class UnreachableRecord(schema.Record, makes=Unreachable):
    """An ``Unreachable``.

    Attributes:
        nearest: Joint values within the limits that come nearest in position; if they reach that, the nearest in
            orientation; with MISSED, joint values for the pose. In radians (metres for joints that slide).
    """

    cause: CauseName

    @cached_property
    def value(self) -> Unreachable:
        arguments = self.arguments
        return Unreachable(**arguments | {"cause": Cause(self.cause), "nearest": read_only(arguments["nearest"])})


class CollidingRecord(schema.Record, makes=CollidingSolution):
    """A ``CollidingSolution``.

    Attributes:
        q: In radians (metres for joints that slide).
    """

    q: schema.Joints
    lower: schema.Joints
    upper: schema.Joints
    a: schema.Text
    b: schema.Text

    @cached_property
    def value(self) -> CollidingSolution:
        q, lower, upper = (read_only(row) for row in (self.q, self.lower, self.upper))
        return CollidingSolution(q, lower, upper, self.a, self.b)


class FailureRecord(schema.GrownRecord):
    """A ``Failure``.

    Attributes:
        blocked_by: For a search, what was hit most often, most frequent first.
        nearest_free: For an end in collision, the nearest free joint values found, in radians (metres for joints that
            slide).
    """

    about = Failure

    stage: StageName
    reason: ReasonName
    detail: schema.Prose
    contacts: Annotated[list[ContactRecord], schema.at_most(MAX_PAIRS)]
    nearest_free: schema.Joints | None
    blocked_by: Annotated[list[BlockedRecord], schema.at_most(MAX_PAIRS)]
    unreachable: UnreachableRecord | None = None
    proven: bool = False
    colliding: Annotated[list[CollidingRecord], schema.at_most(MAX_PAIRS)] = Field(default_factory=list)

    @cached_property
    def value(self) -> Failure:
        arguments = self.arguments | {"stage": Stage(self.stage), "reason": Reason(self.reason)}
        return Failure(**arguments | {"nearest_free": self.nearest_free and read_only(self.nearest_free)})


MAX_ENTRIES = 1_000
"""Of stages, stretches, contacts or notes."""

ROUNDING = 1e-9
"""By which sums may differ from one machine to another."""

PairList = Annotated[list[schema.NamePair], schema.FirstOnly(), schema.at_most(MAX_PAIRS)]
Notes = Annotated[list[schema.Prose], schema.FirstOnly(), schema.at_most(10 * MAX_ENTRIES)]


def result_record(result: PlanResult) -> dict[str, Any]:
    """A plan or its failure, with what it cost, as a JSON object."""
    return schema.recorded("result", lambda: ResultRecord.of(result)).document()


def certificate_record(certificate: Certificate) -> dict[str, Any]:
    """What was proven of a curve, as a JSON object."""
    return schema.recorded("certificate", lambda: CertificateRecord.of(certificate)).document()


def _null_for_infinity(value: Any, info: ValidationInfo) -> Any:
    """JSON has no infinity."""
    infinite = isinstance(value, float) and not math.isfinite(value)
    return None if infinite and not isinstance(info.context, schema.Reading) else value


def _or_infinity(value: float | None) -> float:
    return math.inf if value is None else value


Unbounded = Annotated[float | None, BeforeValidator(_null_for_infinity)]
"""Null where it is infinite."""


class CountsRecord(schema.GrownRecord, makes=CheckCounts):
    """``CheckCounts``."""

    projections: schema.Count = 0


class StageRecord(schema.GrownRecord):
    """A ``StageReport``.

    Attributes:
        stage: Which stage.
        states: Configurations judged free or not.
        edges: Edges judged.
        distances: Clearance bounds of a pair in a configuration.
        projections: Configurations moved to where they keep constraints.
        seconds: Wall time in seconds.
        length: L2 length of the path after the stage in joint space, in radians (metres for joints that slide); null
            without one.
    """

    about = StageReport

    stage: StageName
    states: schema.Count
    edges: schema.Count
    distances: schema.Count
    seconds: float
    length: float | None
    note: schema.Prose
    projections: schema.Count = 0

    @classmethod
    def fields_of(cls, value: StageReport) -> dict[str, Any]:
        return super().fields_of(value) | super().fields_of(value.counts)

    @cached_property
    def value(self) -> StageReport:
        counts = CheckCounts(self.states, self.edges, self.distances, self.projections)
        return StageReport(Stage(self.stage), counts, self.seconds, self.length, self.note)


class ExemptRecord(schema.GrownRecord, makes=ExemptInterval):
    """An ``ExemptInterval``.

    Attributes:
        s_start: Path length s at which it begins, in radians along the joint path.
        s_end: Path length s at which it ends.
        pairs: The names of each two.
        reason: The rule that allows it.
    """

    pairs: PairList
    reason: schema.Prose
    depth: float | None = None


class NearEndRecord(schema.Record, makes=NearEnd):
    """A ``NearEnd``.

    Attributes:
        s_start: Path length s, in radians, at which it begins.
        s_end: Path length s at which it ends.
    """

    pairs: PairList


class RefusalRecord(schema.Record, makes=Refusal):
    """A ``Refusal``.

    Attributes:
        s_start: Path length s, in radians, at which the stretch begins on which a pair could not be proven apart.
        s_end: Path length s at which it ends.
        s: Path length s on it at which the two are closest, as far as was looked.
    """

    detail: schema.Prose


class KeptBoundRecord(schema.Record, makes=KeptBound):
    """A ``KeptBound``.

    Attributes:
        bound: No deviation on the curve is larger, in `unit`; rounded up to a whole nanometre or nanoradian.
        tolerance: How large it may be, in `unit`; `bound` exceeds it by less than the proof's slack.
    """


class KeptRecord(schema.Record, makes=Kept):
    """A ``Kept``."""


class KeptRefusalRecord(schema.Record, makes=KeptRefusal):
    """A ``KeptRefusal``.

    Attributes:
        quantity: What it bounds, such as tilt, x, or a joint's name.
        s_start: Path length s, in radians, at which the stretch around `s` begins on which it is not proven.
        s_end: Path length s at which it ends.
        s: Path length s at which the deviation is largest, as far as was looked.
        deviation: The deviation at `s`, in `unit`; if `spent`, an upper bound of it on the stretch.
        tolerance: How large it may be, in `unit`.
    """


class CertificateRecord(schema.GrownRecord):
    """A ``Certificate``; its clearance is null where nothing can touch or nothing was proven.

    Attributes:
        certified: Whether the whole curve, or the judged part of it, is proven.
        clearance: Metres that every judged pair keeps on the whole curve, a lower bound in whole nanometres; null
            when no pair is judged, or for a refused curve.
        padding: Metres; every judged pair was proven farther apart than this.
        refusal: The pair that is not proven apart, and where; null if there is none.
        not_kept: The constraint that is not proven kept, and where; null if there is none.
    """

    about = Certificate

    certified: bool
    clearance: Unbounded
    distances: schema.Count
    padding: float
    exempt: Annotated[list[ExemptRecord], schema.at_most(MAX_ENTRIES)]
    refusal: RefusalRecord | None
    part: schema.Vector2 | None
    allowed: PairList
    kept: Annotated[list[KeptRecord], schema.at_most(MAX_ENTRIES)] = Field(default_factory=list)
    not_kept: KeptRefusalRecord | None = None

    @classmethod
    def fields_of(cls, value: Certificate) -> dict[str, Any]:
        not_kept = value.refusal if isinstance(value.refusal, KeptRefusal) else None
        return super().fields_of(value) | {
            "refusal": None if not_kept is not None else value.refusal,
            "not_kept": not_kept,
        }

    @cached_property
    def value(self) -> Certificate:
        arguments = self.arguments
        refusal = arguments["refusal"] = arguments.pop("not_kept") or arguments["refusal"]
        if arguments.pop("certified") != (refusal is None):
            raise InvalidRequest("certified", self.certified, "true without a refusal, false with one")
        if self.clearance is None:
            arguments["clearance"] = math.inf if refusal is None else -math.inf
        return Certificate(**arguments)


class GripperMotionRecord(schema.GrownRecord):
    """A ``GripperMotion``.

    Attributes:
        end_width: Metres between them after.
    """

    makes = about = GripperMotion

    start: float = Field(alias="start_width")
    end: float = Field(alias="end_width")
    seconds: float
    certificate: CertificateRecord
    travel: Annotated[float, Field(gt=0.0)] | None = None


class PeakRecord(schema.Record, makes=Peak):
    """A ``Peak``.

    Attributes:
        ratio: The largest value by its limit; null if it is infinite, as of the jerk where the acceleration jumps.
        joint: Index of the joint, from 0.
        time: Seconds from the beginning of the motion.
    """

    ratio: Unbounded

    @cached_property
    def value(self) -> Peak:
        return Peak(**self.arguments | {"ratio": _or_infinity(self.ratio)})


class PeaksRecord(schema.GrownRecord, makes=LimitPeaks):
    """``LimitPeaks``.

    Attributes:
        velocity: Where a velocity comes closest to its limit.
        acceleration: Where an acceleration does.
        jerk: Where a jerk does.
    """

    torques: Annotated[list[PeakRecord], schema.at_most(MAX_ENTRIES)] = Field(default_factory=list)


class MotionRecord(schema.Record):
    """A ``MotionReport``; the duration with stops is null where there is none.

    Attributes:
        stop_duration: Seconds that the same polyline would take with a stop at each of its corners; null if the
            timing law has no solution for that.
    """

    about = MotionReport

    peaks: PeaksRecord
    tool_speed: float
    duration: float
    settle_time: float
    stop_duration: Unbounded

    @cached_property
    def value(self) -> MotionReport:
        return MotionReport(**self.arguments | {"stop_duration": _or_infinity(self.stop_duration)})


class FiguresRecord(schema.Record, makes=Figures):
    """``Figures``.

    Attributes:
        clearance: Metres between the nearest pair at any point; distances beyond the search radius count as that.
        shortfall: Metres by which pairs are too near, summed over points and divided by the points per waypoint.
    """


class PolishRecord(schema.Record, makes=PolishReport):
    """A ``PolishReport``.

    Attributes:
        method: The name of the method.
        iterations: Iterations of the method.
    """

    note: schema.Prose


class ImproveRecord(schema.Record, makes=ImproveReport):
    """An ``ImproveReport``.

    Attributes:
        rounds: Rounds made of those that were asked for: no more once less than 2 % could be gained.
        before: L2 length in joint space of the first path, shortened, its corners not yet blended, in radians.
        after: The same of the shortest that was found.
        bound: No path is shorter: the distance from the start to the nearest goal, in radians.
    """


class PathRecord(schema.Record):
    """A ``JointPath``.

    Attributes:
        length: L2 length of the polyline in joint space, in radians (metres for joints that slide).
        waypoints: Configurations, in radians (metres for joints that slide).
        blends: For each waypoint the path length before and after it that its blend replaces, in radians; 0 keeps the
            corner, a full stop. Empty for no blends.
    """

    about = JointPath

    length: float
    waypoints: schema.Rows
    blends: schema.Numbers

    @cached_property
    def value(self) -> JointPath:
        path = JointPath(np.array(self.waypoints, dtype=np.float64), np.array(self.blends, dtype=np.float64))
        apart = len(path.waypoints)
        if apart != len(self.waypoints):
            raise InvalidRequest("waypoints", len(self.waypoints), f"{apart}: no waypoint where the one before it is")
        if not math.isclose(path.length, self.length, rel_tol=ROUNDING, abs_tol=ROUNDING):
            raise InvalidRequest("length", self.length, f"that of the waypoints, {path.length!r}")
        return path


class TrajectoryRecord(schema.Record):
    """A ``Trajectory``, its path apart.

    Attributes:
        duration: Seconds.
        durations: Seconds of each piece of s(t).
        coefficients: Of each piece c0 to c3 of s = c0 + c1 x + c2 x^2 + c3 x^3, with x in seconds since the piece
            began and s the path length in radians.
        part: Path lengths s from which to which it runs; null for the whole path, from rest to rest.
    """

    about = Trajectory

    duration: float
    dilation: float
    durations: schema.Numbers
    coefficients: Annotated[list[schema.Vector4], schema.FirstOnly()]
    part: schema.Vector2 | None

    def along(self, path: JointPath) -> Trajectory:
        """The trajectory along a path; InvalidRequest if the numbers make none."""
        table = np.array(self.coefficients, dtype=np.float64).reshape(-1, 4)
        durations = np.array(self.durations, dtype=np.float64)
        part = None if self.part is None else (self.part[0], self.part[1])
        trajectory = Trajectory(path, durations, table, self.dilation, part)
        if not math.isclose(trajectory.duration, self.duration, rel_tol=ROUNDING, abs_tol=ROUNDING):
            raise InvalidRequest("duration", self.duration, f"the sum of durations, {trajectory.duration!r}")
        return trajectory


class ResultRecord(schema.GrownRecord):
    """A ``PlanResult``, without what only the process that made it knows: roadmap, memory, trace and origin.

    Attributes:
        ok: Whether there is a plan.
        counts: What all stages took.
        goal_index: Which of the requested goals the path reaches, from 0; null if none is reached.
        failure: Why there is no plan; null with one.
    """

    about = PlanResult

    ok: bool
    failure: FailureRecord | None
    goal_index: schema.Count | None
    attempts: schema.Count
    padding: float
    deterministic: bool
    notes: Notes
    counts: CountsRecord
    stages: Annotated[list[StageRecord], schema.at_most(MAX_ENTRIES)]
    certificate: CertificateRecord | None
    motion: MotionRecord | None
    polish: PolishRecord | None
    path: PathRecord | None
    trajectory: TrajectoryRecord | None
    constraints: Constraints = Field(default_factory=list)
    near_ends: Annotated[list[NearEndRecord], schema.at_most(2)] = Field(default_factory=list)
    improvement: ImproveRecord | None = None

    @cached_property
    def value(self) -> PlanResult:
        parts = (self.path, self.trajectory, self.certificate, self.motion)
        if (self.failure is None) == any(part is None for part in parts):
            words = "either a failure, or a path, a trajectory, a certificate and a motion"
            raise InvalidRequest("result", self.ok, words, message=f"expected {words}")
        arguments = self.arguments
        ok, counts, path = arguments.pop("ok"), arguments.pop("counts"), arguments["path"]
        if self.trajectory is not None and path is not None:
            arguments["trajectory"] = _named("trajectory", self.trajectory.along, path)
        result = PlanResult(**arguments)
        if result.ok != ok:
            raise InvalidRequest("ok", ok, "false with a failure, true without")
        if result.counts != counts:
            raise InvalidRequest("counts", str(counts), f"the sum of the stages, {result.counts}")
        kept = () if result.certificate is None else result.certificate.kept
        if result.ok and len(kept) != len(result.constraints):
            expected = f"a proof of each of the {len(result.constraints)} constraints"
            raise InvalidRequest("certificate.kept", len(kept), expected)
        if result.ok and not _covers(result):
            raise InvalidRequest("certificate", self.certificate, "a proof of all that the trajectory runs along")
        return result


def _named(field: str, make: Callable[[JointPath], Trajectory], path: JointPath) -> Trajectory:
    try:
        return make(path)
    except InvalidRequest as error:
        raise InvalidRequest(field, error.value, error.expected, message=f"{field}: {error}") from None


def _covers(result: PlanResult) -> bool:
    """Whether a motion runs along what is proven."""
    certificate, trajectory = result.certificate, result.trajectory
    if certificate is None or trajectory is None:
        return False
    begin, end = (-math.inf, math.inf) if certificate.part is None else certificate.part
    return begin <= trajectory.begin and trajectory.end <= end
