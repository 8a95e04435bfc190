"""Four arms on public problems: whole plans, proven and timed, next to an older version and to VAMP, in one run.

Every planner has a process of its own, and they take turns problem by problem. Ours are asked with the default request,
by a service that has planned before. The Panda and its problems are here; the others' are in a folder that is named,
as ``mbm_ur5_sample.json`` beside ``mbm_robots/ur5/ur5.urdf``. A robot is loaded from its file as each version reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table

import planner_service as ps
from benchmarks.baselines.peers.catalogue import PEERS
from benchmarks.baselines.peers.child import Reply
from benchmarks.baselines.peers.environments import Environment
from benchmarks.baselines.peers.jobs import Task
from benchmarks.baselines.peers.running import path_of, replies_of
from benchmarks.baselines.peers.versions import HERE, THEN, version_here, version_then
from benchmarks.harness.audit import JOINT_STEP, Auditor, instants
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, merged, p50, p95, spread, table_of
from benchmarks.harness.suite import PUBLIC, Motion
from benchmarks.studies import lengths
from benchmarks.worlds.foreign import table_of_robot
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.records import read_problems

__all__ = ["PARTS", "SHARES", "arms_in", "run"]

PARTS = ("plans", "lengths")

SHARES: Mapping[str, tuple[float, float]] = {
    "panda": (0.45, 0.35),
    "ur5": (0.35, 0.15),
    "fetch": (0.3, 0.1),
    "baxter": (0.3, 0.15),
}
"""Promised: parts of the older version's CPU time, at p50 and p95."""

SEARCH = 3.0
"""Promised: times VAMP's search, at p50 and p95."""

VAMP = "vamp"
NAMES = {HERE: "planner_service", THEN: "older", VAMP: VAMP}
BLEND = 0.5
"""Radians that a blend on VAMP's path takes at most, as a default request's does."""

ENDS = ("START_IN_COLLISION", "GOAL_IN_COLLISION")
STAGES = ("endpoints", "straight line", "search", "shortcut", "polish", "certify", "timing")


@dataclass(frozen=True)
class Arm:
    """A robot, what ``load_robot`` is given for it, and the file of its problems."""

    name: str
    source: str
    problems: Path


def arms_in(folder: Path | None, robot: str | None) -> list[Arm]:
    """The Panda, and the arms of a folder.

    Raises:
        UnknownName: There is no arm of that name.
        InvalidRequest: The folder has not got it.
    """
    found = {"panda": Arm("panda", "panda_mbm", PUBLIC)}
    for name in SHARES:
        if folder is None:
            break
        arm = Arm(name, str(folder / f"mbm_robots/{name}/{name}.urdf"), folder / f"mbm_{name}_sample.json")
        if name not in found and arm.problems.is_file() and Path(arm.source).is_file():
            found[name] = arm
    if robot is None:
        return list(found.values())
    if robot not in SHARES:
        raise ps.UnknownName("robot", robot, tuple(SHARES))
    if robot not in found:
        raise ps.InvalidRequest("--problems", str(folder), f"a folder with the problems and the robot of {robot}")
    return [found[robot]]


def run(
    seeds: int = 5,
    robot: str | None = None,
    problems: Path | None = None,
    against: Path | None = None,
    part: str | None = None,
) -> Report:
    """Plan the problems of all arms with each seed; an hour for four arms and two versions.

    Args:
        part: One of ``PARTS``.
        problems: The folder of the arms that are not here.
        against: The python of an environment with the version to compare with; none if not given.

    Raises:
        UnknownName, InvalidRequest: As ``arms_in``; or there is no seed, or no such python.
    """
    if not seeds:
        raise ps.InvalidRequest("--seeds", seeds, "at least 1")
    arms = arms_in(problems, robot)
    reports = [_plans(arms, seeds, against)] if part in (None, "plans") else []
    if part in (None, "lengths"):
        reports.append(lengths.shown([row for arm in arms for row in _length_rows(arm, seeds)]))
    return merged("arms", reports)


