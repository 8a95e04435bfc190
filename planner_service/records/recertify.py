"""Plans and tasks proven again before they are used: a file may have been changed, and so may a value.

Nothing that a plan says of itself is believed but its motions, the gripper's widths and what is carried. Checked is

1. that each motion's trajectory runs along the plan's own path, and the gripper's widths are within its range;
2. that motions join, and the scene changes only by what the gripper takes or leaves where it stands (``story``);
3. that each motion keeps the robot's limits, scaled as was asked, and the tool its speed; that time runs on, and s goes
   along the whole path without a jump and rests at its ends, is what makes a ``Trajectory``;
4. that every stretch on which a pair was not judged follows from a rule (``exemptions``), or is named again by whoever
   asks, as are all pairs that the plan was made with as ``allowed``;
5. that every motion is free then, between samples too, and so is the gripper's own.

That takes some 2 ms for a plan and 80 ms for a task of seven motions, so it is done wherever a plan comes from.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace

from planner_service.certify import Certificate, Certifier, ExemptInterval, GripperMotion, certify_gripper
from planner_service.certify.pairs import pairs_of_names
from planner_service.errors import InvalidRequest, NotProven
from planner_service.planning.request import Pace, PlanRequest
from planner_service.planning.result import PlanResult
from planner_service.planning.timing_stage import peak_tool_speed
from planner_service.planning.world import World
from planner_service.records.exemptions import ruled
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.records.task_sequence import SAME_WIDTH, Leg, Step, fingers_of, gripped_by, legs
from planner_service.robot.model import Robot
from planner_service.scene.names import Names
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService
from planner_service.tasks.result import Segment, TaskResult
from planner_service.timing.laws import SCurve
from planner_service.timing.limit_check import peaks

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
"""Rounding by which a stretch may end beyond its path."""

SLIGHT = 1e-6
"""Share by which a limit may seem exceeded by rounding."""

MOST_PAIRS = 3
"""Pairs named in one message; a file can exempt them all."""

TOOL_SLIGHT = 1e-5
"""The same of the tool's speed, whose peak is known to six digits."""


@dataclass(frozen=True, eq=False)
class ProvenMotion:
    """One motion with what was found of it.

    Attributes:
        leg: The motion, and the robot and the scene as they are during it.
        certificate: The proof of its path or its refusal, with the stretches on which pairs were not judged; the
            reasons are those of the rules.
        gripper: How the gripper comes to its opening before it, proven too; None if it has it already.
    """

    leg: Leg
    certificate: Certificate
    gripper: GripperMotion | None = None

    @property
    def name(self) -> str:
        """The motion's."""
        return self.leg.name


@dataclass(frozen=True, eq=False)
class Recertified:
    """What was found of a plan or a task.

    Attributes:
        world: The robot and the scene in which it begins.
        motions: Those that could be judged, in order.
        allowed: Pairs that may touch all the time, which the plan was made with and which were named again.
        objections: What does not hold, motion by motion; nothing of a plan that is proven.
    """

    world: World
    motions: tuple[ProvenMotion, ...]
    allowed: tuple[tuple[str, str], ...]
    objections: tuple[str, ...]

    @property
    def certified(self) -> bool:
        """Whether all of it is proven."""
        return not self.objections

    @property
    def taken(self) -> tuple[str, ...]:
        """The obstacles that the gripper takes."""
        return tuple(motion.leg.taken.name for motion in self.motions if motion.leg.taken is not None)

    @property
    def lenience(self) -> tuple[str, ...]:
        """Every pair that is not judged, where, and why."""
        several = len(self.motions) > 1
        stretches = []
        for motion in self.motions:
            if motion.gripper is not None:
                for stretch in motion.gripper.certificate.exempt:
                    pairs = ", ".join(f"{a} x {b}" for a, b in stretch.pairs)
                    stretches.append(
                        f"{motion.gripper.name} before {motion.name}: not judged: {pairs} ({stretch.reason})"
                    )
            stretches += [
                f"{motion.name}: {stretch}" if several else str(stretch) for stretch in motion.certificate.exempt
            ]
        return (*stretches, *(f"allowed to touch all the time: {a} x {b}" for a, b in self.allowed))

    def dropped_from(self, width: float) -> str:
        """What a gripper that stands ``width`` metres open would drop by opening for the first motion, in words."""
        return _dropped(self.motions[0].leg, width)

    def opening_from(self, width: float) -> GripperMotion | None:
        """The gripper going from a width, in metres, to the one that the first motion begins with, and its proof.

        None if it stays as it is.
        """
        first = self.motions[0].leg
        if first.robot.gripper is None:
            return None
        inside = min(max(width, first.robot.gripper.lower), first.robot.gripper.upper)
        return _gripper_motion(first.robot.with_gripper(inside), None, first, self.allowed)

    def required(self) -> Recertified:
        """This, if it is proven.

        Raises:
            NotProven: it is not.
        """
        if self.objections:
            raise NotProven(*self.objections)
        return self


