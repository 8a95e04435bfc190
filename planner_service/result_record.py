"""Results as JSON objects, and back: for every ``x_record`` there is a ``read_x``, and no bit is lost between them.

Reading notes problems at the place where they are; what comes back is then a stand-in.
"""

from __future__ import annotations

import enum
import math
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from planner_service.certify import Certificate, ExemptInterval, GripperMotion, Refusal
from planner_service.collision import CheckCounts, Contact
from planner_service.geometry import read_only
from planner_service.json_file import Node
from planner_service.optimize import Figures
from planner_service.outcome import Failure, MotionReport, PlanResult, PolishReport, Reason, Stage, StageReport
from planner_service.path import JointPath
from planner_service.peaks import LimitPeaks, Peak
from planner_service.trajectory import Trajectory

__all__ = [
    "certificate_record",
    "counts_record",
    "failure_record",
    "gripper_record",
    "read_counts",
    "read_failure",
    "read_gripper",
    "read_result",
    "read_texts",
    "result_record",
]

Member = TypeVar("Member", bound=enum.Enum)


def counts_record(counts: CheckCounts) -> dict[str, int]:
    """What was asked of the checker."""
    return {"states": counts.states, "edges": counts.edges, "distances": counts.distances}


def read_counts(node: Node) -> CheckCounts:
    """See ``counts_record``."""
    return CheckCounts(node.at("states").whole(), node.at("edges").whole(), node.at("distances").whole())


def read_texts(node: Node) -> tuple[str, ...]:
    """A list of texts."""
    return tuple(item.text() for item in node.items())


def result_record(result: PlanResult) -> dict[str, Any]:
    """A plan or its failure, with what it cost."""
    path, trajectory = result.path, result.trajectory
    return {
        "ok": result.ok,
        "failure": failure_record(result.failure),
        "goal_index": result.goal_index,
        "attempts": result.attempts,
        "padding": result.padding,
        "deterministic": result.deterministic,
        "notes": list(result.notes),
        "counts": counts_record(result.counts),
        "stages": [_stage(report) for report in result.stages],
        "certificate": None if result.certificate is None else certificate_record(result.certificate),
        "motion": None if result.motion is None else _motion(result.motion),
        "polish": None if result.polish is None else _polish(result.polish),
        "path": None
        if path is None
        else {"length": path.length, "waypoints": path.waypoints.tolist(), "blends": path.blends.tolist()},
        "trajectory": None
        if trajectory is None
        else {
            "duration": trajectory.duration,
            "dilation": trajectory.dilation,
            "durations": trajectory.durations.tolist(),
            "coefficients": trajectory.coefficients.tolist(),
            **_part(trajectory.part),
        },
    }


def read_result(node: Node, n: int) -> PlanResult:
    """See ``result_record``; n is the number of joints."""
    failure = node.at("failure").optional(lambda at: read_failure(at, n))
    path = node.at("path").optional(lambda at: _read_path(at, n))
    trajectory = node.at("trajectory").optional(lambda at: None if path is None else _read_trajectory(at, path))
    certificate = node.at("certificate").optional(_read_certificate)
    motion = node.at("motion").optional(_read_motion)
    if node.sound and (failure is None) == any(part is None for part in (path, trajectory, certificate, motion)):
        node.problem("expected either a failure, or a path, a trajectory, a certificate and a motion")
    if failure is None and trajectory is not None and certificate is not None and not _covers(certificate, trajectory):
        node.at("certificate").problem("expected a proof of all that the trajectory runs along")
    return PlanResult(
        path,
        trajectory,
        failure,
        tuple(_read_stage(item) for item in node.at("stages").items()),
        goal_index=node.at("goal_index").optional(Node.whole),
        attempts=node.at("attempts").whole(),
        padding=node.at("padding").number(),
        deterministic=node.at("deterministic").flag(),
        certificate=certificate,
        motion=motion,
        notes=read_texts(node.at("notes")),
        polish=node.at("polish").optional(_read_polish) if node.has("polish") else None,  # files of before have none
    )