def _length_rows(arm: Arm, seeds: int) -> Iterator[Row]:
    return lengths.rows_of(arm.name, ps.load_robot(arm.source), read_problems(arm.problems).problems, seeds)


def _plans(arms: Sequence[Arm], seeds: int, against: Path | None) -> Report:
    """Plan the problems of these arms, and what came of it."""
    versions = [version_here()] if against is None else [version_here(), version_then(against)]
    once = {"default": {"turns": 1}}
    versions = [replace(version, peer=replace(version.peer, planners=once)) for version in versions]
    vamp, rows = Environment.of(PEERS[VAMP]), list[Row]()
    for arm in arms:
        with_vamp = arm.name == "panda" and (vamp.ready or vamp.install() == "installed")
        rows += rows_in_turn(arm, [*versions, vamp] if with_vamp else versions, seeds)
    lines = [_line(*key, here) for key, here in _by_arm(rows).items()]
    tables = [table_of("Public problems of four arms", lines, caption=CAPTION), _stage_table(rows)]
    beside = [key for key in _by_arm(rows) if key[1] == VAMP]
    tables += [_vamp_table(rows)] if beside else []
    return Report("arms", tuple(rows), tuple(tables), tuple(_promises(rows)))


CAPTION = (
    "CPU ms and states of the search, p50 / p95 / most, failures included; second plan of a service. No path: proven, "
    "or an end is refused since it collides. Rejected: timed motions by the auditor, of this version and of VAMP, in "
    f"joint steps of {JOINT_STEP:g} rad."
)


def rows_in_turn(arm: Arm, environments: Sequence[Environment], seeds: int) -> Iterator[Row]:
    """A row of each planner for each problem and seed; a planner plans while the others wait."""
    robot = ps.load_robot(arm.source)
    tasks = [Task(motion, seed) for motion in motions_of(arm, robot) for seed in range(seeds)]
    table = {"name": arm.source, "joints": list(robot.joint_names)}
    with TemporaryDirectory() as place, ExitStack() as stack:
        auditor = _auditors(arm, robot, Path(place))
        asked = [
            (environment, stack.enter_context(closing(replies_of(environment, planner, table, tasks))))
            for environment in environments
            for planner in environment.peer.planners
        ]
        for k, task in enumerate(tasks):
            for environment, replies in asked if k % 2 == 0 else asked[::-1]:  # nobody is always the first
                tool = environment.peer.name
                row, motion = _row(next(replies), task, robot.limits)
                judged = None if motion is None or tool == THEN else auditor(task.problem).judge(motion)
                refused = tool == HERE and row["detail"].startswith(ENDS) and not row["ok"]
                wrongly = refused and _ends_are_free(auditor(task.problem), task.problem)
                yield {"arm": arm.name, "tool": tool} | row | {"audit": judged, "wrongly refused": wrongly}


def motions_of(arm: Arm, robot: ps.Robot) -> Iterator[Motion]:
    """The problems of an arm, in the order of its joints."""
    for problem in read_problems(arm.problems).problems:
        request = problem.request(robot)
        kind = problem.id.partition("/")[0]
        yield Motion(problem.id, kind, robot.name, problem.scene, np.asarray(request.start), request.goals(robot))


def _auditors(arm: Arm, robot: ps.Robot, place: Path) -> Callable[[Motion], Auditor]:
    """Makes the auditor of a problem; it judges the triangles of meshes where a link is cut into pieces."""
    known: str | Mapping[str, Any] = arm.source
    if arm.source.endswith(".urdf"):
        cut = ps.load_robot(arm.source, cut_meshes=False).hash != robot.hash
        known = table_of_robot(robot, arm.source, place) | {"surfaces": cut}

    @lru_cache(maxsize=1)
    def auditor(motion: Motion) -> Auditor:
        return Auditor(known, motion.scene)

    return auditor