def planned_elsewhere(plan: Plan) -> bool:
    """Whether any of a plan was not planned in this process."""
    return any(result.origin is None for result in _results(plan))


def _results(plan: Plan) -> list[PlanResult]:
    if isinstance(plan, SavedTask | TaskResult):
        return [segment.result for segment in plan.segments]
    return [plan.result if isinstance(plan, SavedPlan) else plan]


def world_of(plan: Plan) -> World:
    """The robot and the scene in which a plan begins, as far as they come with it.

    Raises:
        InvalidRequest: they do not: another process planned it.
    """
    origins = [result.origin for result in _results(plan)]
    if origins and None not in origins and not isinstance(plan, SavedTask) and origins[0] is not None:
        return plan.begin if isinstance(plan, TaskResult) else origins[0].world
    if isinstance(plan, SavedPlan | SavedTask):
        return plan.made_for
    expected = "the robot and the scene it was planned for: only plans of this process, and saved ones, know them"
    raise InvalidRequest("service", None, expected)


def recertify(
    plan: Plan,
    service: PlannerService | None = None,
    *,
    allowed: Sequence[tuple[str, str]] = (),
    padding: float = 0.0,
    squeeze: float = 0.0,
) -> Recertified:
    """A plan or a task proven again, motion by motion; see the list above for what is checked.

    Args:
        service: The robot and the scene in which it begins, which those that it was made with must equal; these if not
            given.
        allowed: Pairs that may touch although no rule says so: those that the plan was made with as ``allowed``, and
            those of a stretch of its own. What ``service`` allows is named, too.
        padding: Metres that every judged pair is to keep.
        squeeze: Metres that a gripper is to be told to close beyond what it takes: proven free that far, should what it
            takes give way or not be there.

    Raises:
        InvalidRequest: the plan is a failure, comes without a world, or was made in another than ``service``; a pair
            is named that it does not need; the padding is out of range.
    """
    if service is not None:
        _require_same_world(plan, service)
    world = world_of(plan) if service is None else service.world
    results = _results(plan)
    failure = plan.failure if isinstance(plan, SavedTask | TaskResult) else results[0].failure
    if failure is not None or not results:
        raise InvalidRequest("plan", str(failure), "a plan, not a failure")
    given = pairs_of_names("allowed", allowed)
    recorded = _made_with(plan, results)
    stretches = {frozenset(pair) for result in results for stretch in result.exempt for pair in stretch.pairs}
    _require_needed(given, {*map(frozenset, recorded), *stretches})
    named = {frozenset(pair) for pair in (*given, *(() if service is None else service.allowed))}
    lenient = tuple(pair for pair in recorded if frozenset(pair) in named)
    objections = [
        f"it was planned with {a} x {b} allowed to touch; {_how_to_name([(a, b)])}"
        for a, b in recorded
        if frozenset((a, b)) not in named
    ]
    steps, paces = _steps(plan, world), _paces(plan, _segments(plan, world))
    found: list[Leg] = []
    try:
        found.extend(legs(world.robot, world.scene, steps))
    except NotProven as unsound:
        objections += unsound.problems
    if found and isinstance(plan, SavedTask) and (dropped := _dropped(found[0], plan.robot.gripper_width)):
        objections.append(f"{found[0].name}: {dropped}")
    motions = []
    for k, (leg, pace) in enumerate(zip(found, paces, strict=False)):
        exempt, refused = _exempt(found[k - 1] if k else None, leg, named)
        troubles = [*_law_troubles(leg, pace), *refused]
        try:
            certificate = _certificate(leg, exempt, lenient, padding, whole=len(steps) > 1)
        except InvalidRequest as error:
            objections += [f"{leg.name}: {text}" for text in (error, *troubles)]
            continue
        troubles = troubles if certificate.refusal is None else [str(certificate.refusal), *troubles]
        objections += [f"{leg.name}: {text}" for text in troubles]
        grip = _gripper_motion(world.robot, found[k - 1] if k else None, leg, lenient, squeeze)
        objections += [f"{leg.name}: {grip.refused}"] if grip is not None and grip.refused else []
        motions.append(ProvenMotion(leg, certificate, grip))
    return Recertified(world, tuple(motions), lenient, tuple(objections))


def _require_same_world(plan: Plan, service: PlannerService) -> None:
    """Raise for a plan that is known to be of another robot than that of a service, or to begin in another scene."""
    require_same_robot(plan, service.robot)
    if isinstance(plan, PlanResult) and plan.origin is None:
        return
    made, here = world_of(plan).scene, service.scene
    if made.hash != here.hash:
        expected = f"one made in the scene of service (--scene), {_named(here)}"
        raise InvalidRequest("plan", made, expected, message=f"plan: made in {_named(made)}; expected {expected}")