def _polish(report: PolishReport) -> dict[str, Any]:
    return {**vars(report), "before": dict(vars(report.before)), "after": dict(vars(report.after))}


def _read_polish(node: Node) -> PolishReport:
    return PolishReport(
        node.at("method").text(),
        node.at("kept").flag(),
        _read_figures(node.at("before")),
        _read_figures(node.at("after")),
        node.at("iterations").whole(),
        node.at("gradients").whole(),
        node.at("note").text(),
    )


def _read_figures(node: Node) -> Figures:
    return Figures(*(node.at(item.name).number() for item in fields(Figures)))


def _read_path(node: Node, n: int) -> JointPath | None:
    waypoints = np.array(node.at("waypoints").rows(n), dtype=np.float64)
    blends = np.array([item.number() for item in node.at("blends").items()], dtype=np.float64)
    path = node.attempt(lambda: JointPath(waypoints, blends))
    if path is not None and len(path.waypoints) != len(waypoints):
        node.problem(f"{len(waypoints) - len(path.waypoints)} waypoints are where the one before them is")
    return path if node.sound else None


def _read_trajectory(node: Node, path: JointPath) -> Trajectory | None:
    durations = [item.number() for item in node.at("durations").items()]
    coefficients = node.at("coefficients").rows(4)
    dilation = node.at("dilation").number()
    table, part = np.array(coefficients, dtype=np.float64).reshape(-1, 4), _read_part(node)
    return node.attempt(lambda: Trajectory(path, np.array(durations, dtype=np.float64), table, dilation, part))


def _part(part: tuple[float, float] | None) -> dict[str, Any]:
    """The part of a path that is meant, said only if it is not the whole."""
    return {} if part is None else {"part": list(part)}


def _read_part(node: Node) -> tuple[float, float] | None:
    if not node.has("part"):
        return None
    begin, end = node.at("part").numbers(2)
    return begin, end


def _stage(report: StageReport) -> dict[str, Any]:
    told = {"seconds": report.seconds, "length": report.length, "note": report.note}
    return {"stage": report.stage.value, **counts_record(report.counts), **told}


def _read_stage(node: Node) -> StageReport:
    return StageReport(
        _member(node.at("stage"), Stage),
        read_counts(node),
        node.at("seconds").number(),
        node.at("length").optional(Node.number),
        node.at("note").text(),
    )


def _member(node: Node, kind: type[Member]) -> Member:
    found = next((member for member in kind if member.value == node.value), None)
    if found is None:
        node.wrong(f"one of {', '.join(member.value for member in kind)}")
    return found or next(iter(kind))


def _exempt(interval: ExemptInterval) -> dict[str, Any]:
    pairs = [list(pair) for pair in interval.pairs]
    return {"s_start": interval.s_start, "s_end": interval.s_end, "pairs": pairs, "reason": interval.reason}


def _read_exempt(node: Node) -> ExemptInterval:
    pairs = []
    for item in node.at("pairs").items():
        names = read_texts(item)
        if len(names) != 2:
            item.wrong("two names")
            continue
        pairs.append((names[0], names[1]))
    ends = node.at("s_start").number(), node.at("s_end").number()
    reason = node.at("reason").text()
    interval = node.attempt(lambda: ExemptInterval(*ends, tuple(pairs), reason)) if node.sound else None
    return interval or ExemptInterval(0.0, 0.0, (), reason)


def certificate_record(certificate: Certificate) -> dict[str, Any]:
    """What was proven of a curve; its clearance is null where nothing can touch or nothing was proven."""
    refusal = certificate.refusal
    return {
        "certified": certificate.certified,
        "clearance": _finite(certificate.clearance),
        "distances": certificate.distances,
        "padding": certificate.padding,
        "exempt": [_exempt(interval) for interval in certificate.exempt],
        "refusal": None if refusal is None else dict(vars(refusal)),
        **_part(certificate.part),
    }


