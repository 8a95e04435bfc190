"""Constraints on curves: what a proof says is kept, next to the largest deviations that a search of the curve finds."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import planner_service as ps
from auditor.checker import IndependentChecker
from auditor.constraints import Deviation, deviations
from benchmarks.attack.harness import Wrong
from benchmarks.harness.audit import audited
from planner_service.certify import Kept, KeptRefusal, prove_kept
from planner_service.constraints import Constraint, JointRange, ToolRegion
from planner_service.constraints.values import MIN_ANGLE, MIN_LENGTH
from planner_service.geometry.arrays import FloatArray, vector
from planner_service.kinematics.constraint_set import ConstraintSet, projector_of
from tests.reference.projector import ReferenceProjector

__all__ = ["constraints_of", "draw_constraints", "judge_constraints", "judge_projector"]

Plain = dict[str, Any]

SAMPLES, FOLLOWED, FINER = 600, 4, 33
"""Places of a curve that are looked at first, how many of the largest deviations are followed, and into how many parts
the stretches beside them are cut, twice."""

ROUNDING = 3e-9
"""Metres or radians by which two programs may differ, beside the slack of the proof."""

TIGHT, NEGLIGIBLE = 1.25, 0.2
"""What the proof promises: a bound is at most so many times the largest deviation, or that part of the tolerance."""

FOUND = 1e-3
"""Relative: by how much the largest deviation that was found may be too small."""

MARGINS = (1e-6, 1e-3, 0.05, 0.5, 3.0)
"""By which parts of a deviation a tolerance is drawn beyond it, or short of it."""

CLEARLY = 0.98
"""A curve whose deviations are below this part of each tolerance is refused by no finding but a proof without end."""

INF = math.inf


def _pose(rng: np.random.Generator, near: float = 1.0) -> ps.Pose:
    turned = near * rng.uniform(-math.pi, math.pi, 3)
    return ps.Pose.from_rpy(vector((near * rng.uniform(-0.3, 0.3, 3)).tolist()), vector(turned.tolist()))


def _plain(constraint: Constraint) -> Plain:
    if isinstance(constraint, JointRange):
        return {"joint": constraint.joint, "lower": constraint.lower, "upper": constraint.upper}
    names = ("lower", "upper", "tilt", "turn", "link", "relative_to")
    poses = {"frame": constraint.frame, "tool": constraint.tool}
    rows = {key: [*pose.position, *pose.quaternion] for key, pose in poses.items()}
    return rows | {key: getattr(constraint, key) for key in names}


def constraints_of(plain: Sequence[Mapping[str, Any]]) -> tuple[Constraint, ...]:
    """Drawn constraints as the package takes them; JSON has lists in place of tuples."""
    out: list[Constraint] = []
    for one in plain:
        if "joint" in one:
            out.append(JointRange(**one))
        else:
            poses = {key: ps.Pose(tuple(one[key][:3]), tuple(one[key][3:])) for key in ("frame", "tool")}
            out.append(ToolRegion(**{**one, **poses}))
    return tuple(out)


def draw_constraints(
    robot: ps.Robot,
    second: IndependentChecker,
    curve: ps.JointPath,
    span: tuple[float, float],
    rng: np.random.Generator,
) -> list[Plain]:
    """Constraints that a part of a curve just keeps, or just breaks, or keeps with room."""
    samples = curve(np.linspace(*span, SAMPLES))
    return [
        _plain(_range(robot, samples, rng) if rng.random() < 0.15 else _region(robot, second, samples, rng))
        for _ in range(int(rng.integers(1, 4)))
    ]


def _range(robot: ps.Robot, samples: FloatArray, rng: np.random.Generator) -> JointRange:
    k = int(rng.integers(robot.n))
    low, high = float(samples[:, k].min()), float(samples[:, k].max())
    room = _room(rng) * max(high - low, MIN_ANGLE)
    low, high = low - room, high + (room if rng.random() < 0.5 else 1.0)
    return JointRange(robot.joint_names[k], low, max(high, low + 1.001 * MIN_ANGLE))


def _room(rng: np.random.Generator) -> float:
    """What is left of a tolerance, as part of the deviation: in one case of three less than nothing."""
    return float(rng.choice(MARGINS)) * (-0.1 if rng.random() < 0.33 else 1.0)


def _region(robot: ps.Robot, second: IndependentChecker, samples: FloatArray, rng: np.random.Generator) -> ToolRegion:
    links = [frame.link for frame in robot.link_frames]
    link = None if rng.random() < 0.4 else str(rng.choice(links))
    relative = None if rng.random() < 0.5 else str(rng.choice(links))
    tool = _pose(rng) if rng.random() < 0.7 else ps.Pose()
    free = ToolRegion(tilt=math.pi, tool=tool, link=link, relative_to=relative)
    middle = samples[len(samples) // 2]
    near = _pose(rng, float(rng.choice((0.0, 0.02, 0.3, 1.0))))
    region = replace(free, frame=ps.Pose.from_matrix(_seen(robot, second, free, middle)) @ near)
    low, high = _extent(robot, second, region, samples)
    bounds: list[tuple[float, float]] = []
    for a, b in zip(low, high, strict=True):
        room = _room(rng) * max(b - a, MIN_LENGTH)
        a, b = a - room, b + room
        b = max(b, a + 2.001 * MIN_LENGTH)
        bounds.append(((a, b), (-INF, b), (a, INF), (-INF, INF))[int(rng.choice(4, p=(0.4, 0.1, 0.1, 0.4)))])
    lower, upper = (vector([bound[k] for bound in bounds]) for k in (0, 1))
    tilt, turn = (
        min(max(item.amount * (1.0 + _room(rng)), MIN_ANGLE), math.pi)
        for item in deviations(second, samples, [audited(robot, replace(region, tilt=1.5, turn=math.pi))])
    )
    bounded = any(math.isfinite(bound) for pair in bounds for bound in pair)
    if bounded and rng.random() < 0.3:
        return replace(region, lower=lower, upper=upper, tilt=None)
    region = replace(region, lower=lower, upper=upper, tilt=tilt)
    return replace(region, turn=turn) if tilt <= math.pi / 2 and rng.random() < 0.7 else region


def _seen(robot: ps.Robot, second: IndependentChecker, region: ToolRegion, q: FloatArray) -> FloatArray:
    """Where the constrained frame is in the link that carries the region, 4 x 4."""
    outer = second.link_poses(q, [region.link or robot.tool_frame])[0] @ region.tool.matrix
    inner = np.eye(4) if region.relative_to is None else second.link_poses(q, [region.relative_to])[0]
    return np.asarray(np.linalg.inv(inner) @ outer)


def _extent(
    robot: ps.Robot, second: IndependentChecker, region: ToolRegion, samples: FloatArray
) -> tuple[list[float], list[float]]:
    """The least and the largest coordinates at samples."""
    none = (INF, INF, INF)
    above = deviations(second, samples, [audited(robot, replace(region, upper=(0.0, 0.0, 0.0), tilt=None))])
    below = deviations(second, samples, [audited(robot, replace(region, lower=(0.0, 0.0, 0.0), upper=none, tilt=None))])
    return [-item.amount for item in below], [item.amount for item in above]


def judge_constraints(
    robot: ps.Robot,
    second: IndependentChecker,
    curve: ps.JointPath,
    given: Sequence[Constraint],
    span: tuple[float, float],
    counted: Counter[str],
    extreme: Callable[[str, float], None],
) -> None:
    """Compare what is proven of each constraint with what a search of the curve finds.

    Raises:
        Wrong: A deviation is larger than its bound; a bound is loose; a refusal has no reason.
    """
    alone = [prove_kept(robot, curve, [constraint], part=span) for constraint in given]
    refused = next((replace(one, index=k) for k, one in enumerate(alone) if isinstance(one, KeptRefusal)), None)
    together = prove_kept(robot, curve, given, part=span)
    if together != (refused or tuple(kept for one in alone if not isinstance(one, KeptRefusal) for kept in one)):
        raise Wrong("constraints are proven one by one, and the first that is not kept is named", str(together))
    for constraint, found in zip(given, alone, strict=True):
        if isinstance(found, KeptRefusal):
            counted["constraints refused"] += 1
            _refused(robot, second, curve, constraint, span, found, counted)
        else:
            counted["constraints kept"] += 1
            _kept(robot, second, curve, constraint, span, found[0], extreme)


def _kept(
    robot: ps.Robot,
    second: IndependentChecker,
    curve: ps.JointPath,
    constraint: Constraint,
    span: tuple[float, float],
    kept: Kept,
    extreme: Callable[[str, float], None],
) -> None:
    worst = _largest(robot, second, curve, constraint, span)
    for bound, item in zip(kept.bounds, worst, strict=True):
        told = f"{kept.name} {bound.quantity}: {item.amount:.9g} at {list(item.q)}, bound {bound.bound:.9g}"
        extreme("least bound less deviation, m or rad:", bound.bound - item.amount)
        if (bound.quantity, bound.unit) != (item.quantity, "rad" if _is_angle(robot, item.quantity) else "m"):
            raise Wrong("a proof names what it bounds", told)
        if abs(bound.tolerance - item.tolerance) > 1e-12 * (1.0 + abs(item.tolerance)):
            raise Wrong("a proof is of the tolerance that was given", f"{told}, {bound.tolerance} {item.tolerance}")
        if not item.amount <= bound.bound + ROUNDING or item.exceeds:
            raise Wrong("no deviation is larger than its bound", told)
        if not bound.quantity.startswith(("+", "-")):
            most = max(TIGHT * item.amount, NEGLIGIBLE * item.tolerance) * (1.0 + FOUND) + ROUNDING
            extreme("most of the promised bound:", bound.bound / most)
            if bound.bound > most:
                raise Wrong("a bound is near the largest deviation", told)


def _refused(
    robot: ps.Robot,
    second: IndependentChecker,
    curve: ps.JointPath,
    constraint: Constraint,
    span: tuple[float, float],
    refusal: KeptRefusal,
    counted: Counter[str],
) -> None:
    if refusal.spent:
        counted["proofs of constraints without end"] += 1
        worst = _largest(robot, second, curve, constraint, span)
        if all(_share(item) < CLEARLY for item in worst):
            raise Wrong("a proof ends where there is room", f"{refusal}: {worst}")
        return
    if not span[0] <= refusal.s_start <= refusal.s <= refusal.s_end <= span[1]:
        raise Wrong("a refusal names a place on the part that was judged", str(refusal))
    if not any(start <= refusal.s <= end for start, end in refusal.broken):
        raise Wrong("a refusal lists the stretch that it names", str(refusal))
    there = deviations(second, curve(np.array([refusal.s])), [audited(robot, constraint)])
    (item,) = (one for one in there if one.quantity == refusal.quantity)
    if abs(item.amount - refusal.deviation) > 1e-7 or not item.amount > item.tolerance:
        raise Wrong("a refusal names a deviation that is there", f"{refusal}: {item}")


def _is_angle(robot: ps.Robot, quantity: str) -> bool:
    turning = {robot.joint_names[body.q_index] for body in robot.bodies[1:] if not body.prismatic}
    return quantity in ("tilt", "turn") or quantity in turning


def _share(item: Deviation) -> float:
    if item.quantity.startswith(("+", "-")):
        return 1.0 + item.amount - item.tolerance
    return item.amount / item.tolerance


def _largest(
    robot: ps.Robot, second: IndependentChecker, curve: ps.JointPath, constraint: Constraint, span: tuple[float, float]
) -> list[Deviation]:
    """The largest deviations on a part of a curve: samples, and finer ones beside the largest of them."""
    asked = [audited(robot, constraint)]
    inner = curve.breaks[(curve.breaks > span[0]) & (curve.breaks < span[1])]
    places = np.union1d(np.linspace(*span, SAMPLES), inner)
    worst = deviations(second, curve(places), asked)
    for _ in range(2):
        samples = curve(places)
        near = [np.abs(samples - np.array(item.q)).max(axis=1).argsort(kind="stable")[:FOLLOWED] for item in worst]
        chosen = np.unique(np.concatenate([np.clip(rows + k, 0, len(places) - 1) for rows in near for k in (-1, 0, 1)]))
        parts = [np.linspace(places[k], places[k + 1], FINER) for k in chosen if k + 1 < len(places)]
        if not parts:
            break
        places = np.unique(np.concatenate(parts))
        finer = deviations(second, curve(places), asked)
        worst = [max(pair, key=lambda item: item.amount) for pair in zip(worst, finer, strict=True)]
    return worst


def judge_projector(
    robot: ps.Robot, second: IndependentChecker, given: Sequence[Constraint], rng: np.random.Generator
) -> bool:
    """Compare the compiled projector with its reference, and what it finds with the auditor; False if there is none.

    Raises:
        Wrong: The two differ in a bit, or the auditor sees a violation that the package does not, or the other way.
    """
    try:
        constraints = ConstraintSet(robot, given)
    except ps.InvalidRequest:  # links that do not move against each other, or no room in a joint
        return False
    compiled, reference = projector_of(constraints), ReferenceProjector(constraints)
    asked = [audited(robot, constraint) for constraint in given]
    Q = rng.uniform(constraints.lower, constraints.upper, (3, robot.n))
    drawn = [tuple(q) for q in Q.tolist()]
    projected = [compiled.project(q) for q in drawn]
    if projected != [reference.project(q) for q in drawn]:
        raise Wrong("the compiled projection is the reference's", f"{drawn}")
    ends = [*drawn, *(q for q in projected if q is not None)]
    if [compiled.share(q) for q in ends] != [reference.share(q) for q in ends]:
        raise Wrong("the compiled share is the reference's", f"{ends}")
    for a, b in zip(ends, ends[1:] + ends[:1], strict=True):
        close = tuple(x + 0.05 * (y - x) for x, y in zip(a, b, strict=True))
        if compiled.keeps(a, close) != reference.keeps(a, close):
            raise Wrong("the compiled judgement of an edge is the reference's", f"{a} {close}")
        steps = (a, close, b, math.dist(a, b), math.dist(a, close), False)
        if compiled.step(*steps) != reference.step(*steps):
            raise Wrong("a compiled step is the reference's", f"{steps}")
    for q in ends:
        found, broken = constraints.violation(q), deviations(second, np.array([q]), asked)
        clearly = any(item.amount > item.tolerance + 1e-7 for item in broken)
        nearly = any(item.amount > item.tolerance - 1e-7 for item in broken)
        if (found is None and clearly) or (found is not None and not nearly):
            raise Wrong("a violation is the auditor's", f"{found} {broken} at {q}")
    return True
