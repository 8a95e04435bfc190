"""Curves: what a proof claims of random and near-contact curves, next to the least gap that a search of them finds.

The same of constraints that curves just keep, or just break: see ``kept``.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

import planner_service as ps
from auditor.checker import IndependentChecker
from benchmarks.attack.domain import GAPS, LONGEST, SPEEDS
from benchmarks.attack.harness import Case, Part, Wrong
from benchmarks.attack.kept import constraints_of, draw_constraints, judge_constraints, judge_projector
from benchmarks.attack.worlds import World, draw_world
from benchmarks.worlds.contacts import random_states
from planner_service.certify import Certifier, EdgeVerdict
from planner_service.geometry.arrays import FloatArray

__all__ = ["Attack"]

CURVES, PUSHES, SETS = 4, 4, 2
"""Curves of one world, how often an obstacle is pushed towards each, and sets of constraints that each is judged by."""

PROJECTED = 0.25
"""Part of the sets whose projector is compared with its reference, which takes longer than all else."""

SAMPLES, LOWEST, HALVINGS = 48, 3, 14
"""Places of a curve that are asked at first, how many of them are followed down, and how far."""

COAL, NEAR = 5e-6, 4e-5
"""Metres to which Coal's positive distance is right, and below which support functions are asked."""

KINKS, SLACK, MOST_CLIMBS = 400, 1e-6, 60


