"""Forged evidence: plan files whose author changed them and worked out every digest anew.

Whether a forgery says something false is decided without the verifier: Pinocchio places the shapes of the file along
the curve of the file, Coal measures how near they come, and where a pair is nearer than the file claims, or a joint is
outside its limits, the claim is false. Such a file must be refused, and for that: of each pair, each stretch on which
it is nearer than claimed must be among those of which the verifier says that they are not shown.
"""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
from rich.table import Table

from auditor.schema import Invalid
from auditor.trails import digest, unpacked
from auditor.verify import verify
from benchmarks.harness.report import Promise, Report, Row, grouped, table_of
from benchmarks.studies.evidence.nearness import Near, Nearness
from benchmarks.studies.evidence.worlds import plans
from planner_service import Box, Cylinder, Obstacle, PlannerService, Pose, Scene, Sphere
from planner_service.errors import InvalidRequest
from planner_service.path.joint_path import JointPath
from planner_service.records.evidence import EVIDENCE, packed, with_evidence
from planner_service.records.plan_file import SavedPlan
from planner_service.records.scene import SceneRecord

__all__ = ["run"]

FORGERIES = 10_000
PLANS = 50
"""That are forged."""

MOST_CLEARANCE = 0.05
"""Metres: what is worth forging."""

MOST_ROWS = 6_000
"""Of a trail: longer ones take longer to check, and are forged alike."""

SAMPLES = 400
"""Along a curve."""

MARGIN = 5e-6
"""Metres by which one of Coal's gaps must be smaller than what is claimed to contradict it: these err."""

Document = dict[str, Any]


class _Base:
    """A plan with evidence, to be forged.

    Attributes:
        text: Of its file.
        places: Samples of its curve.
        nearest: What really comes nearest along it; None if nothing is nearer than ``MOST_CLEARANCE``.
    """

    def __init__(self, service: PlannerService, plan: SavedPlan) -> None:
        self.scene, self.path, self.text = service.scene, plan.result.unwrap()[0], with_evidence(plan).file_text()
        self.robot = service.robot
        self.nearness = Nearness(service.robot.name, service.scene)
        self.places = self.nearness.along(self.path, np.linspace(0.0, self.path.length, SAMPLES).astype(np.float64))
        self.nearest = self.nearness.nearest(self.path, self.places, MOST_CLEARANCE)