def require_same_robot(plan: Plan, robot: Robot) -> None:
    """Raise for a plan that is known to be of another robot, however far its gripper is open."""
    for made in _robots(plan):
        same_width = robot.gripper is None or made.gripper is None or robot.gripper_width == made.gripper_width
        opened = robot if same_width else robot.with_gripper(made.gripper_width)
        if made.hash != opened.hash:
            expected = f"a plan made for this robot (--robot), {_named(robot)}"
            raise InvalidRequest("plan", made, expected, message=f"plan: made for {_named(made)}; expected {expected}")


def _named(made: Robot | Scene) -> str:
    return f"{made.name or 'a scene without a name'}, {made.hash[:12]}"


def _robots(plan: Plan) -> list[Robot]:
    made = [result.origin.world.robot for result in _results(plan) if result.origin is not None]
    return [plan.robot, *made] if isinstance(plan, SavedPlan | SavedTask) else made


def _made_with(plan: Plan, results: Sequence[PlanResult]) -> tuple[tuple[str, str], ...]:
    """Pairs that were allowed to touch all the time when a plan was made."""
    pairs = list(plan.allowed) if isinstance(plan, SavedPlan | SavedTask) else []
    for result in results:
        pairs += [] if result.origin is None else result.origin.world.allowed
    return tuple({frozenset(pair): pair for pair in pairs}.values())


def _require_needed(given: Sequence[tuple[str, str]], needed: set[frozenset[str]]) -> None:
    for pair in given:
        if frozenset(pair) not in needed:
            known = ", ".join(sorted(" x ".join(sorted(each)) for each in needed)) or "none: it needs no pair"
            raise InvalidRequest("allowed", " x ".join(pair), f"a pair that this plan lets touch ({known})")


def _how_to_name(pairs: Sequence[tuple[str, str]]) -> str:
    options = [f"--allow {shlex.quote(f'{a}:{b}')}" for a, b in pairs[:MOST_PAIRS]]
    tuples = [str(pair) for pair in pairs[:MOST_PAIRS]]
    more = ["..."] if len(pairs) > MOST_PAIRS else []
    python = f"allowed=[{', '.join([*tuples, *more])}]"
    return f"if the contact is intended, allow it: {' '.join([*options, *more])} (Python: {python})"


def _steps(plan: Plan, world: World) -> list[Step]:
    """What a plan says of its motions."""
    steps: list[Step] = []
    attached = world.scene.attached
    for segment in _segments(plan, world):
        origin = segment.result.origin
        scene = segment.scene if origin is None else origin.world.scene
        attached = attached if scene is None else scene.attached
        steps.append(Step(segment.name, segment.result, segment.width, attached, scene))
    return steps


def _segments(plan: Plan, world: World) -> Sequence[Segment]:
    if isinstance(plan, SavedTask | TaskResult):
        return plan.segments
    result = plan.result if isinstance(plan, SavedPlan) else plan
    robot = world.robot if result.origin is None else result.origin.world.robot
    return [Segment("motion", result, (plan.robot if isinstance(plan, SavedPlan) else robot).gripper_width)]


def _paces(plan: Plan, segments: Sequence[Segment]) -> list[Pace | None]:
    """How fast each motion was to be at most; None where that is not known: then the robot's own limits hold."""
    told = None if isinstance(plan, PlanResult) else plan.request
    return [_pace(segment, told) for segment in segments]


def _pace(segment: Segment, told: PlanRequest | None) -> Pace | None:
    origin = segment.result.origin
    if origin is not None and (origin.pace is not None or origin.request is not None):
        return origin.pace if origin.request is None else Pace.of(origin.request)
    return None if told is None else Pace.of(told, segment.timing)


def _law_troubles(leg: Leg, asked: Pace | None) -> list[str]:
    """What of a motion is beyond the limits."""
    robot, trajectory = leg.robot, leg.trajectory
    pace = asked
    if trajectory.s(0.0, 1) > 0.0:  # a motion that was replanned; it may be a stop, with all that the robot has
        pace = None
    limits = robot.limits if pace is None else pace.limits(robot)
    told = []
    try:
        found = peaks(trajectory, limits)
    except InvalidRequest as error:
        return [str(error)]
    kinds = ["velocity", "acceleration"]
    kinds += ["jerk"] if pace is not None and isinstance(pace.timing, SCurve) else []
    for kind in kinds:
        peak = getattr(found, kind)
        if not peak.ratio <= 1.0 + SLIGHT:
            joint = robot.joint_names[peak.joint]
            told.append(f"{joint} reaches {peak.ratio:.4g} times the {kind} allowed, at t = {peak.time:.3f} s")
    most = None if pace is None else pace.max_tool_speed
    if most is not None and not (speed := peak_tool_speed(robot, trajectory)) <= most * (1.0 + TOOL_SLIGHT):
        told.append(f"the tool moves at {speed:.4g} m/s; the request allows {most:g} (max_tool_speed)")
    return told


