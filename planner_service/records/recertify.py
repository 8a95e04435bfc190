"""Plans and tasks are proven again before they are used: a file may have been changed, and so may a value.

Only the motions, the gripper's widths and the carried objects are taken from a plan; everything it says about them is
checked:

1. Each trajectory runs along the plan's own path, and the gripper's widths are within its range.
2. The motions join, and the scene changes only by what the gripper takes, or leaves where it stands
   (``task_sequence``).
3. Each motion keeps the robot's limits, scaled as requested, those of torques if they were asked for with what it
   then carries, and the tool's speed limit. ``Trajectory`` itself makes
   sure that time and path position increase without a jump and that the motion rests at both ends.
4. Every stretch on which a pair was not checked follows from a rule (``exemptions``) or is named again by the caller.
   So is every pair that the plan was made with as ``allowed``.
5. Every motion is then free, also between samples, and so are the gripper's own motions.
6. Every motion keeps its constraints everywhere: those of the result, of the request, and of what it carries.
7. A plan begins and ends where its request asks (``astray``).

It takes about 2 ms for a plan and 80 ms for a task of seven motions, so it is done wherever a plan comes from.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace

from planner_service.certify import (
    MAX_OVERLAP,
    Certificate,
    Certifier,
    ExemptInterval,
    GripperMotion,
    Trail,
    certify_gripper,
)
from planner_service.certify.pairs import pairs_of_names
from planner_service.constraints.values import Constraint
from planner_service.errors import InvalidRequest, NotProven
from planner_service.planning.request import Pace, PlanRequest, World, keeps_torques, kept_in, torques_of
from planner_service.planning.result import Origin, PlanResult
from planner_service.planning.task_result import Segment, TaskResult
from planner_service.records.exemptions import ruled
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.records.request import astray
from planner_service.records.task_sequence import (
    SAME_WIDTH,
    ClaimedMotion,
    TaskMotion,
    fingers_of,
    gripped_by,
    task_motions,
)
from planner_service.robot.model import Robot
from planner_service.scene.names import Names
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService
from planner_service.timing.laws import SCurve, TimingFailed, peak_tool_speed
from planner_service.timing.limit_check import peaks
from planner_service.timing.torque_limits import BETWEEN, EXCESS

__all__ = [
    "Plan",
    "ProvenMotion",
    "Recertified",
    "planned_elsewhere",
    "recertify",
    "require_same_robot",
    "squeezed",
    "world_of",
]

Plan = PlanResult | SavedPlan | SavedTask | TaskResult

END_SLACK = 1e-9
"""Path length by which a stretch may end beyond its path, for rounding."""

LIMIT_SLACK = 1e-6
"""Share by which a peak may exceed its limit, for rounding."""

TOOL_SLACK = 1e-5
"""The same for the tool's speed, whose peak is known to six digits."""

MAX_PAIRS = 3
"""Pairs named in one message; a file can exempt them all."""


@dataclass(frozen=True, eq=False)
class ProvenMotion:
    """One motion with its proof.

    Attributes:
        motion: The motion with the robot and the scene as they are during it.
        certificate: The proof of its path or its refusal, with the stretches on which pairs were not checked and the
            rule that allows each.
        gripper: The gripper's own motion before it, proven too; None if the gripper does not move.
        trails: What both proofs rest on, if that was asked for.
    """

    motion: TaskMotion
    certificate: Certificate
    gripper: GripperMotion | None = None
    trails: tuple[Trail, ...] = ()

    @property
    def name(self) -> str:
        """The name of the motion."""
        return self.motion.name