class _Forger:
    """Changes to one plan with evidence; ``scene`` and ``path`` are what the changed file says."""

    def __init__(self, base: _Base, chance: random.Random) -> None:
        self.base, self.chance = base, chance
        self.document: Document = json.loads(base.text)
        self.scene, self.path = base.scene, base.path
        self.section: Document = self.document["sections"][EVIDENCE]
        (self.proof,) = self.section["proofs"]

    @property
    def claimed(self) -> float:
        clearance = self.proof["clearance"]
        return math.inf if clearance is None else float(clearance)

    def sealed(self) -> Document:
        """The file with its digests made right."""
        for part in ("robot", "scene"):
            self.section[part] = digest(self.document[part])
        return self.document

    def put(self, scene: Scene) -> None:
        self.scene = scene
        self.document["scene"] = SceneRecord.of(scene).document()

    def rows(self) -> Any:
        return unpacked(self.proof["rows"], "<i4", 9).copy()

    def put_rows(self, rows: Any) -> None:
        self.proof["rows"] = packed(rows, "<i4")

    def claim(self, **values: Any) -> None:
        for record in (self.proof, self.document["result"]["certificate"]):
            record.update(values)

    # Kinds of forgeries.

    def moved_obstacle(self) -> None:
        one = self.chance.choice(self.scene.obstacles)
        x, y, z = (p + self.chance.gauss(0.0, 0.05) for p in one.pose.position)
        moved = replace(one, pose=Pose((x, y, z), one.pose.quaternion))
        self.put(replace(self.scene, obstacles=tuple(moved if o is one else o for o in self.scene.obstacles)))

    def larger_obstacle(self) -> None:
        one, more = self.chance.choice(self.scene.obstacles), 1.0 + abs(self.chance.gauss(0.0, 0.5))
        shape: Any = one.shape
        if isinstance(shape, Box):
            shape = Box(tuple(more * x for x in shape.size))  # type: ignore[arg-type]
        elif isinstance(shape, Sphere):
            shape = Sphere(more * shape.radius)
        else:
            shape = replace(shape, radius=more * shape.radius)
        grown = replace(one, shape=shape)
        self.put(replace(self.scene, obstacles=tuple(grown if o is one else o for o in self.scene.obstacles)))

    def added_obstacle(self) -> None:
        s = self.chance.uniform(0.0, self.path.length)
        at = self.base.robot.tool_pose(self.path(s))[:3, 3].tolist()
        x, y, z = (v + self.chance.gauss(0.0, 0.15) for v in at)
        shape = self.chance.choice((Box((0.04, 0.04, 0.04)), Sphere(0.03), Cylinder(0.02, 0.05)))
        self.put(self.scene.with_obstacle(Obstacle("another", shape, Pose((x, y, z)))))

    def dropped_obstacle(self) -> None:
        """What is in the trail is renumbered by that: the rest of it belongs to other pieces."""
        one = self.chance.choice(self.scene.obstacles)
        self.put(replace(self.scene, obstacles=tuple(o for o in self.scene.obstacles if o is not one)))

    def moved_waypoint(self) -> None:
        points, k = self.path.waypoints.copy(), self.chance.randrange(len(self.path.waypoints))
        points[k] += np.array([self.chance.gauss(0.0, 0.1) for _ in points[k]])
        self.put_path(points)

    def cut_corner(self) -> None:
        points = self.path.waypoints
        keep = np.ones(len(points), dtype=bool)
        if len(points) > 2:
            keep[self.chance.randrange(1, len(points) - 1)] = False
        self.put_path(points[keep])

    def put_path(self, points: Any) -> None:
        try:
            self.path = JointPath(points)
        except InvalidRequest:
            return
        record = {"length": self.path.length, "waypoints": points.tolist(), "blends": [0.0] * len(points)}
        self.document["result"]["path"] = record
        s = unpacked(self.proof["s"], "<f8", 1)[:, 0]
        self.proof["s"] = packed(s * (self.path.length / s[-1]) if s[-1] > 0.0 else s, "<f8")

    def raised_claim(self) -> None:
        if math.isfinite(self.claimed):
            self.claim(clearance=self.claimed + 10.0 ** self.chance.uniform(-7.0, -2.0))

    def raised_certificate(self) -> None:
        """In the certificate alone."""
        certificate = self.document["result"]["certificate"]
        certificate["clearance"] = self.claimed + 10.0 ** self.chance.uniform(-7.0, -2.0)

    def narrowed_limits(self) -> None:
        limits, joint = self.document["robot"]["limits"], self.chance.randrange(self.path.n)
        values = self.path.waypoints[:, joint]
        limits["upper"][joint] = float(self.chance.uniform(values.min(), values.max() + 0.1))

    def dropped_rows(self) -> None:
        rows = self.rows()
        keep = np.array([self.chance.random() > 0.02 for _ in rows])
        self.put_rows(rows[keep])

    def dropped_pair(self) -> None:
        rows = self.rows()
        self.put_rows(rows[rows[:, 0] != self.chance.choice(rows[:, 0].tolist())])

    def stretched(self) -> None:
        rows = self.rows()
        k = self.chance.randrange(len(rows))
        rows[k, 2] = min(rows[k, 2] + self.chance.randint(1, 9), rows[:, 2].max())
        others = (rows[:, 0] == rows[k, 0]) & (rows[:, 1] < rows[k, 2]) & (rows[:, 1] >= rows[k, 1])
        others[k] = False
        self.put_rows(rows[~others])

    def turned_direction(self) -> None:
        rows = self.rows()
        k = self.chance.randrange(len(rows))
        off = np.array([self.chance.gauss(0.0, 0.5) for _ in range(6)])
        n = (rows[k, 3:] / 2.0**30 + off).reshape(2, 3)
        rows[k, 3:] = np.rint(n / np.linalg.norm(n, axis=1)[:, None] * 2**30).ravel()
        self.put_rows(rows)

    def long_direction(self) -> None:
        rows = self.rows()
        k = self.chance.randrange(len(rows))
        rows[k, 3:] = np.clip(rows[k, 3:] * self.chance.uniform(1.001, 1.9), -(2**31), 2**31 - 1)
        self.put_rows(rows)

    def other_pair(self) -> None:
        pairs = unpacked(self.proof["pairs"], "<i4", 3).copy()
        k, column = self.chance.randrange(len(pairs)), self.chance.randrange(3)
        pairs[k, column] += self.chance.choice((-1, 1))
        self.proof["pairs"] = packed(pairs, "<i4")

    def moved_places(self) -> None:
        s = unpacked(self.proof["s"], "<f8", 1)[:, 0].copy()
        k = self.chance.randrange(len(s))
        s[k] += self.chance.gauss(0.0, 0.02)
        self.proof["s"] = packed(np.sort(np.clip(s, 0.0, s.max())), "<f8")


KINDS: tuple[Callable[[_Forger], None], ...] = (
    *(_Forger.moved_obstacle, _Forger.larger_obstacle, _Forger.added_obstacle, _Forger.dropped_obstacle),
    *(_Forger.moved_waypoint, _Forger.cut_corner, _Forger.raised_claim, _Forger.raised_certificate),
    *(_Forger.narrowed_limits, _Forger.dropped_rows, _Forger.dropped_pair, _Forger.stretched),
    *(_Forger.turned_direction, _Forger.long_direction, _Forger.other_pair, _Forger.moved_places),
)


