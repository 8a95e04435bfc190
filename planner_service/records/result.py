"""Results as JSON objects, and back, without the loss of a bit.

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
from pydantic import AfterValidator

from planner_service.certify import Certificate, ExemptInterval, GripperMotion, Refusal
from planner_service.collision import CheckCounts, Contact
from planner_service.errors import InvalidRequest
from planner_service.files.schema import (
    Count,
    FirstOnly,
    Joints,
    NamePair,
    Numbers,
    Record,
    Rows,
    Text,
    Vector2,
    Vector4,
    as_text,
    at_most,
    recorded,
)
from planner_service.geometry.arrays import read_only
from planner_service.optimize import Figures
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planning.result import Failure, MotionReport, PlanResult, PolishReport, Reason, Stage, StageReport
from planner_service.timing.limit_check import LimitPeaks, Peak

__all__ = [
    "CountsRecord",
    "FailureRecord",
    "GripperMotionRecord",
    "PairList",
    "ResultRecord",
    "certificate_record",
    "counts_record",
    "failure_record",
    "name_pairs",
    "result_record",
]

MAX_ENTRIES = 1_000
"""Of stages, stretches, contacts or notes."""

MAX_PAIRS = 100_000

ROUNDING = 1e-9
"""By which sums may differ from one machine to another."""

PairList = Annotated[list[NamePair], FirstOnly(), at_most(MAX_PAIRS)]
Notes = Annotated[list[Text], FirstOnly(), at_most(10 * MAX_ENTRIES)]


def counts_record(counts: CheckCounts) -> dict[str, int]:
    """What was asked of the checker, as a JSON object."""
    return {"states": counts.states, "edges": counts.edges, "distances": counts.distances}


def result_record(result: PlanResult) -> dict[str, Any]:
    """A plan or its failure, with what it cost, as a JSON object."""
    return recorded("result", lambda: ResultRecord.of(result)).model_dump()


def certificate_record(certificate: Certificate) -> dict[str, Any]:
    """What was proven of a curve, as a JSON object."""
    return recorded("certificate", lambda: CertificateRecord.of(certificate)).model_dump()


def failure_record(failure: Failure | None) -> dict[str, Any] | None:
    """Why there is no plan, as a JSON object; None for None."""
    return None if failure is None else recorded("failure", lambda: FailureRecord.of(failure)).model_dump()


def name_pairs(pairs: list[list[str]]) -> tuple[tuple[str, str], ...]:
    """Pairs of names as they came from a file."""
    return tuple((a, b) for a, b in pairs)


def _one_of(kind: type[enum.Enum]) -> Callable[[str], str]:
    values = [member.value for member in kind]

    def checked(value: str) -> str:
        if value not in values:
            raise ValueError(f"one of {', '.join(values)}")
        return value

    return checked


StageName = Annotated[str, AfterValidator(_one_of(Stage))]
ReasonName = Annotated[str, AfterValidator(_one_of(Reason))]


def _finite(value: float) -> float | None:
    """JSON has no infinity."""
    return value if math.isfinite(value) else None


class CountsRecord(Record):
    """``CheckCounts``."""

    states: Count
    edges: Count
    distances: Count

    @classmethod
    def of(cls, counts: CheckCounts) -> CountsRecord:
        return cls(**counts_record(counts))

    @cached_property
    def value(self) -> CheckCounts:
        return CheckCounts(self.states, self.edges, self.distances)


class StageRecord(Record):
    """A ``StageReport``."""

    stage: StageName
    states: Count
    edges: Count
    distances: Count
    seconds: float
    length: float | None
    note: Text

    @classmethod
    def of(cls, report: StageReport) -> StageRecord:
        counts = report.counts
        return cls(
            stage=report.stage.value,
            states=counts.states,
            edges=counts.edges,
            distances=counts.distances,
            seconds=report.seconds,
            length=report.length,
            note=as_text(report.note),
        )

    @cached_property
    def value(self) -> StageReport:
        counts = CheckCounts(self.states, self.edges, self.distances)
        return StageReport(Stage(self.stage), counts, self.seconds, self.length, self.note)


class ContactRecord(Record):
    """A ``Contact``."""

    a: Text
    b: Text
    depth_at_most: float


class BlockedRecord(Record):
    """One entry of ``Failure.blocked_by``."""

    a: Text
    b: Text
    share: float


class FailureRecord(Record):
    """A ``Failure``."""

    stage: StageName
    reason: ReasonName
    detail: Text
    contacts: Annotated[list[ContactRecord], at_most(MAX_PAIRS)]
    nearest_free: Joints | None
    blocked_by: Annotated[list[BlockedRecord], at_most(MAX_PAIRS)]

    @classmethod
    def of(cls, failure: Failure) -> FailureRecord:
        return cls(
            stage=failure.stage.value,
            reason=failure.reason.value,
            detail=as_text(failure.detail),
            contacts=[ContactRecord(a=c.a, b=c.b, depth_at_most=c.depth) for c in failure.contacts],
            nearest_free=None if failure.nearest_free is None else failure.nearest_free.tolist(),
            blocked_by=[BlockedRecord(a=a, b=b, share=share) for a, b, share in failure.blocked_by],
        )

    @cached_property
    def value(self) -> Failure:
        return Failure(
            Stage(self.stage),
            Reason(self.reason),
            self.detail,
            tuple(Contact(c.a, c.b, c.depth_at_most) for c in self.contacts),
            None if self.nearest_free is None else read_only(self.nearest_free),
            tuple((entry.a, entry.b, entry.share) for entry in self.blocked_by),
        )


class ExemptRecord(Record):
    """An ``ExemptInterval``."""

    s_start: float
    s_end: float
    pairs: PairList
    reason: Text

    @classmethod
    def of(cls, interval: ExemptInterval) -> ExemptRecord:
        pairs = [list(pair) for pair in interval.pairs]
        return cls(s_start=interval.s_start, s_end=interval.s_end, pairs=pairs, reason=as_text(interval.reason))

    @cached_property
    def value(self) -> ExemptInterval:
        return ExemptInterval(self.s_start, self.s_end, name_pairs(self.pairs), self.reason)


class RefusalRecord(Record):
    """A ``Refusal``."""

    s_start: float
    s_end: float
    s: float
    a: Text
    b: Text
    detail: Text
    spent: bool

    @classmethod
    def of(cls, refusal: Refusal) -> RefusalRecord:
        return cls(**{**vars(refusal), "detail": as_text(refusal.detail)})

    @cached_property
    def value(self) -> Refusal:
        return Refusal(self.s_start, self.s_end, self.s, self.a, self.b, self.detail, self.spent)


class CertificateRecord(Record):
    """A ``Certificate``; its clearance is null where nothing can touch or nothing was proven."""

    certified: bool
    clearance: float | None
    distances: Count
    padding: float
    exempt: Annotated[list[ExemptRecord], at_most(MAX_ENTRIES)]
    refusal: RefusalRecord | None
    part: Vector2 | None
    allowed: PairList

    @classmethod
    def of(cls, certificate: Certificate) -> CertificateRecord:
        return cls(
            certified=certificate.certified,
            clearance=_finite(certificate.clearance),
            distances=certificate.distances,
            padding=certificate.padding,
            exempt=[ExemptRecord.of(interval) for interval in certificate.exempt],
            refusal=None if certificate.refusal is None else RefusalRecord.of(certificate.refusal),
            part=_span(certificate.part),
            allowed=[list(pair) for pair in certificate.allowed],
        )

    @cached_property
    def value(self) -> Certificate:
        refusal = None if self.refusal is None else self.refusal.value
        if self.certified != (refusal is None):
            raise InvalidRequest("certified", self.certified, "true without a refusal, false with one")
        clearance = self.clearance
        if clearance is None:
            clearance = math.inf if refusal is None else -math.inf
        exempt = tuple(interval.value for interval in self.exempt)
        part, allowed = _pair(self.part), name_pairs(self.allowed)
        return Certificate(clearance, self.distances, self.padding, exempt, refusal, part, allowed)


class GripperMotionRecord(Record):
    """A ``GripperMotion``."""

    start_width: float
    end_width: float
    seconds: float
    certificate: CertificateRecord

    @classmethod
    def of(cls, motion: GripperMotion) -> GripperMotionRecord:
        proof = CertificateRecord.of(motion.certificate)
        return cls(start_width=motion.start, end_width=motion.end, seconds=motion.seconds, certificate=proof)

    @cached_property
    def value(self) -> GripperMotion:
        return GripperMotion(self.start_width, self.end_width, self.certificate.value, self.seconds)


def _span(part: tuple[float, float] | None) -> list[float] | None:
    """The part of a path that is meant; None: all of it."""
    return None if part is None else list(part)


def _pair(part: list[float] | None) -> tuple[float, float] | None:
    return None if part is None else (part[0], part[1])


class PeakRecord(Record):
    """A ``Peak``; the ratio is null where it is infinite."""

    ratio: float | None
    joint: Count
    time: float

    @classmethod
    def of(cls, peak: Peak) -> PeakRecord:
        return cls(ratio=_finite(peak.ratio), joint=int(peak.joint), time=peak.time)

    @cached_property
    def value(self) -> Peak:
        return Peak(math.inf if self.ratio is None else self.ratio, self.joint, self.time)


class PeaksRecord(Record):
    """``LimitPeaks``."""

    velocity: PeakRecord
    acceleration: PeakRecord
    jerk: PeakRecord


class MotionRecord(Record):
    """A ``MotionReport``; the duration with stops is null where there is none."""

    peaks: PeaksRecord
    tool_speed: float
    duration: float
    settle_time: float
    stop_duration: float | None

    @classmethod
    def of(cls, motion: MotionReport) -> MotionRecord:
        peaks = {kind: PeakRecord.of(peak) for kind, peak in vars(motion.peaks).items()}
        return cls(
            peaks=PeaksRecord(**peaks),
            tool_speed=motion.tool_speed,
            duration=motion.duration,
            settle_time=motion.settle_time,
            stop_duration=_finite(motion.stop_duration),
        )

    @cached_property
    def value(self) -> MotionReport:
        peaks = LimitPeaks(self.peaks.velocity.value, self.peaks.acceleration.value, self.peaks.jerk.value)
        stops = math.inf if self.stop_duration is None else self.stop_duration
        return MotionReport(peaks, self.tool_speed, self.duration, stops, self.settle_time)


class FiguresRecord(Record):
    """``Figures``."""

    cost: float
    length: float
    roughness: float
    clearance: float
    shortfall: float


class PolishRecord(Record):
    """A ``PolishReport``."""

    method: Text
    kept: bool
    before: FiguresRecord
    after: FiguresRecord
    iterations: Count
    gradients: Count
    note: Text

    @classmethod
    def of(cls, report: PolishReport) -> PolishRecord:
        figures = {name: FiguresRecord(**vars(getattr(report, name))) for name in ("before", "after")}
        return cls(**{**vars(report), **figures, "note": as_text(report.note)})

    @cached_property
    def value(self) -> PolishReport:
        before, after = (Figures(**figures.model_dump()) for figures in (self.before, self.after))
        return PolishReport(self.method, self.kept, before, after, self.iterations, self.gradients, self.note)


class PathRecord(Record):
    """A ``JointPath``."""

    length: float
    waypoints: Rows
    blends: Numbers

    @classmethod
    def of(cls, path: JointPath) -> PathRecord:
        return cls(length=path.length, waypoints=path.waypoints.tolist(), blends=path.blends.tolist())

    @cached_property
    def value(self) -> JointPath:
        path = JointPath(np.array(self.waypoints, dtype=np.float64), np.array(self.blends, dtype=np.float64))
        apart = len(path.waypoints)
        if apart != len(self.waypoints):
            raise InvalidRequest("waypoints", len(self.waypoints), f"{apart}: no waypoint where the one before it is")
        if not math.isclose(path.length, self.length, rel_tol=ROUNDING, abs_tol=ROUNDING):
            raise InvalidRequest("length", self.length, f"that of the waypoints, {path.length!r}")
        return path


class TrajectoryRecord(Record):
    """A ``Trajectory``, its path apart."""

    duration: float
    dilation: float
    durations: Numbers
    coefficients: Annotated[list[Vector4], FirstOnly()]
    part: Vector2 | None

    @classmethod
    def of(cls, trajectory: Trajectory) -> TrajectoryRecord:
        return cls(
            duration=trajectory.duration,
            dilation=trajectory.dilation,
            durations=trajectory.durations.tolist(),
            coefficients=trajectory.coefficients.tolist(),
            part=_span(trajectory.part),
        )

    def along(self, path: JointPath) -> Trajectory:
        """The trajectory along a path; InvalidRequest if it is none."""
        table = np.array(self.coefficients, dtype=np.float64).reshape(-1, 4)
        durations = np.array(self.durations, dtype=np.float64)
        found = Trajectory(path, durations, table, self.dilation, _pair(self.part))
        if not math.isclose(found.duration, self.duration, rel_tol=ROUNDING, abs_tol=ROUNDING):
            raise InvalidRequest("duration", self.duration, f"the sum of durations, {found.duration!r}")
        return found


class ResultRecord(Record):
    """A ``PlanResult``, without what only the process that made it knows: roadmap, trace and origin."""

    ok: bool
    failure: FailureRecord | None
    goal_index: Count | None
    attempts: Count
    padding: float
    deterministic: bool
    notes: Notes
    counts: CountsRecord
    stages: Annotated[list[StageRecord], at_most(MAX_ENTRIES)]
    certificate: CertificateRecord | None
    motion: MotionRecord | None
    polish: PolishRecord | None
    path: PathRecord | None
    trajectory: TrajectoryRecord | None

    @classmethod
    def of(cls, result: PlanResult) -> ResultRecord:
        return cls(
            ok=result.ok,
            failure=None if result.failure is None else FailureRecord.of(result.failure),
            goal_index=result.goal_index,
            attempts=result.attempts,
            padding=result.padding,
            deterministic=result.deterministic,
            notes=[as_text(note) for note in result.notes],
            counts=CountsRecord.of(result.counts),
            stages=[StageRecord.of(report) for report in result.stages],
            certificate=None if result.certificate is None else CertificateRecord.of(result.certificate),
            motion=None if result.motion is None else MotionRecord.of(result.motion),
            polish=None if result.polish is None else PolishRecord.of(result.polish),
            path=None if result.path is None else PathRecord.of(result.path),
            trajectory=None if result.trajectory is None else TrajectoryRecord.of(result.trajectory),
        )

    @cached_property
    def value(self) -> PlanResult:
        parts = (self.path, self.trajectory, self.certificate, self.motion)
        if (self.failure is None) == any(part is None for part in parts):
            words = "either a failure, or a path, a trajectory, a certificate and a motion"
            raise InvalidRequest("result", self.ok, words, message=f"expected {words}")
        path = None if self.path is None else self.path.value
        result = PlanResult(
            path,
            None if path is None or self.trajectory is None else _named("trajectory", self.trajectory.along, path),
            None if self.failure is None else self.failure.value,
            tuple(report.value for report in self.stages),
            goal_index=self.goal_index,
            attempts=self.attempts,
            padding=self.padding,
            deterministic=self.deterministic,
            certificate=None if self.certificate is None else self.certificate.value,
            motion=None if self.motion is None else self.motion.value,
            notes=tuple(self.notes),
            polish=None if self.polish is None else self.polish.value,
        )
        if result.ok != self.ok:
            raise InvalidRequest("ok", self.ok, "false with a failure, true without")
        if result.counts != self.counts.value:
            raise InvalidRequest("counts", str(self.counts.value), f"the sum of the stages, {result.counts}")
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
