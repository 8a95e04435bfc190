"""What hulls of concave links cost, and what cutting these into convex pieces gives back: states, and time per state.

Coal judges on the triangles of the meshes. A robot that it sees more than a millimetre apart from itself, and that is
called colliding, is blocked by hulls or pieces alone; one that it sees touch, and that is called free, must not be.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.harness.fresh_process import told_by
from benchmarks.harness.report import Promise, Report, Row, table, table_of
from benchmarks.worlds.foreign import MESHED, ForeignRobot
from planner_service.errors import InvalidRequest

__all__ = ["run"]

STATES, TIMED = 300, 5000
AT_MOST = 1800.0
"""Seconds for a robot, its judgement included."""
ALLOWED = 1e-3
"""Metres that convex pieces may be larger than the triangles."""
CONTACT = 1e-6
"""Metres that Coal's distances are right to."""
BLOCKED, SLOWER = 0.01, 2.0
FIRST, AGAIN = 15.0, 2.0
"""Seconds of processor time from the start of a process to the first proven plan: with an empty cache, a full one."""
TRIES = 5


def run(states: int = STATES, seed: int = 0, robot: str | None = None) -> Report:
    """Meet the arms whose links are meshes, or the one of that name."""
    rows = tuple(_row(one, states, seed) for one in MESHED if robot in (None, one.name))
    return Report("robots", rows, tuple(_tables(rows)), tuple(_promises(rows)))


def _row(one: ForeignRobot, states: int, seed: int) -> Row:
    """What fresh processes tell: of plans with empty caches and then full ones, and of states."""
    row: Row = {"robot": one.name, "source": f"{one.distribution}, {one.file}"}
    try:
        source = one.source()
    except InvalidRequest as error:
        return row | {"error": str(error).splitlines()[0]}
    with TemporaryDirectory() as caches:
        for part in ("first", "again", "judged"):
            row |= told_by("benchmarks.studies.meshes", part, source, states, seed, seconds=AT_MOST, caches=caches)
            if "error" in row:
                return row | {"error": f"{part}: {row['error']}"}
    return row


def _tables(rows: Sequence[Row]) -> Iterator[Table]:
    lines = [
        {
            "robot": row["robot"],
            "links cut": row["links"],
            "pieces": row["pieces"],
            "hulls alone %": f"{100 * row['hull_blocked'] / row['states']:.1f}",
            "pieces alone %": f"{100 * row['piece_blocked'] / row['states']:.1f}",
            "states gained %": f"{100 * row['gained'] / row['states']:.1f}",
            "missed": row["missed"],
            "us hulls": f"{row['hull_us']:.1f}",
            "us pieces": f"{row['piece_us']:.1f}",
            "ratio": f"{row['piece_us'] / row['hull_us']:.2f}",
            "first s": f"{row['first_s']:.1f}",
            "cached s": f"{row['again_s']:.1f}",
        }
        for row in rows
        if "error" not in row
    ]
    caption = (
        "Hulls alone: of random states, those called colliding although Coal sees the triangles of all links more than "
        "1 mm apart. Pieces alone: the same, concave links cut. Missed: called free although triangles touch. us: "
        "processor time per state of the links themselves. First, cached: processor seconds from the start of a "
        "process to the first proven plan, with an empty cache and a full one."
    )
    if lines:
        yield table_of("What hulls of meshes cost", lines, caption=caption)
    told = [(row["robot"], row["error"]) for row in rows if "error" in row]
    if told:
        yield table("What went wrong", ("robot", "what"), told)


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    met = [row for row in rows if "error" not in row]
    failed = [row["robot"] for row in rows if "error" in row]
    yield Promise("every arm is judged", ", ".join(failed) or f"{len(met)} arms", not failed)
    missed = [row["robot"] for row in met if row["missed"]]
    yield Promise("no state is called free in which triangles touch", ", ".join(missed) or "none", not missed)
    worst = max(met, key=lambda row: row["piece_blocked"] / row["states"], default=None)
    if worst is None:
        return
    share = worst["piece_blocked"] / worst["states"]
    measured = f"at most {share:.1%} ({worst['robot']})"
    yield Promise(f"pieces alone block at most {BLOCKED:.0%} of all states", measured, share <= BLOCKED)
    slow = max(met, key=lambda row: row["piece_us"] / row["hull_us"])
    ratio = slow["piece_us"] / slow["hull_us"]
    yield Promise(f"a state takes at most {SLOWER:g} times as long", f"{ratio:.2f} ({slow['robot']})", ratio <= SLOWER)
    for key, words, most in (("first_s", "nothing", FIRST), ("again_s", "all cuts", AGAIN)):
        slow = max(met, key=lambda row: row[key])
        measured = f"{slow[key]:.1f} s ({slow['robot']})"
        yield Promise(f"a first proven plan within {most:g} s, {words} cached", measured, slow[key] <= most)