def _ends_are_free(auditor: Auditor, motion: Motion) -> bool:
    """Whether the start is free to an auditor, and a goal that is a configuration."""
    goals = [goal for goal in motion.goals if isinstance(goal, np.ndarray)]
    free = [auditor.judge(np.array([q]))["verdict"] == "free" for q in (motion.start, *goals)]
    return free[0] and any(free[1:])


def _row(reply: Reply, task: Task, limits: ps.JointLimits) -> tuple[Row, FloatArray | None]:
    """What a reply comes to, and its motion in steps that the auditor can judge, if there is one."""
    answer = reply.answer or {}
    path, failure, detail = path_of(reply, task.problem)
    stages = {stage: spent * 1e3 for stage, spent in (answer.get("stage_cpu_seconds") or {}).items()}
    row: Row = {"problem": task.problem.id, "seed": task.seed, "ok": failure is None, "detail": detail}
    row |= {"version": next(iter(reply.versions.values()), ""), "stages": stages}
    row |= {"ms": 1e3 * (reply.waited + (answer.get("cpu_seconds") or 0.0)), "seconds": None, "length": None}
    row |= {"states": (answer.get("checks") or {}).get("search", 0)}
    if failure is not None or path is None:
        return row, None
    steps = np.diff(path, axis=0)
    row["length"] = float(np.sqrt((steps * steps).sum(axis=1)).sum())
    times = answer.get("times")
    if times:
        return row | {"seconds": times[-1] - times[0]}, path
    ms, trajectory = cpu_ms(lambda: _by_our_law(path, limits))
    stages["timing"] = ms
    return row | {"ms": row["ms"] + ms, "seconds": trajectory.duration}, instants(trajectory)


def _by_our_law(points: FloatArray, limits: ps.JointLimits) -> ps.Trajectory:
    """A path of a planner that does not time it, its corners blended unseen, by the default law."""
    path = JointPath(points)
    pieces, sizes = np.diff(path.knots), np.zeros(len(path.waypoints))
    for k in path.corners:
        sizes[k] = 0.0 if path.turns_back(k) else min(BLEND, 0.49 * pieces[k - 1], 0.49 * pieces[k])
    return ps.ToppRa().time_path(path.with_blends(sizes), limits)