@dataclass(frozen=True, eq=False)
class Recertified:
    """What proving a plan or a task again has found.

    Attributes:
        world: The robot and the scene in which it begins.
        motions: The motions that could be checked, in order.
        allowed: Pairs that may touch all the time: the plan was made with them, and the caller named them again.
        problems: What does not hold, motion by motion; empty if all of it is proven.
    """

    world: World
    motions: tuple[ProvenMotion, ...]
    allowed: tuple[tuple[str, str], ...]
    problems: tuple[str, ...]

    @property
    def certified(self) -> bool:
        """Whether all of it is proven."""
        return not self.problems

    @property
    def taken(self) -> tuple[str, ...]:
        """The obstacles that the gripper takes."""
        return tuple(proven.motion.taken.name for proven in self.motions if proven.motion.taken is not None)

    @property
    def not_checked(self) -> tuple[str, ...]:
        """Every pair that is not checked, where, and why."""
        several = len(self.motions) > 1
        stretches = []
        for proven in self.motions:
            if proven.gripper is not None:
                for stretch in proven.gripper.certificate.exempt:
                    pairs = ", ".join(f"{a} x {b}" for a, b in stretch.pairs)
                    where = f"{proven.gripper.name} before {proven.name}"
                    stretches.append(f"{where}: not judged: {pairs} ({stretch.reason})")
            stretches += [f"{proven.name}: {each}" if several else each for each in proven.certificate.unjudged]
        return (*stretches, *(f"allowed to touch all the time: {a} x {b}" for a, b in self.allowed))

    def dropped_from(self, width: float) -> str:
        """Says what a gripper ``width`` metres open would drop by opening for the first motion; empty for nothing."""
        return _dropped(self.motions[0].motion, width)

    def opening_from(self, width: float) -> GripperMotion | None:
        """The proven motion of the gripper from a width, in metres, to the first motion's; None if it does not move."""
        first = self.motions[0].motion
        if first.robot.gripper is None:
            return None
        inside = min(max(width, first.robot.gripper.lower), first.robot.gripper.upper)
        return _gripper_motion(first.robot.with_gripper(inside), None, first, self.allowed)

    def required(self) -> Recertified:
        """The same object, if all of it is proven.

        Raises:
            NotProven: it is not.
        """
        if self.problems:
            raise NotProven(*self.problems)
        return self


def planned_elsewhere(plan: Plan) -> bool:
    """Whether any motion of a plan was planned by another process."""
    return any(result.origin is None or result.origin.elsewhere for result in _results(plan))


def _results(plan: Plan) -> list[PlanResult]:
    return [plan] if isinstance(plan, PlanResult) else [segment.result for segment in plan.segments]


def world_of(plan: Plan) -> World:
    """The robot and the scene in which a plan begins.

    Raises:
        InvalidRequest: another process made the plan, so they are not known.
    """
    origins = [result.origin for result in _results(plan)]
    if origins and None not in origins and not isinstance(plan, SavedTask) and origins[0] is not None:
        return plan.begin if isinstance(plan, TaskResult) else origins[0].world
    if isinstance(plan, SavedPlan | SavedTask):
        return plan.begin
    if isinstance(plan, TaskResult) and all(segment.scene is not None for segment in plan.segments[:1]):
        return plan.begin
    expected = "the robot and the scene it was planned for: only plans of this process, and saved ones, know them"
    raise InvalidRequest("service", None, expected)


def recertify(
    plan: Plan,
    service: PlannerService | None = None,
    *,
    allowed: Sequence[tuple[str, str]] = (),
    padding: float = 0.0,
    squeeze: float = 0.0,
    tracing: bool = False,
) -> Recertified:
    """Prove a plan or a task again, motion by motion; the list at the top of this module says what is checked.

    Args:
        service: The robot and the scene in which it has to begin; those it was made with must be equal. If not given,
            those it was made with.
        allowed: Pairs that may touch although no rule says so: pairs the plan was made with as ``allowed``, or that it
            exempts on a stretch. Pairs that ``service`` allows count as named, too.
        padding: Metres that every checked pair has to keep.
        squeeze: Metres by which the gripper is commanded to close beyond the width of what it takes. Closing is proven
            free that far, in case the object gives way or is not there.
        tracing: Keep what each proof rests on.

    Raises:
        InvalidRequest: the plan is a failure, has no world, or was made in another world than that of ``service``; a
            named pair is not needed; the padding is out of range.
    """
    if service is not None:
        _require_same_world(plan, service)
    world = world_of(plan) if service is None else service.world
    results = _results(plan)
    if plan.failure is not None or not results:
        raise InvalidRequest("plan", str(plan.failure), "a plan, not a failure")
    given = pairs_of_names("allowed", allowed)
    recorded = _made_with(plan, results)
    stretches = {frozenset(pair) for result in results for stretch in result.exempt for pair in stretch.pairs}
    _require_needed(given, {*map(frozenset, recorded), *stretches})
    named = {frozenset(pair) for pair in (*given, *(() if service is None else service.allowed))}
    lenient = tuple(pair for pair in recorded if frozenset(pair) in named)
    problems = [
        f"it was planned with {a} x {b} allowed to touch; {_how_to_name([(a, b)])}"
        for a, b in recorded
        if frozenset((a, b)) not in named
    ]
    claims, segments = _claims(plan, world), _segments(plan, world)
    requests = _requests(plan, segments)
    motions: list[TaskMotion] = []
    try:
        motions.extend(task_motions(world.robot, world.scene, claims))
    except NotProven as unsound:
        problems += unsound.problems
    if motions and isinstance(plan, SavedTask) and (dropped := _dropped(motions[0], plan.robot.gripper_width)):
        problems.append(f"{motions[0].name}: {dropped}")
    asked = None if isinstance(plan, SavedTask | TaskResult) else requests[0]
    if motions and asked is not None and (elsewhere := astray(asked, results[0], world.robot)):
        problems.append(f"{motions[0].name}: {elsewhere}")
    proven = []
    for before, motion, segment, request in zip([None, *motions], motions, segments, requests, strict=False):
        overlap = MAX_OVERLAP if request is None else request.start_overlap
        exempt, refused = _exempt(before, motion, named, overlap)
        refused = [*_exceeded_limits(motion, _pace(segment, request)), *refused]
        trails = (Trail(), Trail()) if tracing else ()
        try:
            asked_to_keep = () if request is None else request.constraints
            kept = kept_in(motion.scene, (*motion.result.constraints, *asked_to_keep))
            certificate = _certificate(motion, exempt, kept, lenient, padding, trails, whole=len(claims) > 1)
        except InvalidRequest as error:
            problems += [f"{motion.name}: {text}" for text in (error, *refused)]
            continue
        refused = refused if certificate.refusal is None else [str(certificate.refusal), *refused]
        problems += [f"{motion.name}: {text}" for text in refused]
        gripper = _gripper_motion(world.robot, before, motion, lenient, squeeze, trails)
        problems += [f"{motion.name}: {gripper.refused}"] if gripper is not None and gripper.refused else []
        proven.append(ProvenMotion(motion, certificate, gripper, trails))
    return Recertified(world, tuple(proven), lenient, tuple(problems))


