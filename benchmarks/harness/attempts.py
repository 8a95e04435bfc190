"""One problem, one planner, one seed: planned, audited and reported as a row, solved or not."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, singledispatch

import numpy as np

from benchmarks.baselines.lesson import Toy, length_of, stop_and_go_seconds
from benchmarks.harness.audit import JOINT_STEP, NOT_ASKED, Auditor, along, between, inside, stretches, worst
from benchmarks.harness.built import ready
from benchmarks.harness.report import Row
from benchmarks.harness.sources import Motion, Problem, Task, ToyQuery
from benchmarks.harness.suite import LESSON, planner_of
from benchmarks.studies.states import run_lesson
from benchmarks.worlds.queries import Query
from planner_service import PlannerService, PlanRequest, PlanResult, Stage
from planner_service.collision import CheckCounts, CollisionChecker, JointStep, Known
from planner_service.collision.edge_sampling import interior
from planner_service.geometry.arrays import FloatArray
from planner_service.grasping.grasps import top_grasps
from planner_service.planning.request import Goal
from planner_service.planning.result import Failure
from planner_service.planning.task_result import Handling, Segment, TaskResult
from planner_service.scene.scene import Scene
from planner_service.search.problem import Planner, SearchProblem
from planner_service.smoothing.smoothing import shortcut
from planner_service.tasks.pick_place import places_on, standing_on
from planner_service.tasks.primitives import pick, place

__all__ = ["Ask", "Disc", "attempt", "blank_row", "states_of", "warm"]


@dataclass(frozen=True)
class Ask:
    """Who plans: a planner with its settings as text, a seed, and the states it may judge."""

    planner: str
    seed: int
    max_checks: int

    def request(self, start: FloatArray, goal: Goal, planner: Planner) -> PlanRequest:
        """What to ask a service: no clock has a say."""
        return PlanRequest(start, goal, planner, seed=self.seed, max_checks=self.max_checks, time_limit=None)


def attempt(problem: Problem, ask: Ask) -> Row:
    """The row of a plan, without its suite."""
    return blank_row(problem, "planner_service", ask.planner, ask.seed) | _planned(problem, ask)


def states_of(row: Row, stage: str | None = None) -> int:
    """Configurations judged in a stage, in all stages if None."""
    counted = row["checks"].values() if stage is None else [row["checks"].get(stage, {})]
    return sum(counts.get("states", 0) for counts in counted)


def blank_row(problem: Problem, tool: str, planner: str, seed: int) -> Row:
    """What a row tells, but its suite, before anything was planned."""
    row: Row = {"problem": problem.id, "kind": problem.kind, "robot": problem.robot, "tool": tool}
    row |= {"planner": planner, "seed": seed, "ok": False, "failure": None, "detail": "", "checks": {}}
    row |= {"seconds": {}, "total_seconds": 0.0, "cpu_seconds": 0.0, "raw_length": None, "length": None}
    return row | {"duration": None, "clearance": None, "peaks": None, "path_hash": None, "audit": dict(NOT_ASKED)}


@singledispatch
def _planned(problem: Problem, ask: Ask) -> Row:
    raise TypeError(f"no problem: {problem!r}")


@lru_cache(maxsize=2)
def _service(robot: str, scene: Scene) -> PlannerService:
    """A service that has made what it makes once."""
    service = PlannerService(robot, scene)
    service.plan(PlanRequest(service.robot.home, service.robot.home, time_limit=None))
    return service


def warm(problem: Problem, ask: Ask) -> None:
    """Plan once for nobody: what is imported and built once in a process is not charged to the first row."""
    _planned(problem, ask)


class _Clock:
    """Wall and CPU seconds of a block."""

    def __enter__(self) -> _Clock:
        self._wall, self._cpu = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, *_: object) -> None:
        self.told = {
            "total_seconds": time.perf_counter() - self._wall,
            "cpu_seconds": time.process_time() - self._cpu,
        }


# --- one motion


@_planned.register
def _motion(problem: Motion, ask: Ask) -> Row:
    service = _service(problem.robot, problem.scene)
    if ask.planner == LESSON:
        return _lesson(problem, ask, service)
    goal = problem.goals[0] if len(problem.goals) == 1 else problem.goals
    made = ready(service, ask.planner, ask.seed)
    request = ask.request(problem.start, goal, made.planner)
    with _Clock() as clock:
        result = service.plan(request)
    told = {"robot": service.robot.name, **made.told, **clock.told, **_told([result], result.failure)}
    return told | {"audit": _audit(problem.robot, service.scene, result)}


def _told(results: Sequence[PlanResult], failure: Failure | None) -> Row:
    """Costs of plans that follow one another, and their figures if all were made."""
    checks: dict[str, CheckCounts] = {}
    seconds: dict[str, float] = {}
    for report in (report for result in results for report in result.stages):
        name = report.stage.value
        checks[name] = checks.get(name, CheckCounts()) + report.counts
        seconds[name] = seconds.get(name, 0.0) + report.seconds
    told: Row = {
        "ok": failure is None,
        "failure": None if failure is None else failure.reason.value,
        "detail": "" if failure is None else failure.detail,
        "checks": {name: counts.named for name, counts in checks.items()},
        "seconds": seconds,
    }
    return told if failure is not None else told | _figures(results)


def _figures(results: Sequence[PlanResult]) -> Row:
    """Lengths, clearance, duration and peaks of plans that follow one another."""
    paths = [result.unwrap()[0] for result in results]
    searched = [result.stage(Stage.SEARCH).length for result in results]
    raw = [path.length if found is None else found for path, found in zip(paths, searched, strict=True)]
    proofs = [result.certificate.clearance for result in results if result.certificate is not None]
    motions = [result.motion for result in results if result.motion is not None]
    bits = hashlib.sha256()
    for path in paths:
        bits.update(path.waypoints.tobytes() + path.blends.tobytes())
    kinds = ("velocity", "acceleration", "jerk")
    return {
        "raw_length": math.fsum(raw),
        "length": math.fsum(path.length for path in paths),
        "duration": math.fsum(motion.duration for motion in motions),
        "clearance": _finite(min(proofs, default=math.inf)),
        "peaks": {kind: _finite(max(getattr(motion.peaks, kind).ratio for motion in motions)) for kind in kinds},
        "path_hash": bits.hexdigest(),
    }


def _finite(value: float) -> float | None:
    """The value, None where a file could not hold it: the jerk of a trapezoid is infinite."""
    return float(value) if math.isfinite(value) else None


def _audit(robot: str, scene: Scene, result: PlanResult, width: float | None = None) -> Row:
    """Coal's word on the curve of a plan; on a stretch where contact is meant, the named pairs may touch."""
    path = result.path
    if path is None:
        return dict(NOT_ASKED)
    exempt = ((each.s_start, each.s_end, each.pairs) for each in result.exempt)
    told = []
    for start, end, pairs in stretches(exempt, path.length):
        Q = along(path, *inside(start, end, path.length))
        told.append(_auditor(robot, scene, width, pairs).judge(Q))
    return worst(told)


