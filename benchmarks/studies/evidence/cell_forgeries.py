"""Forged plans of cells, over both clocks: their author changed what they mean, and worked out every digest anew.

Half of them change one thing by its meaning, half a field of the file, each in turn. What the verifier accepts is
judged by ``auditor.sampling_cell``: Pinocchio places the arms, late by all that is claimed, and Coal measures. Honest
plans must be accepted.
"""

from __future__ import annotations

import json
import math
import random
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from functools import lru_cache
from typing import Any

import numpy as np
from rich.table import Table

import planner_service as ps
from auditor.__main__ import judged
from auditor.sampling_cell import cell_objections
from auditor.schema import Invalid
from auditor.trails import digest, unpacked
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.evidence.forgeries import change_field, field, leaves, table_of_forgeries
from planner_service.cell import Arm, Cell, CellPlan, OwnClock
from planner_service.records.cells import with_cell_evidence
from planner_service.records.evidence import packed

__all__ = ["honest_cells", "run"]

FORGERIES = 4_000
"""More than half of them say what is not so, or show it no more; the others are still true."""
HONEST = 40
"""Random plans that must be accepted."""

SAMPLES = 12
HEAVY = 0.08
"""Share of forgeries of plans of real arms, whose evidence takes ten times as long to check."""

Document = dict[str, Any]
Change = Callable[[Document, random.Random], None]