def run(queries: int | None, seed: int) -> Report:
    """Judge so many forgeries, of all kinds in turn."""
    rows = tuple(_forged(queries or FORGERIES, seed))
    false = [row for row in rows if row["false"]]
    accepted = [row for row in false if row["accepted"]]
    elsewhere = [row for row in false if row["where"] == ELSEWHERE]
    promises = (
        Promise(f"no false claim of {len(false):,} is accepted", f"{len(accepted)} are", not accepted),
        Promise("each is refused at all pairs and places at which it is false", f"{len(elsewhere)} not", not elsewhere),
    )
    return Report("evidence", rows, (_table(rows),), promises)


def _forged(count: int, seed: int) -> Iterator[Row]:
    chance = random.Random(f"forgeries {seed}")
    usable = (_Base(service, plan) for _, service, plan in plans(10 * PLANS, seed) if _usable(plan))
    bases = list(islice(filter(_short, usable), PLANS))
    for number in range(count):
        kind = KINDS[(number // len(bases)) % len(KINDS)]
        forger = _Forger(bases[number % len(bases)], chance)
        kind(forger)
        yield _judged(kind.__name__, forger)


def _usable(plan: SavedPlan) -> bool:
    certificate = plan.result.certificate
    return certificate is not None and certificate.clearance < MOST_CLEARANCE and not certificate.kept


def _short(base: _Base) -> bool:
    (proof,) = json.loads(base.text)["sections"][EVIDENCE]["proofs"]
    return len(unpacked(proof["rows"], "<i4", 9)) <= MOST_ROWS


THERE, ELSEWHERE, WHOLE = "there", "elsewhere", "whole"
"""Where a false claim is refused: at all pairs and places at which it is false; at others alone; as a whole file."""


def _judged(kind: str, forger: _Forger) -> Row:
    document, faults = forger.sealed(), list[tuple[Any, ...]]()
    try:
        list(verify(document))
        why = ""
    except Invalid as refused:
        why = str(refused)
        if isinstance(refused.__cause__, Invalid):
            (_, *found) = refused.__cause__.args
            faults = found[0] if found else []
    false, nearer = _truth(forger)
    where = ""
    if false and why:
        there = all(any(_holds(fault, near) for fault in faults) for near in nearer)
        where = WHOLE if not faults else THERE if there else ELSEWHERE
    return {"kind": kind, "accepted": not why, "false": false, "where": where, "why": why[:120]}


def _holds(fault: tuple[Any, ...], near: Near) -> bool:
    start, _, end, *names = fault
    return start - 1e-9 <= near.s <= end + 1e-9 and {*names} == {*near.names}


def _truth(forger: _Forger) -> tuple[bool, list[Near]]:
    """Whether the claim is false, and what is nearer than claimed."""
    base, path, limits = forger.base, forger.path, forger.document["robot"]["limits"]
    bounds = np.array([limits["lower"], limits["upper"]])
    if not ((path.waypoints >= bounds[0] - 1e-9) & (path.waypoints <= bounds[1] + 1e-9)).all():
        return True, []
    claimed = float(forger.document["result"]["certificate"]["clearance"]) - MARGIN
    if path is base.path and forger.scene is base.scene:
        nearer = [base.nearest] if base.nearest is not None and base.nearest.gap < claimed else []
    else:
        nearness, s = base.nearness.among(forger.scene), np.linspace(0.0, path.length, SAMPLES).astype(np.float64)
        nearer = list(nearness.nearer(base.places if path is base.path else nearness.along(path, s), claimed))
    return bool(nearer), nearer


def _table(rows: tuple[Row, ...]) -> Table:
    def count(group: list[Row], **asked: Any) -> str:
        return f"{sum(all(row[key] == value for key, value in asked.items()) for row in group):,}"

    lines = [
        {
            "forgery": kind.replace("_", " "),
            "count": f"{len(group):,}",
            "false": count(group, false=True),
            "accepted": count(group, false=True, accepted=True),
            **{f"refused {where}": count(group, false=True, where=where) for where in (THERE, ELSEWHERE, WHOLE)},
            "true, refused": count(group, false=False, accepted=False),
            "true, accepted": count(group, false=False, accepted=True),
        }
        for kind, group in grouped(rows, "kind").items()
    ]
    caption = (
        "false: a pair is nearer than claimed, by Coal along the curve, or a joint outside its limits. there: refused "
        "for each pair and stretch of which it is false. whole: for limits, certificate or form. What is true but not "
        "shown by the trail is refused, too"
    )
    return table_of("Forged evidence", lines, caption=caption)
