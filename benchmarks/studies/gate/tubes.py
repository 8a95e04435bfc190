"""Ways with as much room as is still proven: nothing in it touches, however Coal is asked about its corners."""

from __future__ import annotations

from itertools import count

import numpy as np

from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, p50, table_of
from benchmarks.studies.gate.judge import Judge
from benchmarks.studies.gate.worlds import ROBOTS, world
from planner_service.certify import Certifier
from planner_service.geometry.arrays import FloatArray

__all__ = ["run"]

TUBES = 50
"""Of each robot, where no other number is asked for."""

EDGE, ROOM = (0.0, 0.4), 0.6
"""Radians (or metres) that a way moves each joint, and that its room is for a joint, at most."""

EDGES, BEND = (1, 2, 5, 20), 0.003
"""Into how many edges a way is divided, and radians (or metres) by which it is bent where two of them meet, at most."""

SINGLE = 0.3
"""Share of the tubes of which some joints have no room."""

PLACES, CLIMBS, DRAWS = 7, 3, 6
"""Places of a way that are looked at, steps from corner to corner towards contact, and corners that are drawn."""

HALVINGS = 14


def run(queries: int | None, seed: int, robot: str | None, _: Kept = NONE) -> Report:
    """Tubes near contact."""
    wanted = TUBES if queries is None else queries
    rows = [_attacked(name, wanted, seed) for name in (ROBOTS if robot is None else (robot,))]
    lines = [
        {
            "robot": row["robot"],
            "tubes": row["tubes"],
            "corners": f"{row['corners']:,}",
            "that touch": row["touching"],
            "nearest, mm": f"{row['least_gap'] * 1e3:.3f}",
            "room that is proven of what is free, p50": f"{row['proven_share']:.2f}",
        }
        for row in rows
    ]
    touching, tubes = (sum(row[key] for row in rows) for key in ("touching", "tubes"))
    text = f"nothing touches in {tubes:,} tubes with as much room as is proven"
    promise = Promise(text, f"{touching} touch", touching == 0)
    return Report("gate", tuple(rows), (table_of("Tubes", lines),), (promise,))


def _attacked(name: str, wanted: int, seed: int) -> Row:
    least, corners, touching, shares, at = np.inf, 0, 0, list[float](), list[list[float]]()
    for number in count():
        if len(shares) >= wanted:
            break
        rng = np.random.default_rng([seed, number])
        place = world(name, seed, number).near_contact(rng)
        certifier, judge = Certifier(place.service.robot, place.service.scene), place.judge
        lower, upper = place.service.robot.bounds
        start = np.clip(place.start, lower, upper)
        end = np.clip(start + rng.uniform(*EDGE) * rng.uniform(-1.0, 1.0, place.n), lower, upper)
        shape = rng.uniform(0.0, 1.0, place.n) * (rng.random(place.n) > (SINGLE if rng.random() < SINGLE else -1.0))
        edges = int(rng.choice(EDGES))
        way = start + np.linspace(0.0, 1.0, edges + 1)[:, None] * (end - start)
        way[1:-1] = np.clip(way[1:-1] + BEND * rng.uniform(-1.0, 1.0, (edges - 1, place.n)), lower, upper)
        scale = _proven(certifier, way, shape)
        if scale <= 0.0:
            continue
        gap, q, asked = _searched(judge, way, scale * shape, rng)
        corners += asked
        least = min(least, gap)
        if gap <= 0.0:
            touching += 1
            at.append(q.tolist())
        shares.append(_share(judge, way, shape, scale, rng))
    row: Row = {"part": "tubes", "robot": name, "tubes": len(shares), "corners": corners, "touching": touching}
    return row | {"least_gap": least, "proven_share": p50(shares), "at": at}


def _proven(certifier: Certifier, way: FloatArray, shape: FloatArray) -> float:
    """The largest scale of a room beside all edges of a way (k + 1, n) that is proven free, about; 0 if none is."""
    free, not_free, rooms = 0.0, ROOM, np.tile(shape, (len(way) - 1, 1))
    for _ in range(HALVINGS):
        middle = 0.5 * (free + not_free)
        if certifier.certify_tubes(way[:-1], way[1:], middle * rooms).free == len(rooms):
            free = middle
        else:
            not_free = middle
    return free


def _searched(
    judge: Judge, way: FloatArray, room: FloatArray, rng: np.random.Generator
) -> tuple[float, FloatArray, int]:
    """The smallest gap that is found in the room, where, and how many corners were looked at."""
    at_edges, known = np.linspace(0.0, len(way) - 1.0, PLACES), np.arange(len(way))
    line = np.stack([np.interp(at_edges, known, joint) for joint in way.T], axis=1)
    gaps = [judge.gap(q) for q in line]
    best, at, asked = min(gaps), line[int(np.argmin(gaps))], 0
    for k in np.argsort(gaps)[:2]:
        middle, q = line[k], line[k]
        tried = [middle + room * rng.choice((-1.0, 1.0), len(room)) for _ in range(DRAWS)]
        for _ in range(CLIMBS):
            q = middle - np.sign(judge.slope(q)) * room
            tried.append(q)
        for each in tried:
            asked += 1
            gap = judge.gap(each)
            if gap < best:
                best, at = gap, each
    return best, at, asked


def _share(judge: Judge, way: FloatArray, shape: FloatArray, scale: float, rng: np.random.Generator) -> float:
    """What is proven of the room that seems free."""
    seems = scale
    while seems < 8.0 * scale and _searched(judge, way, 1.25 * seems * shape, rng)[0] > 0.0:
        seems *= 1.25
    return scale / seems