def _require_same_world(plan: Plan, service: PlannerService) -> None:
    """Refuse a plan that is known to be for another robot than the service's, or to begin in another scene."""
    require_same_robot(plan, service.robot)
    if isinstance(plan, PlanResult) and plan.origin is None:
        return
    made, scene = world_of(plan).scene, service.scene
    if made.hash != scene.hash:
        expected = f"one made in the scene of service (--scene), {_named(scene)}"
        raise InvalidRequest("plan", made, expected, message=f"plan: made in {_named(made)}; expected {expected}")


def require_same_robot(plan: Plan, robot: Robot) -> None:
    """Refuse a plan that is known to be for another robot; how far the gripper is open does not matter."""
    for made in _robots(plan):
        if robot.opened_like(made).hash != made.hash:
            expected = f"a plan made for this robot (--robot), {_named(robot)}"
            raise InvalidRequest("plan", made, expected, message=f"plan: made for {_named(made)}; expected {expected}")


def _named(made: Robot | Scene) -> str:
    return f"{made.name or 'a scene without a name'}, {made.hash[:12]}"


def _robots(plan: Plan) -> list[Robot]:
    made = [result.origin.world.robot for result in _results(plan) if result.origin is not None]
    if isinstance(plan, TaskResult):
        return [plan.world.robot, *made]
    return [plan.robot, *made] if isinstance(plan, SavedPlan | SavedTask) else made


def _made_with(plan: Plan, results: Sequence[PlanResult]) -> tuple[tuple[str, str], ...]:
    """Pairs that could touch all the time when a plan was made."""
    pairs = [] if isinstance(plan, PlanResult) else list((plan.world if isinstance(plan, TaskResult) else plan).allowed)
    for result in results:
        pairs += [] if result.origin is None else result.origin.world.allowed
    return tuple({frozenset(pair): pair for pair in pairs}.values())


def _require_needed(given: Sequence[tuple[str, str]], needed: set[frozenset[str]]) -> None:
    for pair in given:
        if frozenset(pair) not in needed:
            known = ", ".join(sorted(" x ".join(sorted(each)) for each in needed)) or "none: it needs no pair"
            raise InvalidRequest("allowed", " x ".join(pair), f"a pair that this plan lets touch ({known})")


def _how_to_name(pairs: Sequence[tuple[str, str]]) -> str:
    options = [f"--allow {shlex.quote(f'{a}:{b}')}" for a, b in pairs[:MAX_PAIRS]]
    tuples = [str(pair) for pair in pairs[:MAX_PAIRS]]
    more = ["..."] if len(pairs) > MAX_PAIRS else []
    python = f"allowed=[{', '.join([*tuples, *more])}]"
    return f"if the contact is intended, allow it: {' '.join([*options, *more])} (Python: {python})"