class Attack(Part):
    name = "curves"
    what = "what a proof claims, and the least gap and the largest deviations that a search over the curve finds"

    def draw(self, rng: np.random.Generator) -> Case:
        return draw_world(rng, 5) | {"seed": int(rng.integers(2**31))}

    def run(self, case: Case) -> int:
        with tempfile.TemporaryDirectory() as folder:
            world = World(case, Path(folder))
            second = world.independent()
        if "waypoints" in case:
            points = np.array(case["waypoints"]).reshape(-1, world.robot.n)
            curve = _curve(points, case["round"])
            if "constraints" in case:
                self._constrained(world, second, curve, case)
            else:
                self._judge(world, Certifier(world.robot, world.scene), second, curve)
            return 1
        rng, count = np.random.default_rng(case["seed"]), 0
        original = case["obstacles"]
        for _ in range(CURVES):
            case["obstacles"] = [dict(obstacle) for obstacle in original]
            found = _points(world, rng)
            if found is None:
                continue
            case["waypoints"], case["round"] = found.tolist(), float(rng.choice((0.0, 0.3, 0.9)))
            curve = _curve(found, case["round"])
            certifier = Certifier(world.robot, world.scene)
            at = self._judge(world, certifier, second, curve)
            count += 1
            if rng.random() < 0.25:
                self._timed(world, curve, rng)
            for _ in range(SETS):
                span = _span(curve, rng)
                case["span"], case["draw"] = span, int(rng.integers(2**31))
                case["constraints"] = draw_constraints(world.robot, second, curve, span, rng)
                self._constrained(world, second, curve, case)
                count += 1
            for key in ("constraints", "span", "draw"):
                case.pop(key)
            moved = world
            for _ in range(PUSHES if original else 0):
                moved = _pushed(moved, case, second, curve(at), rng)
                self._judge(moved, Certifier(moved.robot, moved.scene), second, curve)
                count += 1
            for body, plain in zip(world.scene.obstacles, original, strict=True):
                _place(second, body.name, plain["xyz"])
        for key in ("waypoints", "round"):
            case.pop(key, None)
        case["obstacles"] = original
        return max(count, 1)

    def _judge(self, world: World, certifier: Certifier, second: IndependentChecker, curve: ps.JointPath) -> float:
        """Compare, and say where on the curve the least gap was found."""
        proof = certifier.certify(curve)
        least, at = _least(second, curve)
        self.counted["certified" if proof.certified else "refused by the proof"] += 1
        if proof.certified:
            if least - proof.clearance < COAL and least < NEAR:
                least = min(second.exact_gap(curve(at)), NEAR)
                if least - proof.clearance < -SLACK:  # it may have stopped short of the direction that separates most
                    least = min(second.exact_gap(curve(at), climbs=MOST_CLIMBS), NEAR)
            slack = (
                0.0 if least == proof.clearance else least - proof.clearance
            )  # both are endless if nothing can touch
            self.extreme("least true less claimed clearance, m:", slack)
            self.extreme("least clearance proven, m:", proof.clearance)
            if not (least > 0.0 and slack >= (-SLACK if least < NEAR else -COAL)):
                raise Wrong(
                    "a certified curve is as free as is claimed", f"{proof.clearance:.4g} m, {least:.4g} at {at}"
                )
        elif proof.refusal is not None and not proof.refusal.spent:
            least = min(least, _gap(second, curve(proof.refusal.s)))  # between the samples it may have been missed
            if least > 1e-3:
                raise Wrong("a curve is refused near contact only", f"{least:.4g} m from contact: {proof.refusal}")
        self.counted["spent"] += proof.refusal is not None and proof.refusal.spent
        points = curve.waypoints
        for a, b in pairwise(points):
            edge = certifier.certify_edge(a, b)
            straight = ps.JointPath(np.array([a, b]))
            self.counted["edges"] += 1
            if edge.verdict is EdgeVerdict.COLLIDING and _gap(second, straight(edge.s)) > COAL:
                raise Wrong("an edge that is proven to collide does", f"at {edge.s}: {edge}")
            if edge.verdict is EdgeVerdict.FREE:
                places = straight(np.linspace(0.0, straight.length, 5))
                if any(_gap(second, q) <= 0.0 and not second.exact_gap(q) > 0.0 for q in places):
                    raise Wrong("an edge that is proven free is", f"{a.tolist()} to {b.tolist()}")
        q = curve(at)
        claimed = float(certifier.clearances(q[None])[0])
        if claimed > _gap(second, q) + COAL and claimed > 0.0:
            raise Wrong("a clearance is a lower bound", f"{claimed:.6g} m claimed at {q.tolist()}")
        return at

    def _constrained(self, world: World, second: IndependentChecker, curve: ps.JointPath, case: Case) -> None:
        """Constraints of a part of a curve, and projections onto them."""
        given, (begin, end) = constraints_of(case["constraints"]), case["span"]
        if end <= curve.length:  # of a smaller input there may be less
            judge_constraints(world.robot, second, curve, given, (begin, end), self.counted, self.extreme)
        rng = np.random.default_rng(case["draw"])
        if rng.random() < PROJECTED and judge_projector(world.robot, second, given, rng):
            self.counted["projectors"] += 1

    def _timed(self, world: World, curve: ps.JointPath, rng: np.random.Generator) -> None:
        """The time law keeps the limits it was given."""
        scale = float(rng.uniform(*SPEEDS))
        limits = replace(world.robot.limits, velocity=scale * world.robot.limits.velocity)
        law = (ps.ToppRa(), ps.Trapezoidal(), ps.SCurve())[int(rng.integers(3))]
        try:
            motion = law.time_path(curve, limits)
        except ps.PlannerServiceError as error:
            if isinstance(error, ps.InvalidRequest):
                return
            raise Wrong("a curve can be timed", f"{type(law).__name__}: {error}") from None
        t = np.linspace(0.0, motion.duration, KINKS)
        for order, most in ((1, limits.velocity), (2, limits.acceleration)):
            part = float((np.abs(motion(t, order)) / most).max())
            self.extreme("most of a limit that a time law uses:", part)
            if not part <= 1.0 + SLACK:
                raise Wrong("a time law keeps the limits", f"{type(law).__name__}, order {order}: {part:.6g} of it")
        self.counted["timed"] += 1