@lru_cache(maxsize=32)
def _auditor(robot: str, scene: Scene, width: float | None, allowed: tuple[tuple[str, str], ...]) -> Auditor:
    return Auditor(robot, scene, gripper_width=width, allowed=allowed)


def _lesson(problem: Motion, ask: Ask, service: PlannerService) -> Row:
    """The textbook's program on the same problem, its states counted by the same checker."""
    query = Query(problem.kind, ask.seed, problem.start, problem.goals[0], straight=False)
    checker = CollisionChecker(service.robot, service.scene)
    with _Clock() as clock:
        run = run_lesson(checker, query)
    told: Row = {
        "robot": service.robot.name,
        "tool": LESSON,
        **clock.told,
        "ok": run.path is not None,
        "checks": {"search": _states(run.growth), "shortcut": _states(run.shortcut)},
    }
    if run.path is None:
        return told | {"failure": "PLANNING_FAILED", "detail": "no path in 2000 rounds"}
    told |= {"length": length_of(run.path), "path_hash": hashlib.sha256(run.path.tobytes()).hexdigest()}
    return told | {"audit": _auditor(problem.robot, service.scene, None, ()).judge(between(run.path))}


def _states(states: int, edges: int = 0) -> Row:
    return {"states": states, "edges": edges, "distances": 0}


# --- a pick and a place


@_planned.register
def _task(problem: Task, ask: Ask) -> Row:
    service = _service(problem.robot, problem.scene)
    home, made = service.robot.home, ready(service, ask.planner, ask.seed)
    with _Clock() as clock:
        parts = list(_parts(problem, service, ask.request(home, home, made.planner)))
    failure = next((part.failure for part in parts if part.failure is not None), None)
    told: Row = {"robot": service.robot.name, **made.told, **clock.told}
    told |= _told([segment.result for part in parts for segment in part.segments], failure)
    told["checks"]["choosing"] = sum((part.choosing for part in parts), CheckCounts()).named
    proofs = [segment.gripper.certificate for part in parts for segment in part.segments if segment.gripper is not None]
    told["checks"]["gripper"] = CheckCounts(distances=sum(proof.distances for proof in proofs)).named
    audits = [_audit(problem.robot, scene, *judged) for scene, judged in _judged(service, parts)]
    return told | {"audit": worst(audits) if failure is None else dict(NOT_ASKED)}