def _exempt(before: Leg | None, leg: Leg, named: set[frozenset[str]]) -> tuple[tuple[ExemptInterval, ...], list[str]]:
    """The stretches of a motion that a rule gives, or that were named, and what is wrong with the others."""
    exempt: list[ExemptInterval] = []
    refused: list[str] = []
    unruled: dict[tuple[str, str], list[tuple[str, str]]] = {}
    names = Names(leg.robot, leg.scene)
    known = {*(names.link(shape.link) for shape in leg.robot.shapes), *map(names.object, leg.scene.names)}
    for stretch in leg.result.exempt:
        reasons: dict[str, list[tuple[str, str]]] = {}
        for pair in stretch.pairs:
            a, b = pair
            if not {a, b} <= known:
                refused.append(f"{a!r} x {b!r} is exempt, but the robot and the scene have no such pair")
                continue
            if stretch.s_end > leg.trajectory.path.length + END_SLACK:
                refused.append(f"{a} x {b} is exempt up to s = {stretch.s_end:.6g}, beyond the end of the path")
                continue
            ruling = ruled(before, leg, stretch, pair)
            if ruling.reason or frozenset(pair) in named:
                reasons.setdefault(ruling.reason or "named as a pair that may touch", []).append(pair)
                continue
            where = f"from s = {stretch.s_start:.4g} to {stretch.s_end:.4g}"
            unruled.setdefault((where, ruling.objection), []).append(pair)
        exempt += [replace(stretch, pairs=tuple(pairs), reason=reason) for reason, pairs in reasons.items()]
    for (where, why), pairs in unruled.items():
        first = ", ".join(f"{a} x {b}" for a, b in pairs[:MOST_PAIRS])
        more = f" and {len(pairs) - MOST_PAIRS} more pairs" if len(pairs) > MOST_PAIRS else ""
        verb = "is" if len(pairs) == 1 else "are"
        refused.append(f"{first}{more} {verb} not judged {where}: {why}; {_how_to_name(pairs)}")
    return tuple(exempt), refused


def squeezed(robot: Robot, width: float, squeeze: float) -> float:
    """The width, in metres, that a gripper closing on something is told, so that it presses."""
    return width if robot.gripper is None else max(robot.gripper.lower, width - squeeze)


def _dropped(first: Leg, width: float) -> str:
    """What a gripper that stands ``width`` metres open would drop by opening for the first motion, in words."""
    held, wider = gripped_by(first.robot, first.scene.attached), first.robot.gripper_width
    if not held or wider <= width + SAME_WIDTH:
        return ""
    return f"the gripper holds {', '.join(held)} at {width:.4f} m and would drop it, opening to {wider:.4f} m"


def _gripper_motion(
    first: Robot, before: Leg | None, leg: Leg, allowed: Sequence[tuple[str, str]], squeeze: float = 0.0
) -> GripperMotion | None:
    """How the gripper comes to its opening before a motion, the arm standing where that begins, and its proof."""
    robot = first if before is None else before.robot
    widths = robot.gripper_width, leg.robot.gripper_width
    if robot.gripper is None or widths[0] == widths[1]:
        return None
    scene, q = (leg if before is None else before).scene, leg.trajectory(0.0)
    names, touching, reason = Names(robot, scene), list[tuple[str, str]](), ""
    held = None if before is None else before.taken or before.left
    if held is not None:
        touching = [(names.link(finger), names.object(held.name)) for finger in fingers_of(robot)]
        reason = "fingers may touch what they take or leave"
    if before is not None and before.taken is not None:
        widths = widths[0], squeezed(leg.robot, widths[1], squeeze)
    return certify_gripper(robot, scene, q, widths, allowed=allowed, touching=touching, reason=reason)


def _certificate(
    leg: Leg,
    exempt: Sequence[ExemptInterval],
    allowed: Sequence[tuple[str, str]],
    padding: float,
    *,
    whole: bool,
) -> Certificate:
    trajectory, part = leg.trajectory, leg.trajectory.part
    if part is not None:
        if whole:
            raise InvalidRequest("part", part, "a motion of a task along all of its path")
        had = None if leg.result.certificate is None else leg.result.certificate.part
        begin = min(trajectory.begin, had[0]) if had is not None else trajectory.begin
        part = begin, trajectory.end
    certifier = Certifier(leg.robot, leg.scene, allowed=allowed)
    return certifier.certify(trajectory.path, padding=padding, exempt=exempt, part=part)