def _read_certificate(node: Node) -> Certificate:
    refusal = node.at("refusal").optional(
        lambda at: Refusal(
            at.at("s_start").number(),
            at.at("s_end").number(),
            at.at("s").number(),
            at.at("a").text(),
            at.at("b").text(),
            at.at("detail").text(),
            at.at("spent").flag(),
        )
    )
    clearance = node.at("clearance").optional(Node.number)
    if node.at("certified").flag() != (refusal is None):
        node.problem("certified: expected true without a refusal, false with one")
    return Certificate(
        (math.inf if refusal is None else -math.inf) if clearance is None else clearance,
        node.at("distances").whole(),
        node.at("padding").number(),
        tuple(_read_exempt(item) for item in node.at("exempt").items()),
        refusal,
        _read_part(node),
    )


def gripper_record(motion: GripperMotion | None) -> dict[str, Any] | None:
    """An opening or closing of the gripper with its proof; None for None."""
    if motion is None:
        return None
    widths = {"start_width": motion.start, "end_width": motion.end}
    return {**widths, "seconds": motion.seconds, "certificate": certificate_record(motion.certificate)}


def read_gripper(node: Node) -> GripperMotion:
    """See ``gripper_record``."""
    widths = node.at("start_width").number(), node.at("end_width").number()
    return GripperMotion(*widths, _read_certificate(node.at("certificate")), node.at("seconds").number())


def _covers(certificate: Certificate, trajectory: Trajectory) -> bool:
    """Whether a motion runs along what is proven."""
    begin, end = (-math.inf, math.inf) if certificate.part is None else certificate.part
    return begin <= trajectory.begin and trajectory.end <= end


def _finite(value: float) -> float | None:
    """JSON has no infinity."""
    return value if math.isfinite(value) else None


def _motion(motion: MotionReport) -> dict[str, Any]:
    peaks = {
        kind: {"ratio": _finite(peak.ratio), "joint": peak.joint, "time": peak.time}
        for kind, peak in vars(motion.peaks).items()
    }
    told = ("tool_speed", "duration", "settle_time")
    stops = {"stop_duration": _finite(motion.stop_duration)}
    return {"peaks": peaks, **{name: getattr(motion, name) for name in told}, **stops}


def _read_motion(node: Node) -> MotionReport:
    peaks = node.at("peaks")
    return MotionReport(
        LimitPeaks(*(_read_peak(peaks.at(kind)) for kind in ("velocity", "acceleration", "jerk"))),
        node.at("tool_speed").number(),
        node.at("duration").number(),
        math.inf if (stops := node.at("stop_duration").optional(Node.number)) is None else stops,
        node.at("settle_time").number(),
    )


def _read_peak(node: Node) -> Peak:
    ratio = node.at("ratio").optional(Node.number)
    return Peak(math.inf if ratio is None else ratio, node.at("joint").whole(), node.at("time").number())


def failure_record(failure: Failure | None) -> dict[str, Any] | None:
    """Why there is no plan; None for None."""
    if failure is None:
        return None
    return {
        "stage": failure.stage.value,
        "reason": failure.reason.value,
        "detail": failure.detail,
        "contacts": [{"a": c.a, "b": c.b, "depth_at_most": c.depth} for c in failure.contacts],
        "nearest_free": None if failure.nearest_free is None else failure.nearest_free.tolist(),
        "blocked_by": [{"a": a, "b": b, "share": share} for a, b, share in failure.blocked_by],
    }


def read_failure(node: Node, n: int) -> Failure:
    """See ``failure_record``; n is the number of joints."""
    return Failure(
        _member(node.at("stage"), Stage),
        _member(node.at("reason"), Reason),
        node.at("detail").text(),
        tuple(
            Contact(item.at("a").text(), item.at("b").text(), item.at("depth_at_most").number())
            for item in node.at("contacts").items()
        ),
        node.at("nearest_free").optional(lambda at: read_only(at.numbers(n))),
        tuple(
            (item.at("a").text(), item.at("b").text(), item.at("share").number())
            for item in node.at("blocked_by").items()
        ),
    )
