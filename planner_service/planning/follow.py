"""A given polyline, checked once and timed: what straight tool moves are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify import Certificate, Certifier, ExemptInterval
from planner_service.certify.certifier import LIMIT_SLACK
from planner_service.certify.pairs import pairs_of_names
from planner_service.collision import CancelToken, CollisionChecker, Known
from planner_service.concurrency.polling import Prepared
from planner_service.constraints import Constraint
from planner_service.constraints.values import checked_constraints
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, joint_distance, set_fields
from planner_service.geometry.validation import instance, items, number, numbers, text, whole
from planner_service.memory.memory import Memory, checked_memory, knows
from planner_service.path.joint_path import JointPath
from planner_service.planning.accounting import NoPlan, PlanAccounting, certified_path, certify, require_proven, timed
from planner_service.planning.kept_padding import padding_kept
from planner_service.planning.request import Pace, clamp_note, clamped, kept_in, torques_of
from planner_service.planning.result import Failure, PlanResult, Reason, Stage
from planner_service.search.problem import CompiledOracle, ConstrainedOracle, SearchOracle
from planner_service.smoothing.smoothing import MIN_BLEND, blended, widest_blends

__all__ = ["AllowedStretch", "FollowRequest", "follow"]

Pair = tuple[str, str]

MAX_WAYPOINTS = 1_000_000

MAX_CLAMP_NOTES = 3
"""Waypoints outside a limit by a little that notes name."""

MAX_PADDING = 0.1
"""Metres. More is a mistake in the unit."""


@dataclass(frozen=True)
class AllowedStretch:
    """Waypoints ``first`` to ``last`` of a polyline, between and at which the named pairs may touch."""

    first: int
    last: int
    pairs: tuple[Pair, ...]
    reason: str

    def __post_init__(self) -> None:
        first, last = (whole(name, getattr(self, name), -MAX_WAYPOINTS, MAX_WAYPOINTS) for name in ("first", "last"))
        set_fields(self, first=first, last=last, pairs=pairs_of_names("pairs", self.pairs))
        text("reason", self.reason)


@dataclass(frozen=True, eq=False)
class FollowRequest:
    """A polyline to follow, and how.

    Attributes:
        waypoints: Shape (N, n); joints that are outside a limit by at most 0.01 rad (or m) are clamped, and the result
            says so.
        contacts: Where pairs may touch.
        pace: How fast.
        blends: How wide each corner may be blended (rad), shape (N,); None to stop at all of them.
        padding: Metres that pairs which may not touch are to keep.
        min_blend: The narrowest blend (rad); a corner that would need a narrower one is a stop.
        constraints: What must hold all along, beside the constraints of what the robot carries.
    """

    waypoints: ArrayLike
    contacts: Sequence[AllowedStretch]
    pace: Pace
    blends: ArrayLike | None = None
    padding: float = 0.0
    min_blend: float = MIN_BLEND
    constraints: Sequence[Constraint] = ()

    def __post_init__(self) -> None:
        waypoints = numbers("waypoints", self.waypoints, "rows of joint values")
        expected = "a list of AllowedStretch(first, last, pairs, reason)"
        set_fields(self, waypoints=waypoints, contacts=items("contacts", self.contacts, AllowedStretch, expected))
        instance("pace", self.pace, Pace, "a pace such as Pace(SCurve(), velocity_scale=0.5)")
        if self.blends is not None:
            set_fields(self, blends=numbers("blends", self.blends, "widths >= 0 in radians"))
        number("padding", self.padding, f"metres in [0, {MAX_PADDING:g}]", 0.0, MAX_PADDING)
        number("min_blend", self.min_blend, "radians in [1e-6, 1]", 1e-6, 1.0)
        set_fields(self, constraints=checked_constraints(self.constraints))


def follow(
    request: FollowRequest,
    checker: CollisionChecker,
    certifier: Prepared[Certifier],
    *,
    memory: Memory | None = None,
    cancel: CancelToken | None = None,
) -> PlanResult:
    """A polyline checked, its corners blended, proven and in time; its first waypoint is checked in ENDPOINTS.

    Samples are checked before anything is proven: they find most collisions sooner, and say where. Where a motion
    between the same ends is remembered, the proof comes first, and samples only if it is refused.

    Raises:
        InvalidRequest: The polyline is not one of this robot, or a contact or blend does not go with it.
        UnknownName: A constraint names no link or joint of the robot.
    """
    points = numbers("waypoints", request.waypoints, f"rows of {checker.robot.n} joint values")
    if points.ndim != 2 or points.shape[1] != checker.robot.n:
        raise InvalidRequest("waypoints", points.shape, f"rows of {checker.robot.n} joint values")
    given, inside = points, clamped(points, checker.robot)
    if inside is not given:
        points = np.where(np.abs(inside - given).max(axis=1, keepdims=True) > LIMIT_SLACK, inside, given)
    path = JointPath(points)
    sizes = _sizes(request, points)
    for contact in request.contacts:
        if not 0 <= contact.first <= contact.last < len(points):
            stretch = f"waypoints {contact.first} to {contact.last}"
            raise InvalidRequest("contacts", stretch, f"first and last waypoint in order, from 0 to {len(points) - 1}")
    memory = checked_memory(memory, checker.robot)
    accounting = PlanAccounting(checker, cancel=cancel, memory=memory)
    moved = [] if points is given else np.flatnonzero((given != points).any(axis=1))[:MAX_CLAMP_NOTES].tolist()
    for k in moved:
        accounting.notes.append(clamp_note(f"waypoints[{k}]", given[k], points[k], checker.robot))
    accounting.keep(kept_in(checker.scene, request.constraints))
    accounting.torque_limits = torques_of(request.pace, checker.robot, checker.scene)

    def sampled() -> tuple[JointPath, Certificate]:
        for contact in request.contacts:
            _allowing(checker, frozenset(contact.pairs))  # refuses unknown names before anything is judged
        with accounting.during(Stage.ENDPOINTS):
            _judge_first(checker, points, request.contacts)
        with accounting.during(Stage.STRAIGHT_LINE) as entry:
            _judge_pieces(checker, points, request.contacts)
            entry.note, entry.length = f"{len(points)} points", path.length
        smooth = _blended(checker, path, sizes, request, accounting)
        exempt = _intervals(smooth, points, request.contacts)
        smooth, certificate = certified_path(smooth, certifier.get(), accounting, exempt)
        return smooth, require_proven(certificate)

    def stages() -> PlanResult:
        with accounting.during(Stage.ENDPOINTS):
            accounting.require_end("start", points[0])
            accounting.require_held("goal", points[-1])
        proven = _remembered(path, points, sizes, request, certifier, accounting)
        smooth, certificate = sampled() if proven is None else proven
        kept = padding_kept(smooth, certificate, request.padding, checker, certifier.get(), accounting)
        accounting.take(kept)
        trajectory, motion = timed(smooth, request.pace, checker.robot, accounting)
        if len(points) > 1:
            accounting.learned = points, checker.robot.joint_names
        return accounting.result(smooth, trajectory, motion, certificate=kept.proof or certificate)

    return accounting.outcome(stages)


def _sizes(request: FollowRequest, points: FloatArray) -> FloatArray:
    """How wide each corner may be blended, (N,)."""
    if request.blends is None:
        return np.zeros(len(points))
    expected = f"{len(points)} finite widths >= 0 in radians, one for each waypoint"
    sizes = numbers("blends", request.blends, expected)
    if sizes.shape != (len(points),) or not np.all((sizes >= 0.0) & np.isfinite(sizes)):
        raise InvalidRequest("blends", sizes.tolist(), expected)
    return sizes


def _remembered(
    path: JointPath,
    points: FloatArray,
    sizes: FloatArray,
    request: FollowRequest,
    certifier: Prepared[Certifier],
    accounting: PlanAccounting,
) -> tuple[JointPath, Certificate] | None:
    """The path with its widest blends and its proof, if a motion between these ends is remembered and this is proven.

    Nothing is sampled.
    """
    if not knows(accounting.memory, points[0], points[-1]):
        return None
    smooth = widest_blends(path, sizes, least=request.min_blend) if len(path.waypoints) == len(sizes) else path
    certificate = certify(smooth, certifier.get(), accounting, _intervals(smooth, points, request.contacts))
    return None if certificate.refusal is not None else (smooth, certificate)


def _blended(
    checker: CollisionChecker,
    path: JointPath,
    sizes: FloatArray,
    request: FollowRequest,
    accounting: PlanAccounting,
) -> JointPath:
    """The path with corners blended as widely as is requested and free; a pair may touch where it may on both sides.

    If waypoints coincide, corners no longer have the numbers of their waypoints: all of them stay stops.
    """
    if len(path.waypoints) < len(sizes) or not any(sizes[k] > 0.0 for k in path.corners):
        return path

    def pairs_at(k: int) -> frozenset[Pair]:
        return _allowed_on(request.contacts, k - 1, k + 1)

    def oracle_of(pairs: frozenset[Pair]) -> CompiledOracle:
        oracle = SearchOracle(_allowing(checker, pairs))
        return oracle if accounting.projector is None else ConstrainedOracle(oracle, accounting.projector)

    with accounting.during(Stage.POLISH) as entry:
        smooth = path
        for pairs, corners in groupby([k for k in path.corners if sizes[k] > 0.0], pairs_at):
            smooth = blended(smooth, oracle_of(pairs), sizes, least=request.min_blend, corners=[*corners])
        entry.note = f"{len(path.corners) - len(smooth.corners)} of {len(path.corners)} corners blended"
        entry.length = path.length
        return smooth


def _allowed_on(contacts: Sequence[AllowedStretch], first: int, last: int) -> frozenset[Pair]:
    """Pairs that may touch on the whole of waypoints ``first`` to ``last``."""
    return frozenset(p for c in contacts if c.first <= first and last <= c.last for p in c.pairs)


def _allowing(checker: CollisionChecker, pairs: frozenset[Pair]) -> CollisionChecker:
    """The checker that lets these pairs touch, too."""
    return checker.variant(allowed=(*checker.allowed, *pairs)) if pairs else checker


def _judge_first(checker: CollisionChecker, points: FloatArray, contacts: Sequence[AllowedStretch]) -> None:
    lenient = _allowing(checker, _allowed_on(contacts, 0, 0))
    if not lenient.state_is_free(points[0]):
        touching = lenient.contacts(points[0])
        detail = f"start in collision: {', '.join(str(contact) for contact in touching[:3])}"
        raise NoPlan(Failure(Stage.ENDPOINTS, Reason.START_IN_COLLISION, detail, touching))


def _judge_pieces(checker: CollisionChecker, points: FloatArray, contacts: Sequence[AllowedStretch]) -> None:
    """Check each piece once, and a waypoint again only where the next piece allows less than the one before."""
    before = _allowed_on(contacts, 0, 0)
    for k in range(len(points) - 1):
        pairs = _allowed_on(contacts, k, k + 1)
        known = Known.START if before <= pairs else Known.NEITHER
        hit = _allowing(checker, pairs).edge_hit(points[k], points[k + 1], known=known)
        if hit is not None:
            part = (k + hit.fraction) / (len(points) - 1)
            detail = f"blocked at {part:.0%} of the way: {hit.a} x {hit.b}"
            raise NoPlan(Failure(Stage.STRAIGHT_LINE, Reason.LINE_BLOCKED, detail))
        before = pairs


def _intervals(path: JointPath, points: FloatArray, contacts: Sequence[AllowedStretch]) -> tuple[ExemptInterval, ...]:
    """The stretches in arc length. Waypoints that the path has merged lie where the one before them does."""
    if not contacts:
        return ()
    s = [0.0]
    for a, b in pairwise(points.tolist()):
        s.append(s[-1] + joint_distance(a, b))
    ends = [float(path.knots[np.abs(path.knots - at).argmin()]) for at in s]
    return tuple(ExemptInterval(ends[c.first], ends[c.last], c.pairs, c.reason) for c in contacts)
