"""Looks for what is false in the plan of a cell by sampling, with Pinocchio and Coal: a judge of ``verify_cell``.

Each arm is placed by itself, in its own base's frame, and arms are late by random amounts at every moment, and by all
that is claimed, the one or the other. It finds no proof, only objections.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from auditor.sampling import MEANT, NEAR, Arm, Body, beyond, curve, distance, elsewhere, matrix

__all__ = ["cell_objections"]

Array = Any
Json = Any

SAME = 1e-6  # radians or metres by which a motion may begin elsewhere than its arm stands


class Placed(NamedTuple):
    """A robot of the cell: what places it, its base, its joints in the whole, and how the names of its links begin."""

    arm: Arm
    base: Array
    columns: list[int]
    prefix: str
    bodies: list[Body]


class Run(NamedTuple):
    """A motion: which joints of the whole it moves, when it starts, and where it is at which times."""

    arms: list[str]
    columns: list[int]
    start: float
    times: Array
    q: Array


def cell_objections(document: Json, samples: int = 60, seed: int = 0) -> list[str]:
    """What was found to be false."""
    return list(_objections(document, samples, np.random.default_rng(seed)))


def _objections(document: Json, samples: int, rng: np.random.Generator) -> Iterator[str]:
    still, scene = np.array(document["still"], float), document["scene"]["obstacles"]
    robots, columns = list[Placed](), dict[str, list[int]]()
    one = "joints" in document["arms"][0]
    for each in document["arms"]:
        record = document["robots"][each["robot"]]
        names = record["joint_names"]
        if one:
            columns[each["name"]] = sorted(names.index(joint) for joint in each["joints"])
        else:
            begin = sum(len(those.columns) for those in robots)
            columns[each["name"]] = [*range(begin, begin + len(names))]
        if each.get("carried"):
            yield "what arms carry is not looked at"
        if not one or not robots:
            arm, base = Arm(record), np.eye(4) if one else matrix(each["base"])
            own = [*range(len(names))] if one else columns[each["name"]]
            prefix = "" if one else f"{each['name']}_"
            robots.append(Placed(arm, base, own, prefix, arm.bodies([], [], record["gripper_width"])))
    if len(still) != sum(len(each.columns) for each in robots):
        yield "places of other joints"
        return
    runs = []
    for clock in document["clocks"]:
        name, shared = " and ".join(clock["arms"]), len(clock["arms"]) > 1
        own = [*range(len(still))] if shared else columns[clock["arms"][0]]
        s, Q = curve(clock["result"]["path"], 400)
        if np.abs(Q[0] - still[own]).max() > SAME:
            yield f"{name}: begins elsewhere than it stands"
        record = _limits(robots, own)
        yield from beyond(record, clock["request"], clock["result"], Q, name)
        if clock["request"] is not None:
            arm = next(each.arm for each in robots if {*own} <= {*each.columns} or shared)
            asked = clock["request"] | {
                "goals": [goal if "joints" in goal else {} for goal in clock["request"]["goals"]]
            }
            yield from (f"{name}: {each}" for each in elsewhere(arm, asked, clock["result"], Q[0], Q[-1]))
        law = clock["result"]["trajectory"]
        h, c = np.array(law["durations"], float), np.array(law["coefficients"], float).reshape(-1, 4)
        times = np.linspace(0.0, h.sum(), 400)
        piece = np.clip(np.searchsorted(np.cumsum(h), times, side="right"), 0, max(len(h) - 1, 0))
        at = (c[piece] * (times - (np.cumsum(h) - h)[piece])[:, None] ** np.arange(4)).sum(axis=1) if len(h) else times
        q = np.column_stack([np.interp(at, s, column) for column in Q.T])
        runs.append(Run(clock["arms"], own, clock["start"], times, q))
    late = math.inf if document["tolerates"] is None else document["tolerates"]
    seen = set[frozenset[str]]()
    for q, where in _places(runs, still, columns, min(late, 20.0), samples, rng):
        yield from _touching(document, robots, columns, scene, q, where, seen)


def _limits(robots: Sequence[Placed], own: Sequence[int]) -> Json:
    """Limits of some joints of the whole."""
    keys = ("lower", "upper", "velocity", "acceleration")
    records = [each.arm.robot for each in robots]
    limits = {key: np.array([x for r in records for x in r["limits"][key]])[[*own]].tolist() for key in keys}
    endless = [x for r in records for x in (r.get("continuous") or [False] * len(r["joint_names"]))]
    return {"limits": limits, "continuous": [endless[k] for k in own]}


def _places(
    runs: Sequence[Run],
    still: Array,
    columns: dict[str, list[int]],
    late: float,
    samples: int,
    rng: np.random.Generator,
) -> Iterator[tuple[Array, str]]:
    """Joints of the whole at moments, with arms that are late."""
    end = max(run.start + run.times[-1] for run in runs) + late
    arms = [name for run in runs for name in run.arms]
    for _ in range(6 * samples):
        t = rng.uniform(0.0, end)
        behind = {name: float(rng.choice((0.0, late, rng.uniform(0.0, late)))) for name in arms}
        q = still.copy()
        for run in runs:
            for name in run.arms:
                own = columns[name]
                x = np.clip(t - run.start - behind[name], 0.0, run.times[-1])
                at = [run.columns.index(column) for column in own]
                q[own] = [np.interp(x, run.times, run.q[:, column]) for column in at]
        yield q, f"t = {t:.4g} s, late by {', '.join(f'{x:.4g}' for x in behind.values())} s"


def _touching(
    document: Json,
    robots: Sequence[Placed],
    columns: dict[str, list[int]],
    scene: Json,
    q: Array,
    where: str,
    seen: set[frozenset[str]],
) -> Iterator[str]:
    """Pairs that are nearer than is claimed."""
    rows = list[tuple[str, Body, Array, frozenset[str], Any]]()
    may = set[frozenset[str]]()
    for number, each in enumerate(robots):
        frames = each.arm.frames(q[each.columns])
        bodies = each.arm.robot["bodies"]
        may |= {frozenset(each.prefix + link for link in it["links"]) for it in each.arm.robot["allowed_contacts"]}
        for body in each.bodies:
            moved, k = set(), body.link
            while k > 0:
                column = each.columns[bodies[k]["q_index"]]
                moved |= {name for name, own in columns.items() if column in own}
                k = bodies[k]["parent"]
            at = each.base @ frames[body.link] @ body.at
            home = (number, body.link) if body.link > 0 else 0
            rows.append((each.prefix + body.owner[1], body, at, frozenset(moved), home))
    standing = Arm.bodies(robots[0].arm, scene, [], document["robots"][0]["gripper_width"])
    rows += [(body.owner[1], body, body.at, frozenset(), 0) for body in standing if body.owner[0] == "object"]
    clocks = [({*clock["arms"]}, clock["result"]["certificate"]) for clock in document["clocks"]]
    between = {frozenset(each["arms"]): each["clearance"] for each in document["sections"]["evidence"]["between"]}
    middles, radii = np.array([row[2][:3, 3] for row in rows]), np.array([row[1].radius for row in rows])
    moving = {name for own, _ in clocks for name in own}
    for i, j in combinations(range(len(rows)), 2):
        (a, one, A, by, home), (b, two, B, others, there) = rows[i], rows[j]
        pair = frozenset((a, b))
        if a == b or home == there or pair in may or pair in seen:
            continue
        movers = (by | others) & moving
        claims = [claim["clearance"] for own, claim in clocks if movers <= own]
        if frozenset(movers) in between:  # arms that share a clock are late, too
            claims = [between[frozenset(movers)]]
        near = max((1e9 if claim is None else claim for claim in claims), default=0.0)
        if np.linalg.norm(middles[i] - middles[j]) - radii[i] - radii[j] > min(near, 1.0):
            continue
        if len(movers) < 2 and any(pair in map(frozenset, e["pairs"]) for _, c in clocks for e in c["exempt"]):
            near = -MEANT
        gap = distance(one, A, two, B)
        if gap < near - NEAR:
            seen.add(pair)
            yield f"{a} x {b}: {1e3 * gap:.3f} mm at {where}, {1e3 * near:.3f} mm claimed"