def _claims(plan: Plan, world: World) -> list[ClaimedMotion]:
    """What a plan claims of its motions."""
    claims: list[ClaimedMotion] = []
    attached = world.scene.attached
    for segment in _segments(plan, world):
        origin = segment.result.origin
        scene = segment.scene if origin is None else origin.world.scene
        attached = attached if scene is None else scene.attached
        claims.append(ClaimedMotion(segment.name, segment.result, segment.width, attached, scene))
    return claims


def _segments(plan: Plan, world: World) -> Sequence[Segment]:
    if not isinstance(plan, PlanResult):
        return plan.segments
    robot = world.robot if plan.origin is None else plan.origin.world.robot
    return [Segment("motion", plan, robot.gripper_width)]


def _requests(plan: Plan, segments: Sequence[Segment]) -> list[PlanRequest | None]:
    """The request of each motion, as far as it is known."""
    request = None if isinstance(plan, PlanResult) else plan.request
    origins = [_asking(segment) for segment in segments]
    return [request if origin is None else origin.request for origin in origins]


def _pace(segment: Segment, request: PlanRequest | None) -> Pace | None:
    """How fast a motion was allowed to be; None where that is not known, and the robot's own limits hold.

    A law of the motion's own keeps torque limits if the request does, as ``Handling.line_timing``.
    """
    origin = _asking(segment)
    if origin is not None and origin.request is None:
        return origin.pace
    if request is None:
        return None
    law = segment.timing if origin is None else None
    known = law is not None and (keeps_torques(law) or not keeps_torques(request.timing))
    return Pace.of(request, law if known else None)


def _asking(segment: Segment) -> Origin | None:
    """The origin of a motion if it has the request; those of a served task only say where they were made."""
    origin = segment.result.origin
    return origin if origin is not None and (origin.request is not None or origin.pace is not None) else None


def _exceeded_limits(motion: TaskMotion, requested: Pace | None) -> list[str]:
    """Which limits a motion exceeds, where and by how much."""
    robot, trajectory = motion.robot, motion.trajectory
    pace = requested
    if trajectory.s(0.0, 1) > 0.0:  # a replanned motion; it may be a stop, which uses all that the robot can do
        pace = None
    limits = robot.limits if pace is None else pace.limits(robot)
    exceeded = []
    try:
        measured = peaks(trajectory, limits)
    except InvalidRequest as error:
        return [str(error)]
    kinds = ["velocity", "acceleration"]
    kinds += ["jerk"] if pace is not None and isinstance(pace.timing, SCurve) else []
    for kind in kinds:
        peak = getattr(measured, kind)
        if not peak.ratio <= 1.0 + LIMIT_SLACK:
            joint = robot.joint_names[peak.joint]
            exceeded.append(f"{joint} reaches {peak.ratio:.4g} times the {kind} allowed, at t = {peak.time:.3f} s")
    exceeded += [] if requested is None else _exceeded_torques(motion, requested)
    most = None if pace is None else pace.max_tool_speed
    if most is not None and not (speed := peak_tool_speed(robot, trajectory)) <= most * (1.0 + TOOL_SLACK):
        exceeded.append(f"the tool moves at {speed:.4g} m/s; the request allows {most:g} (max_tool_speed)")
    return exceeded


def _exceeded_torques(motion: TaskMotion, pace: Pace) -> list[str]:
    """Which of the requested torque limits a motion exceeds, in the scene as it is during the motion."""
    try:
        limits = torques_of(pace, motion.robot, motion.scene)
        found = () if limits is None else limits.samples(motion.trajectory).peaks()
    except (InvalidRequest, TimingFailed) as error:
        return [str(error)]
    return [
        f"{motion.robot.joint_names[peak.joint]} reaches {peak.ratio:.4g} times its torque, at t = {peak.time:.3f} s"
        for peak in found
        if not peak.ratio <= 1.0 + EXCESS - BETWEEN + LIMIT_SLACK
    ]