def _points(world: World, rng: np.random.Generator) -> FloatArray | None:
    """Waypoints of a polyline, each free, or None where nothing is."""
    robot, checker = world.robot, ps.CollisionChecker(world.robot, world.scene)
    Q = random_states(robot, 100, rng)
    Q = Q[checker.states_are_free(Q)]
    if not len(Q):
        return None
    points = [Q[0]]
    step = float(10.0 ** rng.uniform(-1.5, 0.0)) * (robot.limits.upper - robot.limits.lower)
    for _ in range(int(rng.integers(1, LONGEST))):
        ways = points[-1] + step * rng.uniform(-0.5, 0.5, (8, robot.n))
        ways = np.clip(ways, robot.limits.lower, robot.limits.upper)
        good = ways[checker.states_are_free(ways)]
        if len(good):
            points.append(good[0])
    return np.array(points if len(points) > 1 else [Q[0], 0.99 * Q[0] + 0.01 * robot.home])


def _curve(points: FloatArray, share: float) -> ps.JointPath:
    """A polyline, every corner rounded as far as the share says, but where it all but turns back."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if len(points) < 3 or not share or lengths.min() < 1e-6:
        return ps.JointPath(points)
    widths = [0.0, *(share * 0.5 * np.minimum(lengths[:-1], lengths[1:])).tolist(), 0.0]
    ways = np.diff(points, axis=0) / lengths[:, None]
    for k in range(1, len(points) - 1):
        if np.abs(ways[k - 1] + ways[k]).max() < 0.3:
            widths[k] = 0.0
    return ps.JointPath(points).with_blends(widths)


def _span(curve: ps.JointPath, rng: np.random.Generator) -> tuple[float, float]:
    """The whole curve, a part of it or a point."""
    if rng.random() < 0.5:
        return 0.0, curve.length
    begin, end = sorted(rng.uniform(0.0, curve.length, 2).tolist())
    return begin, begin if rng.random() < 0.1 else end


def _gap(second: IndependentChecker, q: FloatArray) -> float:
    """The least of Coal's gaps at a configuration."""
    return min(second.gaps(q).values(), default=math.inf)


def _least(second: IndependentChecker, curve: ps.JointPath) -> tuple[float, float]:
    """The least gap that is found along a curve, and where: samples, then the lowest of them followed down."""
    places = np.union1d(np.linspace(0.0, curve.length, SAMPLES), curve.length * np.arange(1, 8) / 8)
    step = curve.length / SAMPLES

    def gap(s: float) -> float:
        return _gap(second, curve(s))

    gaps = np.array([gap(float(s)) for s in places])
    best, at = math.inf, 0.0
    for k in np.argsort(gaps)[:LOWEST]:
        s, value = _descended(gap, float(places[k]), float(gaps[k]), step, curve.length)
        if value < best:
            best, at = value, s
        if best < 0.0:
            break
    return best, at


def _descended(gap: Callable[[float], float], s: float, value: float, step: float, end: float) -> tuple[float, float]:
    for _ in range(HALVINGS):
        for other in (s - step, s + step):
            if 0.0 <= other <= end and (found := gap(other)) < value:
                s, value = other, found
                break
        else:
            step *= 0.4
    return s, value


def _place(second: IndependentChecker, name: str, position: object) -> None:
    shape = second.geometry.geometryObjects[second.owners.index(name)]
    placement = shape.placement.copy()
    placement.translation = np.array(position, dtype=np.float64)
    shape.placement = placement


def _pushed(world: World, case: Case, second: IndependentChecker, q: FloatArray, rng: np.random.Generator) -> World:
    """The world with one obstacle pushed towards the robot at q until there is a drawn gap; the case says so, too."""
    number = int(rng.integers(len(case["obstacles"])))
    plain = case["obstacles"][number]
    name, there = plain["name"], np.array(plain["xyz"])
    positions = np.array(world.robot.body_poses(q))[:, 9:]
    way = positions[int(rng.integers(len(positions)))] - there + rng.normal(size=3) * 0.02
    way /= np.linalg.norm(way)
    wanted = float(np.exp(rng.uniform(*np.log(GAPS))))
    for _ in range(12):
        gap = min((g for pair, g in second.gaps(q).items() if name in pair), default=math.inf)
        if not math.isfinite(gap) or abs(gap - wanted) < 0.05 * wanted:
            break
        there = there + min(gap - wanted, 1.0) * way
        _place(second, name, there)
    plain["xyz"] = there.tolist()
    return world.moved(name, there)
