"""One problem, one planner, one seed: planned, audited and reported as a row, solved or not."""

from __future__ import annotations

import hashlib
import math
import time
from dataclasses import dataclass
from functools import lru_cache

import planner_service as ps
from benchmarks.harness.audit import NOT_ASKED, Auditor, along, inside, stretches, worst
from benchmarks.harness.report import Row
from benchmarks.harness.suite import Motion
from planner_service.planners import Planner

__all__ = ["Ask", "attempt", "blank_row", "states_of"]

KINDS = ("velocity", "acceleration", "jerk")


@dataclass(frozen=True)
class Ask:
    """Who plans, by which name in rows, with which seed, and the states it may judge."""

    name: str
    planner: Planner
    seed: int
    max_checks: int

    def request(self, problem: Motion) -> ps.PlanRequest:
        """What to ask a service: no clock has a say."""
        goal, most = problem.goals[0] if len(problem.goals) == 1 else problem.goals, self.max_checks
        return ps.PlanRequest(problem.start, goal, self.planner, seed=self.seed, max_checks=most, time_limit=None)


def attempt(problem: Motion, ask: Ask) -> Row:
    """The row of a plan, without its suite."""
    return blank_row(problem, "planner_service", ask.name, ask.seed) | _planned(problem, ask)


def states_of(row: Row) -> int:
    """Configurations judged in all stages."""
    return sum(counts["states"] for counts in row["checks"].values())


def blank_row(problem: Motion, tool: str, planner: str, seed: int) -> Row:
    """What a row tells, but its suite, before anything was planned."""
    row: Row = {"problem": problem.id, "kind": problem.kind, "robot": problem.robot, "tool": tool}
    row |= {"planner": planner, "seed": seed, "ok": False, "failure": None, "detail": "", "checks": {}}
    row |= {"seconds": {}, "total_seconds": 0.0, "cpu_seconds": 0.0, "raw_length": None, "length": None}
    return row | {"duration": None, "clearance": None, "peaks": None, "path_hash": None, "audit": dict(NOT_ASKED)}


@lru_cache(maxsize=2)
def _service(robot: str, scene: ps.Scene) -> ps.PlannerService:
    """A service that has made what it makes once."""
    service = ps.PlannerService(robot, scene)
    service.plan(ps.PlanRequest(service.robot.home, service.robot.home, time_limit=None))
    return service


def _planned(problem: Motion, ask: Ask) -> Row:
    service = _service(problem.robot, problem.scene)
    request = ask.request(problem)
    wall, cpu = time.perf_counter(), time.process_time()
    result = service.plan(request)
    spent = {"total_seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - cpu}
    told = {"robot": service.robot.name, **spent, **_told(result)}
    return told | {"audit": _audit(problem.robot, service.scene, result)}


def _told(result: ps.PlanResult) -> Row:
    """Costs of a plan, and its figures if it was made."""
    failure = result.failure
    told: Row = {
        "ok": failure is None,
        "failure": None if failure is None else failure.reason.value,
        "detail": "" if failure is None else failure.detail,
        "checks": {report.stage.value: report.counts.named for report in result.stages},
        "seconds": {report.stage.value: report.seconds for report in result.stages},
    }
    return told if failure is not None else told | _figures(result)


def _figures(result: ps.PlanResult) -> Row:
    """Length, clearance, duration and peaks of a plan."""
    path, _ = result.unwrap()
    searched, proof, motion = result.stage(ps.Stage.SEARCH).length, result.certificate, result.motion
    peaks = {kind: getattr(motion.peaks, kind).ratio for kind in KINDS} if motion is not None else {}
    return {
        "raw_length": path.length if searched is None else searched,
        "length": path.length,
        "duration": 0.0 if motion is None else motion.duration,
        "clearance": _finite(math.inf if proof is None else proof.clearance),
        "peaks": {kind: _finite(ratio) for kind, ratio in peaks.items()},
        "path_hash": hashlib.sha256(path.waypoints.tobytes() + path.blends.tobytes()).hexdigest(),
    }


def _finite(value: float) -> float | None:
    """The value, None where a file could not hold it: the jerk of a trapezoid is infinite."""
    return float(value) if math.isfinite(value) else None


def _audit(robot: str, scene: ps.Scene, result: ps.PlanResult) -> Row:
    """Coal's word on the curve of a plan; on a stretch where contact is meant, the named pairs may touch."""
    path = result.path
    if path is None:
        return dict(NOT_ASKED)
    exempt = ((each.s_start, each.s_end, each.pairs) for each in result.exempt)
    told = []
    for start, end, pairs in stretches(exempt, path.length):
        Q = along(path, *inside(start, end, path.length))
        told.append(_auditor(robot, scene, pairs).judge(Q))
    return worst(told)


@lru_cache(maxsize=32)
def _auditor(robot: str, scene: ps.Scene, allowed: tuple[tuple[str, str], ...]) -> Auditor:
    return Auditor(robot, scene, allowed=allowed)