def _by_arm(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    return {
        (arm, tool): mine for arm, here in grouped(rows, "arm").items() for tool, mine in grouped(here, "tool").items()
    }


def _impossible(row: Row) -> bool:
    """Whether there is no plan to be found: that is proven, or an end collides."""
    return not row["ok"] and row["detail"].startswith(("NO_PATH", *ENDS))


def _lost(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if not row["ok"] and not _impossible(row)]


def _rejected(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["audit"] is not None and row["audit"]["verdict"] != "free"]


def _search_ms(rows: Sequence[Row]) -> list[float]:
    return [row["stages"].get("search", 0.0) for row in rows]


def _line(arm: str, tool: str, rows: Sequence[Row]) -> Row:
    done, ms, states = [row for row in rows if row["ok"]], [row["ms"] for row in rows], [row["states"] for row in rows]
    judged, rejected = [row for row in rows if row["audit"] is not None], _rejected(rows)
    deepest = max((row["audit"]["depth"] or 0.0 for row in rejected), default=0.0)
    return {
        "arm": arm,
        "planner": f"{NAMES[tool]} {next((row['version'] for row in rows if row['version']), '')}",
        "solved": f"{len(done)}/{len(rows)}",
        "no path": sum(map(_impossible, rows)),
        "given up": len(_lost(rows)),
        "rejected": f"{len(rejected)}/{len(judged)}" + (f", {deepest * 1e3:.1f} mm" if rejected else "")
        if judged
        else "-",
        "ms": f"{spread(ms, 1)} / {max(ms):,.0f}",
        "states": "-" if tool == VAMP else f"{spread(states)} / {max(states):,}",
        "rad p50": f"{p50(row['length'] for row in done):.2f}" if done else "-",
        "motion s": f"{p50(row['seconds'] for row in done):.2f}" if done else "-",
    }


def _stage_table(rows: Sequence[Row]) -> Table:
    """How much of a plan each stage is, and what it takes."""

    def line(arm: str, here: Sequence[Row]) -> Row:
        parts = {stage: [row["stages"].get(stage, 0.0) for row in here] for stage in STAGES}
        shares = {
            stage: np.mean([ms / row["ms"] for ms, row in zip(parts[stage], here, strict=True)]) for stage in STAGES
        }
        cells = {stage: f"{shares[stage]:.0%} ({p50(parts[stage]):.2f} / {p95(parts[stage]):.1f})" for stage in STAGES}
        return {"arm": arm} | cells | {"outside": f"{1.0 - sum(shares.values()):.0%}"}

    caption = "Mean share of a plan, and CPU ms at p50 / p95; outside: what belongs to no stage."
    here = [row for row in rows if row["tool"] == HERE and row["ms"] > 0.0]
    return table_of("Stage by stage", [line(*each) for each in grouped(here, "arm").items()], caption=caption)


def _vamp_table(rows: Sequence[Row]) -> Table:
    def line(tool: str, here: Sequence[Row]) -> Row:
        parts = {stage: [row["stages"].get(stage, 0.0) for row in here] for stage in ("search", "shortcut", "timing")}
        judged = [row for row in here if row["audit"] is not None]
        return {
            "planner": tool,
            **{f"{stage} ms": spread(ms, 3) for stage, ms in parts.items()},
            "whole ms": spread([row["ms"] for row in here], 2),
            "colliding": f"{len(_rejected(here)) / max(1, len(judged)):.0%}",
        }

    caption = (
        "The Panda, CPU ms at p50 / p95. VAMP's path has its corners blended unseen, and is timed by our compiled law. "
        "Whole: ours with the proof, VAMP's without one. Colliding: timed motions, for the auditor."
    )
    tools = grouped([row for row in rows if row["arm"] == "panda" and row["tool"] != THEN], "tool")
    return table_of("Beside VAMP", [line(*each) for each in tools.items()], caption=caption)


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    by_arm = _by_arm(rows)
    ours = [row for row in rows if row["tool"] == HERE]
    lost = [f"{row['arm']} {row['problem']} seed {row['seed']}: {row['detail'][:60]}" for row in _lost(ours)]
    yield Promise("all that can be solved is, by the default request", "; ".join(lost) or f"{len(ours)}", not lost)
    wrongly = [f"{row['arm']} {row['problem']}" for row in ours if row["wrongly refused"]]
    free = sum(row["ok"] for row in ours) + len(wrongly) + len(lost)
    measured = "; ".join(wrongly) or f"{sum(row['ok'] for row in ours)} of {free} planned"
    yield Promise(
        "no problem is refused whose ends are free to the auditor, by triangles of meshes", measured, not wrongly
    )
    rejected = [f"{row['arm']} {row['problem']} seed {row['seed']}: {row['audit']['pair']}" for row in _rejected(ours)]
    yield Promise("0 rejected by the auditor", "; ".join(rejected) or "none", not rejected)
    for arm, (first, second) in SHARES.items():
        if (arm, THEN) in by_arm:
            now, then = ([row["ms"] for row in by_arm[arm, tool]] for tool in (HERE, THEN))
            found = p50(now) / p50(then), p95(now) / p95(then)
            text = f"{arm}: at most {first:g} / {second:g} of the older version's CPU time at p50 / p95"
            measured = f"{found[0]:.2f} / {found[1]:.2f} of {spread(then, 1)} ms"
            yield Promise(text, measured, found[0] <= first and found[1] <= second)
    if ("panda", VAMP) in by_arm:
        now, then = (_search_ms(by_arm["panda", tool]) for tool in (HERE, VAMP))
        found = p50(now) / p50(then), p95(now) / p95(then)
        measured = f"{found[0]:.1f} / {found[1]:.1f} times {spread(then, 3)} ms"
        yield Promise(f"search takes at most {SEARCH:g} times VAMP's, p50 / p95", measured, max(found) <= SEARCH)