def planar() -> Cell:
    """Two planar arms that face each other."""
    robot = ps.load_robot("planar2")
    return Cell({"left": robot, "right": Arm(robot, ps.Pose((2.2, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))}, ps.Scene())


@lru_cache(maxsize=1)
def honest_cells() -> dict[str, Document]:
    """Plans with evidence: of arms that wait, share a clock, or stand, and of real ones."""
    cell = planar()
    leaves_ = ps.PlanRequest([0.0, 0.1], [1.5, 0.1], velocity_scale=0.2)
    waits = cell.plan({"left": leaves_, "right": ps.PlanRequest([0.6, 0.1], [-0.6, 0.1])}, delay=0.1)
    start, goal = np.array([0.3, 0.1, 0.3, 0.1]), np.array([0.8, 0.1, 0.0, 0.1])
    one = cell.service.plan(ps.PlanRequest(start, goal))
    clock = OwnClock(("left", "right"), one, 0.0, ((0, 1), (2, 3)))
    shared = CellPlan((clock,), 0.05, None, start, layout=cell.layout)
    post = ps.Scene((ps.Obstacle("post", ps.Box((0.1, 0.1, 0.1)), ps.Pose((1.0, -0.6, 0.0))),))
    stands = Cell(cell.layout.arms, post).plan(
        {"left": ps.PlanRequest([0.3, 0.1], [1.5, 0.1])}, standing={"right": [-0.1, 0.1]}
    )
    robot = ps.load_robot("wxai")
    places = {side: Arm(robot, ps.Pose((0.0, y, 0.0))) for side, y in (("left", 0.2), ("right", -0.2))}
    rows = ([-0.6, 1.4, 1.2, -0.8, 0.0, 0.0], [0.5, 1.4, 1.2, -0.8, 0.0, 0.0])
    others = ([-0.5, 1.4, 1.2, -0.8, 0.0, 0.0], [0.6, 1.4, 1.2, -0.8, 0.0, 0.0])
    requests = {"left": ps.PlanRequest(*rows, velocity_scale=0.1), "right": ps.PlanRequest(*others)}
    arms = Cell(places, "table").plan(requests, delay=0.1)
    plans = {"waits": waits, "shared clock": shared, "one stands": stands, "WidowX AI": arms}
    return {name: json.loads(with_cell_evidence(plan).file_text()) for name, plan in plans.items()}


def sealed(document: Document) -> Document:
    """The file with its digests made right, as far as it is one."""
    evidence = document["sections"]["evidence"]
    evidence["robots"] = [digest(robot) for robot in document["robots"]]
    evidence["scene"] = digest(document["scene"])
    return document


# Changes by meaning.


def _between(document: Document) -> Any:
    return document["sections"]["evidence"]["between"][0]


def _rows(document: Document) -> Any:
    return unpacked(_between(document)["rows"], "<i4", 8).copy()


def _put(document: Document, rows: Any) -> None:
    _between(document)["rows"] = packed(rows, "<i4")


def move_a_clock(document: Document, chance: random.Random) -> None:
    chance.choice(document["clocks"])["start"] += chance.choice((-1.0, 1.0)) * 10.0 ** chance.uniform(-2.0, 1.0)


def enlarge_the_delay(document: Document, chance: random.Random) -> None:
    document["tolerates"] = chance.choice((None, (document["tolerates"] or 0.0) + 10.0 ** chance.uniform(-2.5, 1.0)))


def swap_arms(document: Document, chance: random.Random) -> None:
    kind = chance.randrange(4)
    if kind == 0:
        document["arms"].reverse()
    elif kind == 1:
        one, two = document["arms"]
        one["base"], two["base"] = two["base"], one["base"]
    elif kind == 2:
        document["clocks"][0]["arms"].reverse()
        _between(document)["arms"].reverse()
    else:
        one, two = document["clocks"]
        key = chance.choice(("arms", "result", "start"))
        one[key], two[key] = two[key], one[key]


def leave_out_windows(document: Document, chance: random.Random) -> None:
    rows = _rows(document)
    at = chance.randrange(len(rows))
    kind = chance.randrange(3)
    if kind == 0:
        keep = [k != at for k in range(len(rows))]
    elif kind == 1:
        keep = (rows[:, 0] != rows[at, 0]).tolist()
    else:
        keep = [chance.random() > 0.1 for _ in rows]
    _put(document, rows[keep])


def stretch_windows(document: Document, chance: random.Random) -> None:
    """Fewer rows that reach farther, or other times of the same rows."""
    if chance.random() < 0.5:
        rows = _rows(document)
        at, side = chance.randrange(len(rows)), chance.choice((1, 3))
        rows[at, side : side + 2] = (0, int(rows[:, side + 1].max()))
        _put(document, rows[rows[:, 0] != rows[at, 0]] if chance.random() < 0.3 else rows[[at]])
        return
    times = _between(document)["times"]
    k = chance.randrange(2)
    table = unpacked(times[k], "<f8", 1)[:, 0].copy()
    table[1:-1] = table[-1] * np.sort([chance.random() for _ in table[1:-1]])
    times[k] = packed(table, "<f8")


def turn_directions(document: Document, chance: random.Random) -> None:
    rows = _rows(document)
    some = [chance.random() < chance.choice((0.02, 1.0)) for _ in rows]
    n = np.array([[chance.gauss(0.0, 1.0) for _ in range(3)] for _ in rows])
    rows[some, 5:] = np.rint(n / np.linalg.norm(n, axis=1)[:, None] * 2**30).astype(np.int64)[some]
    _put(document, rows)


def move_a_base(document: Document, chance: random.Random) -> None:
    pose = chance.choice(document["arms"])["base"]
    if chance.random() < 0.7:
        pose["position"][chance.randrange(3)] += chance.choice((-1.0, 1.0)) * 10.0 ** chance.uniform(-2.0, 0.0)
    else:
        turn = chance.uniform(0.05, 3.0)
        pose["quaternion_wxyz"] = [math.cos(turn), 0.0, 0.0, math.sin(turn)]


def change_geometry(document: Document, chance: random.Random) -> None:
    shape = chance.choice(chance.choice(document["robots"])["shapes"])["shape"]
    factor = chance.choice((0.1, 0.5, 1.5, 4.0))
    for key in ("radius", "length"):
        if key in shape:
            shape[key] *= factor
    if "size" in shape:
        shape["size"] = [factor * x for x in shape["size"]]


def keep_old_digests(document: Document, chance: random.Random) -> None:
    """Geometry shrunk under the digests of the real robot."""
    before = deepcopy(document["sections"]["evidence"])
    change_geometry(document, chance)
    sealed(document)
    document["sections"]["evidence"] |= {"robots": before["robots"], "kept": True}


def claim_more(document: Document, chance: random.Random) -> None:
    more = 10.0 ** chance.uniform(-4.0, 0.0)
    k = chance.randrange(len(document["clocks"]) + 1)
    if k == len(document["clocks"]):
        _between(document)["clearance"] += more
        return
    claims = document["clocks"][k]["result"]["certificate"], document["sections"]["evidence"]["proofs"][k]
    for claim in claims[: chance.choice((1, 2))]:
        claim["clearance"] = (claim["clearance"] or 0.0) + more


def retime(document: Document, chance: random.Random) -> None:
    """A motion that is faster or slower all along, or that stands still for a while on its way."""
    result = chance.choice(document["clocks"])["result"]
    law, factor = result["trajectory"], chance.choice((0.3, 0.8, 0.95, 1.1, 2.0))
    if chance.random() < 0.7:
        law["durations"] = [h * factor for h in law["durations"]]
        law["coefficients"] = [[c / factor**p for p, c in enumerate(row)] for row in law["coefficients"]]
    else:
        at = chance.randrange(len(law["durations"]))
        law["durations"].insert(at, chance.uniform(0.05, 2.0))
        law["coefficients"].insert(at, [law["coefficients"][at][0], 0.0, 0.0, 0.0])
    law["duration"] = result["motion"]["duration"] = sum(law["durations"])


def bend_a_path(document: Document, chance: random.Random) -> None:
    points = chance.choice(document["clocks"])["result"]["path"]["waypoints"]
    row = chance.choice(points)
    row[chance.randrange(len(row))] += chance.choice((-1.0, 1.0)) * 10.0 ** chance.uniform(-2.0, 0.3)


def stand_elsewhere(document: Document, chance: random.Random) -> None:
    document["still"][chance.randrange(len(document["still"]))] += chance.choice((-1.0, 1.0)) * chance.uniform(
        0.01, 1.0
    )


def let_one_stand(document: Document, chance: random.Random) -> None:
    """A motion taken out, its arm said to stand."""
    k = chance.randrange(len(document["clocks"]))
    del document["clocks"][k], document["sections"]["evidence"]["proofs"][k]
    document["sections"]["evidence"]["between"] = []


def leave_out_a_proof(document: Document, chance: random.Random) -> None:
    evidence = document["sections"]["evidence"]
    key = chance.choice(("between", "proofs"))
    evidence[key] = [] if chance.random() < 0.5 else evidence[key] * 2


def exempt(document: Document, chance: random.Random) -> None:
    """A pair that is not judged on a stretch of a motion."""
    k = chance.randrange(len(document["clocks"]))
    clock, proof = document["clocks"][k], document["sections"]["evidence"]["proofs"][k]
    links = [f"{arm['name']}_{shape['link']}" for arm in document["arms"] for shape in document["robots"][0]["shapes"]]
    stretch = {"s_start": 0.0, "s_end": clock["result"]["path"]["length"], "pairs": [chance.sample(links, 2)]}
    for claim in (clock["result"]["certificate"], proof):
        claim["exempt"] = [*claim["exempt"], {**stretch, "reason": "meant"}]


def say_an_unknown_word(document: Document, chance: random.Random) -> None:
    evidence = document["sections"]["evidence"]
    holders = [
        document,
        document["clocks"][0],
        document["arms"][0],
        evidence,
        *evidence["between"],
        *evidence["proofs"],
    ]
    chance.choice(holders)[chance.choice(("waits", "late", "allowed", "skip", "lead"))] = chance.choice((0.5, True, []))


def change_the_world(document: Document, chance: random.Random) -> None:
    """One more thing in the way, or what stands elsewhere."""
    obstacles = document["scene"]["obstacles"]
    if obstacles and chance.random() < 0.5:
        chance.choice(obstacles)["pose"]["position"][chance.randrange(3)] += chance.choice((-0.5, -0.2, 0.2, 0.5))
        return
    at = {
        "position": [chance.uniform(-0.2, 1.5), chance.uniform(-0.6, 0.6), 0.0],
        "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0],
    }
    obstacles.append({"name": "ball", "shape": {"kind": "sphere", "radius": 0.05}, "pose": at})


CHANGES: tuple[Change, ...] = (
    *(move_a_clock, enlarge_the_delay, swap_arms, leave_out_windows, stretch_windows, turn_directions, move_a_base),
    *(change_geometry, keep_old_digests, claim_more, retime, bend_a_path, stand_elsewhere, let_one_stand),
    *(leave_out_a_proof, exempt, say_an_unknown_word, change_the_world),
)


def run(queries: int | None, seed: int) -> Report:
    """Forge so many plans of cells, and check honest ones."""
    chance, files = random.Random(seed), honest_cells()
    rows = [*_honest(files, HONEST if queries is None else max(1, queries // 50), seed)]
    rows += _forged(files, FORGERIES if queries is None else queries, chance)
    forged = [row for row in rows if row["kind"] != "honest"]
    false = [row for row in forged if row["false"]]
    honest = [row for row in rows if row["kind"] == "honest"]
    refused = [row for row in honest if row["why"]]
    true = sum(not row["why"] and row["changed"] and not row["false"] for row in forged)
    promises = (
        Promise(f"no forged plan of a cell is accepted, of {len(forged):,}", f"{len(false)}", not false),
        Promise(f"honest ones are accepted, of {len(honest)}", f"{len(honest) - len(refused)}", not refused),
    )
    note = f"{true} changed files were accepted that say something else, which holds"
    odd = [*false, *refused]
    tables = (_table(forged, note), _reasons(forged), *([_odd(odd)] if odd else []))
    return Report("evidence", tuple(rows), tables, promises)


def _honest(files: dict[str, Document], count: int, seed: int) -> Iterator[Row]:
    """The files that are forged, and plans of random queries of two planar arms."""
    rng, cell = np.random.default_rng(seed), planar()
    documents = list(files.items())
    while len(documents) < count:
        ends = rng.uniform(-1.2, 1.2, (2, 4))
        if not all(cell.service.checker.state_is_free(q) for q in ends):
            continue
        requests = {name: ps.PlanRequest(cell.of_arm(name, ends[0]), cell.of_arm(name, ends[1])) for name in cell.arms}
        plan = cell.plan(requests, delay=float(rng.uniform(0.0, 0.1)))
        if plan.ok:
            documents.append((f"random {len(documents)}", json.loads(with_cell_evidence(plan).file_text())))
    for name, document in documents:
        yield {"kind": "honest", "file": name, "why": _why(document), "false": "", "changed": False}


def _why(document: Document) -> str:
    """Why the verifier refuses a file; empty if it accepts it."""
    try:
        list(judged(document))
    except Invalid as refused:
        return str(refused)[:160] or "refused"
    return ""


def _forged(files: dict[str, Document], count: int, chance: random.Random) -> Iterator[Row]:
    light = [name for name in files if name != "WidowX AI"]
    fields: dict[str, dict[Any, list[Any]]] = {}
    for name, document in files.items():
        for place in leaves(document):
            fields.setdefault(name, {}).setdefault(field(place), []).append(place)
    turns: Counter[str] = Counter()
    for number in range(count):
        name = "WidowX AI" if chance.random() < HEAVY else chance.choice(light)
        document = deepcopy(files[name])
        if number % 2:
            keys = list(fields[name])
            places = fields[name][keys[turns[name] % len(keys)]]
            turns[name] += 1
            change_field(document, chance.choice(places), chance)
            kind = "field"
        else:
            change = CHANGES[turns["kind"] % len(CHANGES)]
            turns["kind"] += 1
            kind = change.__name__
            try:
                change(document, chance)
            except (KeyError, IndexError, TypeError, ValueError):  # a file without what this changes
                change_field(document, chance.choice([p for own in fields[name].values() for p in own]), chance)
                kind = "field"
        yield _judged(kind, name, document, files[name])


def _judged(kind: str, name: str, document: Document, base: Document) -> Row:
    kept = kind == "keep_old_digests" and document["sections"]["evidence"].pop("kept", False)
    try:
        document = json.loads(json.dumps(document if kept else sealed(document)))
    except (KeyError, TypeError, ValueError, AttributeError):  # no JSON, or no file any more
        return {"kind": kind, "file": name, "why": "no file", "false": "", "changed": True}
    why, changed, false = _why(document), document != base, ""
    if not why and changed and meaning(document) != meaning(base):
        try:
            false = "; ".join(cell_objections(document, SAMPLES)[:3])
        except Exception as error:  # what nobody else can read must not be accepted
            false = f"cannot be judged: {type(error).__name__}, {error}"
    return {"kind": kind, "file": name, "why": why, "false": false, "changed": changed}


def meaning(document: Document) -> Any:
    """What sampling looks at."""
    said = [
        (clock["arms"], clock["start"], clock["request"], [clock["result"][key] for key in ("path", "trajectory")])
        for clock in document["clocks"]
    ]
    claims = [clock["result"]["certificate"] for clock in document["clocks"]]
    claims += [each["clearance"] for each in document["sections"]["evidence"]["between"]]
    return [document[key] for key in ("robots", "arms", "scene", "still", "tolerates")], said, claims


def _table(rows: Sequence[Row], note: str) -> Table:
    caption = (
        f"{note}, such as a slower motion, a thinner robot whose digest is printed, or a number that is not verified"
    )
    return table_of_forgeries("Forged plans of cells", rows, caption)


REASONS = {
    "unknown words, other types and versions": r"missing or unknown|; expected|another version|no file",
    "digests of robots and scene": "the evidence is for",
    "other arms and proofs": "proofs of other arms|other motions than|is not there|moves twice|no motion",
    "both clocks": "^[^:]* x [^:]*: ",
    "where arms stand, and starts": "stand|starts before",
    "s(t), limits, ends that were asked for": r"s\(t\)|limits|exceeds|length|goal|asked for|joints|takes|shares",
    "the trail of one motion": "^(left|right|left and right): ",
}
"""Words of the verifier, tried in this order."""


def _reasons(rows: Sequence[Row]) -> Table:
    """What catches forgeries."""
    refused = [row["why"] for row in rows if row["why"]]
    found = Counter(
        next((name for name, words in REASONS.items() if re.search(words, why)), "others") for why in refused
    )
    lines = [
        {"caught by": name, "forgeries": f"{times:,}", "share": f"{times / max(1, len(refused)):.0%}"}
        for name, times in found.most_common()
    ]
    return table_of("What catches them", lines)


def _odd(rows: Sequence[Row]) -> Table:
    lines = [{key: str(row[key]) for key in ("kind", "file", "why", "false")} for row in rows[:40]]
    return table_of("Accepted and refuted, or honest and refused", lines)
