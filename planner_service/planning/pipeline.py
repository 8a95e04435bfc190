"""One plan, stage by stage: what ``PlannerService.plan`` runs."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from planner_service.certify import Certificate, Certifier, ExemptInterval
from planner_service.collision import CancelToken, CollisionChecker, Known
from planner_service.collision.budget import CheckBudgetSpent, TimeBoxSpent
from planner_service.concurrency.polling import Prepared, waited
from planner_service.constraints.values import Constraint
from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.kinematics.constraint_set import constraint_set
from planner_service.memory.memory import NOTHING, Hint, Memory, checked_memory, hints
from planner_service.optimize import Optimise, Optimum
from planner_service.path.joint_path import JointPath, polyline_length
from planner_service.path.trajectory import Trajectory
from planner_service.planning import search_stage
from planner_service.planning.accounting import (
    NoPlan,
    PlanAccounting,
    PlanContext,
    certified_path,
    certify,
    require_proven,
    timed,
    unproven,
)
from planner_service.planning.endpoints import Ends, find_ends, padded_ends, require_ends
from planner_service.planning.hull_contacts import only_for_hulls
from planner_service.planning.kept_padding import line_keeps_padding, padding_kept
from planner_service.planning.polishing import Touch, judged, lines, not_free, optimum_path
from planner_service.planning.request import Goals, PlanRequest, kept_in, torques_of
from planner_service.planning.result import KeptPadding, MotionReport, Origin, PlanResult, Reason, Stage
from planner_service.planning.roadmap_work import GROWERS, require_robot
from planner_service.planning.search_stage import Candidates, NoProgress, SearchRound, Tries
from planner_service.roadmap import Roadmap
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.search.problem import ConstrainedOracle
from planner_service.search.trace import Tracer
from planner_service.smoothing.smoothing import blended, widest_blends
from planner_service.timing.torque_limits import TorqueLimits

__all__ = ["plan", "require_plannable"]

PAUSES = (search_stage.FIRST_TRIES, 4, 6, 10)
"""Tries before which a search pauses for other things: after 40,000 states, 120,000, 280,000 and 1.2 million."""

STATES_A_BOX = 5
"""States that a search may check in the time of one box of the proof that there is no path, about."""

NARROWER, FIRST_NARROW = ((0.5, 0.001), (0.1, 0.0005)), 8
"""Parts of the padding that are searched with when nothing is found with all of it, and how closely edges are sampled,
in metres; the first of their rounds, numbered as no other, so that they draw other samples."""

POLISH_SHARE = 0.7
"""The share of the remaining time that optimising may take; the rest is kept for the unoptimised path."""


class Plannable(NamedTuple):
    """A request as it fits a robot in a scene: its goals, and the constraints and the torque limits of its motion."""

    goals: Goals
    constraints: tuple[Constraint, ...]
    torque_limits: TorqueLimits | None


def require_plannable(request: PlanRequest, robot: Robot, scene: Scene) -> Plannable:
    """Refuse a request that does not fit a robot in a scene.

    Raises:
        InvalidRequest: Its start, a goal or its roadmap is of another robot, or its planner does not keep the
            constraints.
        UnknownName: A constraint names no link or joint of the robot.
    """
    goals = require_ends(request, robot)
    if isinstance(request.planner, Roadmap):
        require_robot(request.planner, robot)
    limits, constraints = torques_of(request.pace, robot, scene), kept_in(scene, request.constraints)
    if constraints:
        request.require_keeping(constraints)
        constraint_set(robot, constraints)
    return Plannable(goals, constraints, limits)


def plan(
    request: PlanRequest,
    checker: CollisionChecker,
    certifier: Prepared[Certifier],
    *,
    memory: Memory | None = None,
    cancel: CancelToken | None = None,
    tracer: Tracer | None = None,
    origin: Origin | None = None,
) -> PlanResult:
    """Plan a request, if it can be along a motion that is remembered.

    Raises:
        InvalidRequest: As ``require_plannable``, or the memory is of another robot.
        UnknownName: The same.
    """
    goals, constraints, torque_limits = require_plannable(request, checker.robot, checker.scene)
    accounting = PlanAccounting(
        checker,
        states=request.max_checks,
        search_states=request.search_states,
        seconds=request.time_limit,
        cancel=cancel,
        roadmap=request.planner if isinstance(request.planner, Roadmap) else None,
        tracer=tracer,
        origin=origin,
        memory=NOTHING if memory is None else checked_memory(memory, checker.robot),
    )
    if constraints:
        accounting.keep(constraints)
    accounting.torque_limits = torque_limits
    context = PlanContext(request, goals, checker, certifier, accounting)
    return accounting.outcome(lambda: _stages(context))


def _stages(context: PlanContext) -> PlanResult:
    """The stages in their order; one that finds no way raises ``NoPlan``."""
    roadmap = context.accounting.roadmap
    if roadmap is not None and not roadmap.prepared:
        waited(roadmap.prepare)
    ends = find_ends(context)
    if ends.arrived_at is not None:
        return _stay(context, ends, ends.arrived_at)
    known = _known(context, ends)
    proof = _remembered(context, ends, [hint for hint in known if not len(hint.inner)][:1])
    if proof is not None:
        return _finish(context, ends, proof)
    candidates, narrow = _straight_line(context, ends)
    if candidates is None and narrow is None:
        proof = _remembered(context, ends, [hint for hint in known if len(hint.inner)])
        if proof is not None:
            return _finish(context, ends, proof)
    if candidates is None and isinstance(context.request.planner, Optimise):
        if narrow is None:
            return _finish(context, ends, _optimised_line(context, ends))
        candidates = narrow
    if candidates is None and narrow is not None:
        candidates = search_stage.roomier(context, ends, narrow)
    proof = _found(context, ends) if candidates is None else _prove(context, ends, candidates)
    return _finish(context, ends, _proven_again(context, ends, proof) if proof.refused else proof)


def _proven_again(context: PlanContext, ends: Ends, proof: _Proof) -> _Proof:
    """The first path of further searches that is proven, or the refusal of the last."""
    for number, padding in enumerate(search_stage.retry_paddings(context.request), start=1):
        if proof.refused:
            searching = SearchRound(number, padding, padding)
            candidates = search_stage.search_again(context, ends, searching, proof.certificate)
            proof = proof if candidates is None else _prove(context, ends, candidates)
    return proof


@dataclass(frozen=True, eq=False)
class _Proof:
    """A path with its certificate, or with the refusal of one.

    Attributes:
        candidates: What it was made of; None for the optimum of a line.
        turn: Which of them.
        padding: Metres that the search, or the optimum, kept from everything.
        motion: The path in time, and how it moves; None before the TIMING stage.
    """

    path: JointPath
    certificate: Certificate
    goal_index: int
    padding: float
    candidates: Candidates | None = None
    turn: int = 0
    motion: tuple[Trajectory, MotionReport] | None = None

    @property
    def refused(self) -> bool:
        """Whether it could not be proven."""
        return self.certificate.refusal is not None


@dataclass(frozen=True, eq=False)
class _Route:
    """A polyline from start to goal; corners at ``kept`` waypoints, where fixed ways out end, stay as they are."""

    path: JointPath
    goal_index: int
    kept: tuple[int, ...]
    exempt: tuple[ExemptInterval, ...]


def _stay(context: PlanContext, ends: Ends, goal_index: int) -> PlanResult:
    """The plan of a robot that is at its goal already."""
    accounting = context.accounting
    accounting.padding = ends.padding
    accounting.notes.append("start and goal are the same configuration: nothing to do")
    path = JointPath(np.array([ends.begin]))
    exempt = [] if ends.departure is None else [replace(each, s_end=0.0) for each in ends.departure.exempt]
    certificate = require_proven(certify(path, context.certifier.get(), accounting, exempt))
    if ends.departure is None and ends.padding < context.request.padding:
        accounting.take(_padding_kept(context, path, certificate))
    return accounting.result(path, *_timed(context, path), goal_index=goal_index, certificate=certificate)


def _straight_line(context: PlanContext, ends: Ends) -> tuple[Candidates | None, Candidates | None]:
    """The line from the start to the nearest goal to which it is free, and keeps the padding except near an end that is
    closer; then the first that is free, but keeps less in between. None if none is."""
    accounting, padding = context.accounting, context.request.padding
    accounting.padding = ends.padding
    oracle = search_stage.oracle_of(
        context, context.checker.variant(padding=ends.padding), ends.start, [goal.q for goal in ends.goals]
    )
    searching, narrow = SearchRound(0, padding), None
    with accounting.during(Stage.STRAIGHT_LINE) as entry:
        for goal in ends.goals:
            if goal.q.tolist() == ends.start.tolist():  # two ends of one retreat
                return Candidates((np.array([ends.start]),), searching, ends.padding, (), oracle), None
            if isinstance(oracle, ConstrainedOracle) and not oracle.keeps(ends.start, goal.q):
                entry.note = entry.note or "leaves the constraints"
                continue
            hit = oracle.edge_hit(ends.start, goal.q, known=Known.BOTH)
            if hit is not None:
                entry.note = entry.note or f"blocked at {hit.fraction:.0%}: {hit.a} x {hit.b}"
                continue
            points = np.array([ends.start, goal.q])
            line = Candidates((points,), searching, ends.padding, (), oracle)
            if ends.padding == padding or line_keeps_padding(JointPath(points), context.checker, padding):
                entry.note, entry.length = "free", joint_distance(ends.start.tolist(), goal.q.tolist())
                return line, None
            entry.note = entry.note or "free, but nearer to something than the padding"
            narrow = narrow or line
    return None, narrow


# Motions that are remembered: a proof with all of the padding takes the place of a search and of its samples.


def _known(context: PlanContext, ends: Ends) -> list[Hint]:
    """Motions from near the start to near a goal, for a request that would not improve them."""
    request, memory = context.request, context.accounting.memory
    if memory is NOTHING or request.optimise is not None or request.improve or ends.padding < request.padding:
        return []
    return hints(memory, ends.start, [goal.q for goal in ends.goals])


def _remembered(context: PlanContext, ends: Ends, known: list[Hint]) -> _Proof | None:
    """The first of the hints, brought to these ends, that is proven; None if none is."""
    accounting, request, limits = context.accounting, context.request, context.checker.robot.limits
    for hint in known:
        accounting.padding = request.padding
        points = np.array([ends.start, *hint.inner, ends.goals[hint.goal].q])
        if not np.all((limits.lower <= points) & (points <= limits.upper)):
            continue
        route, notes = _route(context, ends, points), len(accounting.notes)
        sizes = np.full(len(route.path.waypoints), request.blend)
        sizes[list(route.kept)] = 0.0
        path = widest_blends(route.path, sizes)
        path, proof = certified_path(path, context.certifier.get(), accounting, route.exempt, padding=request.padding)
        if proof.refusal is None:
            accounting.notes.append("along a motion that was remembered")
            return _Proof(path, proof, route.goal_index, request.padding)
        del accounting.notes[notes:]
    return None


# Where a search finds nothing: first a proof that there is no path, then less padding, then more of the same.


def _found(context: PlanContext, ends: Ends) -> _Proof:
    """A path that is searched, and proven or not; other things are tried in each pause of the search, and at its end.

    Raises:
        NoPlan: There is none, or the search was in vain.
    """
    tally, tries = context.accounting.tally, Tries()
    for pause in (*PAUSES, None):
        tries, before = replace(tries, pause=pause), tally.states
        try:
            return _prove(context, ends, search_stage.search(context, ends, tries=tries))
        except NoProgress:
            states = tally.states - before
            narrow = _otherwise(context, ends, tries, states)
            if narrow is not None:
                return narrow
            tries = Tries(pause or 0, None, tries.states + states)
        except (CheckBudgetSpent, NoPlan) as over:
            if isinstance(over, NoPlan) and over.failure.reason is not Reason.PLANNING_FAILED:
                raise
            narrow = _otherwise(context, ends, tries, tally.states - before)
            if narrow is not None:
                return narrow
            raise
    raise BrokenInvariant("a search without an end")


def _otherwise(context: PlanContext, ends: Ends, tries: Tries, states: int) -> _Proof | None:
    """A proven path with less padding, if it is not proven that there is none at all; in half of the time left.

    Args:
        tries: Those that were made last.
        states: That these have checked.

    Raises:
        NoPlan: It is proven that no path exists.
    """
    accounting, ledger = context.accounting, context.checker.ledger
    if isinstance(context.request.planner, GROWERS):  # its roadmap has a budget of its own, and would be grown anew
        return None
    left = ledger.time_left()
    deadline = None if left is None else time.monotonic() + left / 2.0
    accounting.tried_in_vain, found = "", None
    padding_before, trouble = accounting.padding, accounting.end_trouble
    try:
        with context.checker.limited(deadline=deadline):
            _refute(context, ends, (tries.states + states) // STATES_A_BOX)
            for number, (part, motion_step) in enumerate(NARROWER, start=FIRST_NARROW):
                padding = part * context.request.padding
                if padding > 0.0 and states > 0 and ledger.room() != 0:
                    found = _narrower(context, ends, SearchRound(number, padding, motion_step), states // 2)
                    if found is not None:
                        return found
                    accounting.tried_in_vain += f" (none with {padding * 1000:g} mm of padding either)"
    except TimeBoxSpent as stopped:
        accounting.tried_in_vain = (
            accounting.tried_in_vain or " (the time was too short for a proof that there is none)"
        )
        ledger.poll()
        accounting.stopped_by(stopped)
    finally:
        if found is None:
            accounting.back_to(Stage.SEARCH, padding_before, trouble)
    return None


def _refute(context: PlanContext, ends: Ends, boxes: int) -> None:
    """Look for a proof that no path exists, within so many boxes and no more than ``MOST_BOXES``.

    Raises:
        NoPlan: There is one.
    """
    checker, accounting = context.checker, context.accounting
    goals = ends.all_of(context.goals, checker.robot)
    if goals is None or ends.departure is not None or boxes == 0:  # of a way out a wall is no objection
        return
    from planner_service.decomposition.no_path import MOST_BOXES, NoPath, divide

    boxes = min(MOST_BOXES, boxes)
    with accounting.during(Stage.NO_PATH) as entry:
        entry.note = "stopped"
        proof = divide(
            checker.robot, checker.scene, ends.start, goals, checker.allowed, boxes, accounting.ledger.charge
        )
        entry.note = "proven" if isinstance(proof, NoPath) else f"not proven in {boxes:,} boxes"
    if isinstance(proof, NoPath):
        raise accounting.impossible(proof, only_for_hulls(checker.robot, checker.scene, proof.pairs))
    accounting.tried_in_vain = f" (no proof that there is none in {boxes:,} boxes)"


def _narrower(context: PlanContext, ends: Ends, searching: SearchRound, states: int) -> _Proof | None:
    """A proven path that keeps less padding, found by checking so many states."""
    accounting, ledger, padding = context.accounting, context.checker.ledger, searching.padding
    try:
        with context.checker.limited(states=states):
            candidates = search_stage.search(context, padded_ends(context, ends, padding), searching)
            proof = _prove(context, ends, candidates)
    except CheckBudgetSpent:
        if ledger.room() == 0:
            raise
        return None
    except NoPlan as no_plan:
        if no_plan.failure.reason not in (Reason.PLANNING_FAILED, Reason.NOT_CERTIFIED):
            raise
        return None
    if not proof.refused:
        accounting.retry(f"searched with {padding * 1000:g} mm of padding: nothing was found with more")
    return None if proof.refused else proof


def _prove(context: PlanContext, ends: Ends, candidates: Candidates) -> _Proof:
    """The optimum of the first candidate, if one was requested and it is proven; else the first candidate that is
    proven with its corners blended; else the refusal of the last.

    Raises:
        NoPlan: Proving takes more than the certifier may spend.
    """
    optimum = _optimum(context, ends, candidates)
    if optimum is not None:
        return optimum
    for turn, points in enumerate(candidates.polylines):
        route = _route(context, ends, points)
        path = _blended(context, route, candidates)
        path, certificate = certified_path(path, context.certifier.get(), context.accounting, route.exempt)
        proof = _Proof(path, certificate, route.goal_index, candidates.padding, candidates, turn)
        if certificate.refusal is None:
            return proof
        if certificate.refusal.spent:
            raise unproven(certificate)
        if turn + 1 < len(candidates.polylines):
            context.accounting.notes.append(f"corners put back where they were: {certificate.refusal}")
    return proof


def _finish(context: PlanContext, ends: Ends, proof: _Proof) -> PlanResult:
    """The plan along a path that is proven.

    Raises:
        NoPlan: It is not, or the timing law has no solution.
    """
    accounting = context.accounting
    if proof.refused:
        raise unproven(proof.certificate)
    if proof.candidates is not None and accounting.roadmap is not None:
        search_stage.remember(context, proof.candidates, proof.turn)
    accounting.learned = _learned(context, ends, proof)
    if proof.motion is None:
        proof = _in_time(context, proof)
    if proof.motion is None:
        raise BrokenInvariant("a plan without a trajectory")
    if min(ends.padding, proof.padding) < context.request.padding:
        accounting.take(_padding_kept(context, proof.path, proof.certificate, _between(ends, proof)))
    return accounting.result(proof.path, *proof.motion, goal_index=proof.goal_index, certificate=proof.certificate)


def _learned(context: PlanContext, ends: Ends, proof: _Proof) -> tuple[FloatArray, tuple[str, ...]] | None:
    """What is remembered of a plan: its motion, but for the fixed ways at its ends."""
    first = 0 if ends.departure is None else len(ends.departure.path.waypoints) - 1
    arrives = any(goal.arrival and goal.index == proof.goal_index for goal in ends.goals)
    points = proof.path.waypoints[first : -1 if arrives else None]
    return (points, context.checker.robot.joint_names) if len(points) > 1 else None


def _padding_kept(
    context: PlanContext, path: JointPath, certificate: Certificate, span: tuple[float, float] | None = None
) -> KeptPadding:
    certifier = context.certifier.get()
    asked, checker = context.request.padding, context.checker
    return padding_kept(path, certificate, asked, checker, certifier, context.accounting, span=span)


def _between(ends: Ends, proof: _Proof) -> tuple[float, float]:
    """From where to where a path goes between the fixed ways at its ends."""
    knots, arrives = proof.path.knots, any(goal.arrival and goal.index == proof.goal_index for goal in ends.goals)
    begin = 0 if ends.departure is None else len(ends.departure.path.waypoints) - 1
    return float(knots[begin]), float(knots[-2] if arrives else knots[-1])


def _in_time(context: PlanContext, proof: _Proof) -> _Proof:
    """The proven path in time; with stops instead of blends in the rare case that this is faster."""
    trajectory, report = _timed(context, proof.path)
    blends = replace(proof, motion=(trajectory, report))
    if report.duration <= report.stop_duration:
        return blends
    accounting = context.accounting
    try:
        path, certificate = certified_path(
            proof.path.with_blends(None), context.certifier.get(), accounting, proof.certificate.exempt
        )
        trajectory, stopping = _timed(context, path)
        if certificate.refusal is None and stopping.duration < report.duration:
            accounting.notes.append("stops at the corners are faster here than blends: none was kept")
            return replace(proof, path=path, certificate=certificate, motion=(trajectory, stopping))
    except NoPlan:
        pass
    except (CheckBudgetSpent, TimeBoxSpent) as stopped:
        accounting.stopped_by(stopped)
    return blends


def _timed(context: PlanContext, path: JointPath) -> tuple[Trajectory, MotionReport]:
    return timed(path, context.request.pace, context.checker.robot, context.accounting)


# Routes: from the requested start to the requested goal.


def _route(context: PlanContext, ends: Ends, points: FloatArray) -> _Route:
    """The whole way, with the fixed ways out of a pose and into one."""
    last = points[-1].tolist()
    goal = next(goal for goal in ends.goals if goal.q.tolist() == last)
    if ends.departure is None and goal.arrival is None:
        return _Route(JointPath(points), goal.index, (), ())
    robot, pieces, kept = context.checker.robot, [points], list[int]()
    exempt: list[ExemptInterval] = []
    if ends.departure is not None:
        before = ends.departure.path.waypoints[:-1]
        pieces.insert(0, before)
        kept += range(1, len(before) + 1)
        exempt += ends.departure.exempt
    if goal.arrival is not None:
        pieces.append(robot.pose(goal.arrival.pose)[None])
    path = JointPath(np.concatenate(pieces))
    if goal.arrival is not None:
        kept.append(len(path.waypoints) - 2)
        pairs = context.checker.parts.labels.links(goal.arrival.pairs)
        exempt.append(ExemptInterval(float(path.knots[-2]), path.length, pairs, goal.arrival.reason))
    return _Route(path, goal.index, tuple(kept), tuple(exempt))


def _blended(context: PlanContext, route: _Route, candidates: Candidates) -> JointPath:
    """The route with its corners blended as widely as is free with the padding of the search."""
    path, size, accounting = route.path, context.request.blend, context.accounting
    if size == 0.0 or not set(path.corners) - set(route.kept):
        return path
    with accounting.during(Stage.POLISH, improving="blended") as entry:
        entry.length = path.length
        sizes = np.full(len(path.waypoints), size)
        sizes[list(route.kept)] = 0.0
        path = blended(path, candidates.oracle, sizes)
        corners, stops = len(route.path.corners), len(path.corners)
        entry.note = f"{corners - stops} of {corners} corners blended"
    return path


# Optimising, instead of blending or instead of searching.


def _optimum(context: PlanContext, ends: Ends, candidates: Candidates) -> _Proof | None:
    """The optimum of the first candidate, if one was requested, and it is free, proven and has a trajectory."""
    settings, accounting, checker = context.request.optimise, context.accounting, context.checker
    points = candidates.polylines[0]
    if settings is None or len(points) < 2:
        return None
    optimum: Optimum | None = None
    left = checker.ledger.time_left()
    limited = checker.limited(deadline=None if left is None else time.monotonic() + POLISH_SHARE * left)
    with accounting.during(Stage.POLISH, improving="optimised") as entry, limited:
        optimum, touch = optimum_path(settings, points, checker, candidates.round.checker(context, ends.padding))
        if not optimum.iterations:
            return None
        accounting.polish = judged(settings, optimum, touch)
        entry.length, entry.note = polyline_length(points), accounting.polish.note
        if accounting.polish.kept:
            entry.length, entry.note = optimum.path.length, f"{settings.method.name}, {optimum.iterations} steps"
    if optimum is None or accounting.polish is None:
        accounting.notes.append(entry.note)
        return None
    if accounting.polish.kept:
        try:
            proof = replace(_proven_optimum(context, ends, optimum), candidates=candidates)
            note = _loss(context, ends, proof)
            if not note:
                return proof
            accounting.polish = replace(accounting.polish, kept=False, note=note)
        except NoPlan as no_plan:
            why = no_plan.certificate and no_plan.certificate.refusal
            note = f"the optimum is not proven: {why}" if why else f"no motion along the optimum: {no_plan}"
            accounting.polish = replace(accounting.polish, kept=False, note=note)
    accounting.notes.append(f"not optimised: {accounting.polish.note}")
    return None


def _loss(context: PlanContext, ends: Ends, proof: _Proof) -> str:
    """Says so if an optimum, which was judged with what its ends keep, is nearer to something than it was searched."""
    if proof.candidates is None or ends.padding == context.request.padding:
        return ""
    kept = _padding_kept(context, proof.path, proof.certificate, _between(ends, proof))
    return f"of the optimum, {kept.note}" if kept.padding < proof.candidates.padding else ""


def _optimised_line(context: PlanContext, ends: Ends) -> _Proof:
    """The first optimum of a line to a goal that is free and proven.

    Raises:
        NoPlan: None is.
    """
    request, accounting, checker = context.request, context.accounting, context.checker
    settings, tried = request.optimise, list[tuple[Touch | None, str]]()
    if settings is None:
        raise BrokenInvariant("a request without an optimisation was asked to optimise")
    starts = [lines((ends.start, goal.q), settings, request.seed, checker.robot) for goal in ends.goals]
    for points in (points for turn in zip(*starts, strict=True) for points in turn):
        accounting.attempt(f"{settings.method.name} from another line")
        with accounting.during(Stage.SEARCH) as entry:
            optimum, touch = optimum_path(settings, points, checker, checker.variant(padding=ends.padding))
            report = judged(settings, optimum, touch)
            accounting.polish = replace(report, kept=True, note="") if touch is None else report
            entry.note = f"{settings.method.name}, {optimum.iterations} steps, start {accounting.attempts}"
            entry.length = optimum.path.length
        try:
            if touch is None:
                return _proven_optimum(context, ends, optimum)
            tried.append((touch, str(touch)))
        except NoPlan as no_plan:
            tried.append((None, str((no_plan.certificate and no_plan.certificate.refusal) or no_plan)))
        accounting.polish = replace(accounting.polish, kept=False, note=tried[-1][1])
    raise NoPlan(not_free(tried))


def _proven_optimum(context: PlanContext, ends: Ends, optimum: Optimum) -> _Proof:
    """An optimum as it was judged, proven and in time: no blend is made narrower, and none a stop.

    Raises:
        NoPlan: It is not proven, or the timing law has no solution.
    """
    route = _route(context, ends, optimum.path.waypoints)
    blends = np.zeros(len(route.path.waypoints))
    first = 0 if ends.departure is None else len(ends.departure.path.waypoints) - 1
    blends[first : first + len(optimum.path.blends)] = optimum.path.blends
    path = route.path.with_blends(blends)
    certificate = require_proven(certify(path, context.certifier.get(), context.accounting, route.exempt))
    return _Proof(path, certificate, route.goal_index, ends.padding, motion=_timed(context, path))