def _planned(source: str, seed: int) -> float:
    """Processor seconds from the start of the process to a proven plan from home to a random configuration."""
    from planner_service import PlannerService, PlanRequest, Scene, load_robot

    service = PlannerService(load_robot(source), Scene())
    limits, rng = service.robot.limits, np.random.default_rng(seed)
    for _ in range(TRIES):
        goals = rng.uniform(limits.lower, limits.upper, (200, service.robot.n))
        goal = goals[service.checker.states_are_free(goals)][0]
        if service.plan(PlanRequest(service.robot.home, goal, seed=seed)).ok:
            return time.process_time()
    raise SystemExit("no plan")


def _judged(source: str, states: int, seed: int) -> dict[str, Any]:
    """States of the robot by hulls and by pieces, and by Coal's triangles."""
    from auditor.checker import IndependentChecker
    from benchmarks.worlds.foreign import table_of_robot
    from planner_service import Scene, load_robot
    from planner_service.collision import CollisionChecker

    robots = {"hull": load_robot(source, cut_meshes=False), "piece": load_robot(source)}
    limits, rng = robots["hull"].limits, np.random.default_rng(seed)
    Q = rng.uniform(limits.lower, limits.upper, (states, robots["hull"].n))
    timed = rng.uniform(limits.lower, limits.upper, (TIMED, robots["hull"].n))
    told: dict[str, Any] = {"states": states, "missed": 0}
    free, judges = {}, dict[tuple[tuple[str, str], ...], IndependentChecker]()
    for name, robot in robots.items():
        if robot.link_pairs not in judges:
            with TemporaryDirectory() as place:
                table = table_of_robot(robot, source, Path(place)) | {"surfaces": True}
                judges[robot.link_pairs] = IndependentChecker(table, {})
        judge, checker = judges[robot.link_pairs], CollisionChecker(robot, Scene())
        free[name] = checker.states_are_free(Q)
        told[f"{name}_blocked"] = sum(min(judge.gaps(q).values()) > ALLOWED for q in Q[~free[name]])
        suspects = [q for q in Q[free[name]] if not judge.free(q)]
        told["missed"] += sum(min(judge.gaps(q).values()) < -CONTACT for q in suspects)
        checker.states_are_free(timed[:100])
        spent = []
        for _ in range(3):
            begun = time.process_time()
            checker.states_are_free(timed)
            spent.append(time.process_time() - begun)
        told[f"{name}_us"] = 1e6 * min(spent) / len(timed)
    told["gained"] = int((free["piece"] & ~free["hull"]).sum())
    counts = [[item.link for item in robot.shapes] for robot in robots.values()]
    cut = {link for link in counts[1] if counts[1].count(link) > counts[0].count(link)}
    return told | {"links": len(cut), "pieces": sum(link in cut for link in counts[1])}


def main(part: str, source: str, states: int, seed: int) -> None:
    """Print what a part tells of the robot of ``source``."""
    print(json.dumps(_judged(source, states, seed) if part == "judged" else {f"{part}_s": _planned(source, seed)}))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:5]))