def _exempt(
    before: TaskMotion | None, motion: TaskMotion, named: set[frozenset[str]], overlap: float
) -> tuple[tuple[ExemptInterval, ...], list[str]]:
    """The stretches of a motion that a rule or the caller allows, and what is wrong with the others."""
    exempt: list[ExemptInterval] = []
    refused: list[str] = []
    unruled: dict[tuple[str, str], list[tuple[str, str]]] = {}
    names = Names(motion.robot, motion.scene)
    known = {*(names.link(shape.link) for shape in motion.robot.shapes), *map(names.object, motion.scene.names)}
    for stretch in motion.result.exempt:
        reasons: dict[str, list[tuple[str, str]]] = {}
        for pair in stretch.pairs:
            a, b = pair
            if not {a, b} <= known:
                refused.append(f"{a!r} x {b!r} is exempt, but the robot and the scene have no such pair")
                continue
            if stretch.s_end > motion.trajectory.path.length + END_SLACK:
                refused.append(f"{a} x {b} is exempt up to s = {stretch.s_end:.6g}, beyond the end of the path")
                continue
            ruling = ruled(before, motion, stretch, pair, overlap)
            if ruling.reason or frozenset(pair) in named:
                reasons.setdefault(ruling.reason or "named as a pair that may touch", []).append(pair)
                continue
            where = f"from s = {stretch.s_start:.4g} to {stretch.s_end:.4g}"
            unruled.setdefault((where, ruling.objection), []).append(pair)
        exempt += [replace(stretch, pairs=tuple(pairs), reason=reason) for reason, pairs in reasons.items()]
    for (where, why), pairs in unruled.items():
        first = ", ".join(f"{a} x {b}" for a, b in pairs[:MAX_PAIRS])
        more = f" and {len(pairs) - MAX_PAIRS} more pairs" if len(pairs) > MAX_PAIRS else ""
        verb = "is" if len(pairs) == 1 else "are"
        refused.append(f"{first}{more} {verb} not judged {where}: {why}; {_how_to_name(pairs)}")
    return tuple(exempt), refused


def squeezed(robot: Robot, width: float, squeeze: float) -> float:
    """The width, in metres, that a gripper closing on an object is commanded to, so that it presses."""
    return width if robot.gripper is None else max(robot.gripper.lower, width - squeeze)


def _dropped(first: TaskMotion, width: float) -> str:
    """Says what a gripper ``width`` metres open would drop by opening for the first motion; empty for nothing."""
    held, wider = gripped_by(first.robot, first.scene.attached), first.robot.gripper_width
    if not held or wider <= width + SAME_WIDTH:
        return ""
    return f"the gripper holds {', '.join(held)} at {width:.4f} m and would drop it, opening to {wider:.4f} m"


def _gripper_motion(
    first: Robot,
    before: TaskMotion | None,
    motion: TaskMotion,
    allowed: Sequence[tuple[str, str]],
    squeeze: float = 0.0,
    trails: Sequence[Trail] = (),
) -> GripperMotion | None:
    """The gripper's own motion before one of the arm, proven where the arm stands then; None if it does not move."""
    robot = first if before is None else before.robot
    widths = robot.gripper_width, motion.robot.gripper_width
    if robot.gripper is None or widths[0] == widths[1]:
        return None
    scene, q = (motion if before is None else before).scene, motion.trajectory(0.0)
    names, touching, reason = Names(robot, scene), list[tuple[str, str]](), ""
    held = None if before is None else before.taken or before.left
    if held is not None:
        touching = [(names.link(finger), names.object(held.name)) for finger in fingers_of(robot)]
        reason = "fingers may touch what they take or leave"
    if before is not None and before.taken is not None:
        widths = widths[0], squeezed(motion.robot, widths[1], squeeze)
    trail = trails[1] if trails else None
    return certify_gripper(robot, scene, q, widths, allowed=allowed, touching=touching, reason=reason, trail=trail)


def _certificate(
    motion: TaskMotion,
    exempt: Sequence[ExemptInterval],
    constraints: Sequence[Constraint],
    allowed: Sequence[tuple[str, str]],
    padding: float,
    trails: Sequence[Trail],
    *,
    whole: bool,
) -> Certificate:
    trajectory, part = motion.trajectory, motion.trajectory.part
    if part is not None:
        if whole:
            raise InvalidRequest("part", part, "a motion of a task along all of its path")
        had = None if motion.result.certificate is None else motion.result.certificate.part
        begin = min(trajectory.begin, had[0]) if had is not None else trajectory.begin
        part = begin, trajectory.end
    certifier = Certifier(motion.robot, motion.scene, allowed=allowed)
    trail = trails[0] if trails else None
    return certifier.certify(
        trajectory.path, padding=padding, exempt=exempt, constraints=constraints, part=part, trail=trail
    )