def _parts(problem: Task, service: PlannerService, request: PlanRequest) -> Iterator[TaskResult]:
    """The pick, the place and the way home, as far as there are plans."""
    scene = service.scene
    target, support = scene.obstacle(problem.target), scene.obstacle(problem.onto)
    handling = Handling(support=standing_on(scene, problem.target), request=request)
    picked = pick(service, request.start, problem.target, top_grasps(service.robot, target), handling)
    yield picked
    if not picked.ok:
        return
    setting_down = Handling(support=problem.onto, request=request)
    placed = place(PlannerService.of(picked.world), picked.q, problem.target, places_on(target, support), setting_down)
    yield placed
    if placed.ok:
        result = PlannerService.of(placed.world).plan(replace(request, start=placed.q, goal=request.start))
        segment = Segment("home", result, placed.world.robot.gripper_width)
        yield TaskResult((segment,), placed.world, placed.q, result.failure)


def _judged(service: PlannerService, parts: Iterable[TaskResult]) -> Iterator[tuple[Scene, tuple[PlanResult, float]]]:
    """Each motion with the world and the gripper in which it was planned: the last of a pick or a place is after it."""
    scene = service.scene
    for part in parts:
        for segment in part.segments:
            last = segment is part.segments[-1]
            yield (part.world.scene if last else scene), (segment.result, segment.width)
        scene = part.world.scene


# --- the lesson's disc


class Disc:
    """The toy's disc as a planner's oracle, asked at the lesson's resolution and counted state by state."""

    def __init__(self) -> None:
        self.toy, self.edges, self._step = Toy(), 0, JointStep(0.02)

    @property
    def states(self) -> int:
        """Configurations judged so far."""
        return self.toy.checks

    def state_is_free(self, q: FloatArray) -> bool:
        """Whether q (2,) is outside the disc."""
        return not self.toy.collides(q.tolist())

    def edge_is_free(self, q1: FloatArray, q2: FloatArray, *, known: Known = Known.NEITHER) -> bool:
        """Whether an edge is, in the order in which ``CollisionChecker`` judges one."""
        self.edges += 1
        a, b = q1.tolist(), q2.tolist()
        inner = interior(a, b, self._step.segments((q2 - q1).tolist(), [1.0, 1.0]))
        ends = [q for q, end in ((q1, Known.START), (q2, Known.END)) if end not in known]
        return all(self.state_is_free(np.asarray(q)) for q in [*ends, *inner])


@_planned.register
def _toy(problem: ToyQuery, ask: Ask) -> Row:
    with _Clock() as clock:
        raw, short, checks = (_lesson_toy if ask.planner == LESSON else _planned_toy)(ask)
    told: Row = {"tool": LESSON if ask.planner == LESSON else "planner_service", **clock.told, "checks": checks}
    if raw is None or short is None:
        return told | {"failure": "PLANNING_FAILED", "detail": "no path"}
    Q, (x, y) = between(short), Toy.CENTRE
    depth = max(Toy.RADIUS - math.hypot(q[0] - x, q[1] - y) for q in Q.tolist())
    hit = {"verdict": "colliding", "depth": depth, "pair": ["a point", "disc"]} if depth > 0.0 else {"verdict": "free"}
    return told | {
        "ok": True,
        "raw_length": length_of(raw),
        "length": length_of(short),
        "duration": stop_and_go_seconds(short),
        "path_hash": hashlib.sha256(np.array(short).tobytes()).hexdigest(),
        "audit": {**NOT_ASKED, "step": JOINT_STEP, **hit},
    }


_Found = tuple[list[FloatArray] | None, list[FloatArray] | None, Row]


def _lesson_toy(ask: Ask) -> _Found:
    run = Toy.run(ask.seed)
    return run.raw, run.short, {"search": _states(run.growth), "shortcut": _states(run.shortcut)}


def _planned_toy(ask: Ask) -> _Found:
    """A planner of the service and its shortcuts on the disc: there is no robot, so neither blends nor proof."""
    disc, box = Disc(), np.full(2, math.pi)
    problem = SearchProblem(Toy.START, Toy.GOAL[None], -box, box, disc, seed=ask.seed)
    found = planner_of(ask.planner).search(problem).waypoints
    searched = _states(disc.states, disc.edges)
    if found is None:
        return None, None, {"search": searched}
    short = shortcut(found, disc, np.random.default_rng([ask.seed, 1]))
    spent = _states(disc.states - searched["states"], disc.edges - searched["edges"])
    return list(found), list(short), {"search": searched, "shortcut": spent}
