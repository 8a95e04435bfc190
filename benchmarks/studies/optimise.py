"""What optimising is worth: the hybrid next to shortcutting alone, the lesson's warning, and gradients of distances.

Both plans of a query have the same seed, are blended and proven, and are timed by the same law. Clearances are proven
lower bounds at many places of a curve, tight where pieces are apart.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.harness.audit import independent, touch_on_curve
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, p50, spread, table_of
from benchmarks.studies import problems
from benchmarks.studies.agreement import random_states
from benchmarks.studies.states import plan
from benchmarks.worlds import queries
from planner_service import CollisionChecker, Optimise, PlannerService, PlanResult, Reason, Stage, load_robot
from planner_service.certify import Certifier
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.optimize import Chomp
from planner_service.path.joint_path import JointPath
from planner_service.scene.scene import load_scene

__all__ = ["SCENES", "gradient_rows", "hybrid_rows", "promises", "run", "warning_rows"]

SCENES = ("bin", "shelf", "post", "clutter")
WARNING_SCENES = ("post", "clutter", "narrow", "window")

LESSON = queries.Query("discs", 7, read_only([-2.5, 2.0]), read_only([2.2, -2.2]), straight=False)
"""What the lesson's program plans, with its seed."""

POLISH = Optimise()
LONG = Optimise(waypoints=100, corners=16)
PANDA = {"shortcut": None, "20 mm": POLISH, "2 mm": Optimise(clearance=0.002)}
LONG_RUNS = 10
"""What a query's clearance is held against where neither its ends nor what was asked limit it."""

PLACES = 800
"""Of a curve, at which its clearance is taken; and between which its acceleration is integrated, five times as many."""

MOTION_STEP = 0.001
"""Metres of motion between two looks of the independent checker."""

STATES, STATES_AT_ONCE = 10_000, 500
NEAR, STEP, SPARE = 0.05, 1e-3, 0.02
"""Metres within which pairs are looked at; radians of a difference; metres that a pair may move in one."""

ROUNDING = 2e-4
"""Metres per radian by which a derivative may lie outside its differences: what 10 nm make over 0.1 mrad, twice."""

CLOSER = 0.1
"""Part of the step of the differences next to which a derivative is held that lies outside the wider ones: there the
distance has a kink, or bends one way on one side and the other way on the other, within the step."""

KINK = 0.02
"""Metres per radian between both differences from which on it is a kink: over 1 mrad a smooth distance bends less."""

LENGTH, ACCELERATION, DURATION, CLEAR_SHARE, STEP_MS = 1.05, 1 / 3, 0.85, 0.9, 10.0
"""Promised: ratios to shortcutting alone, a share of the queries, and milliseconds of an iteration."""


def _clearances(certifier: Certifier, path: JointPath) -> FloatArray:
    limits = certifier.robot.limits
    return certifier.clearances(np.clip(path(np.linspace(0.0, path.length, PLACES)), limits.lower, limits.upper))


def _length(path: JointPath) -> float:
    """Of the curve, in radians."""
    steps = np.diff(path(np.linspace(0.0, path.length, 5 * PLACES)), axis=0)
    return float(np.sqrt((steps * steps).sum(axis=1)).sum())


def _motion(result: PlanResult, certifier: Certifier) -> Row:
    """A plan in numbers: length of the curve (rad), seconds, integral of squared acceleration, clearances."""
    path, trajectory = result.unwrap()
    t = np.linspace(0.0, trajectory.duration, 5 * PLACES + 1)
    middle = 0.5 * (t[1:] + t[:-1])
    clear = _clearances(certifier, path)
    return {
        "length": _length(path),
        "duration": trajectory.duration,
        "acceleration": float((trajectory(middle, 2) ** 2).sum() * (t[1] - t[0])),
        "clearance": float(clear.min()),
        "ends": float(min(clear[0], clear[-1])),
    }


def _best_of_long_runs(service: PlannerService, certifier: Certifier, query: queries.Query) -> float:
    found = (plan(service, query, seed=seed, polish=LONG, max_checks=500_000) for seed in range(LONG_RUNS))
    return max((float(_clearances(certifier, one.path).min()) for one in found if one.path is not None), default=0.0)


def hybrid_rows(
    scenes: Sequence[str] = SCENES, count: int = queries.PER_SCENE, polish: Optimise = POLISH, **changes: Any
) -> Iterator[Row]:
    """Each query that has to be searched, by shortcutting alone and optimised."""
    for scene in scenes:
        service = PlannerService(queries.ROBOT, scene)
        certifier = Certifier(service.robot, service.scene)
        second = independent(queries.ROBOT, service.scene)
        plan(service, queries.load(scene)[0], polish=polish)  # libraries load, a field is made
        for query in queries.load(scene)[:count]:
            plain_ms, plain = cpu_ms(lambda: plan(service, query, **changes))  # noqa: B023
            ms, result = cpu_ms(lambda: plan(service, query, polish=polish, **changes))  # noqa: B023
            row: Row = {"scene": scene, "query": query.name, "method": polish.method.name}
            row["searched"] = plain.attempts > 0
            if result.polish is None or not plain.ok or not result.ok:
                yield row | {"failure": str(result.failure or plain.failure), "certified": False, "kept": False}
                continue
            before, after = _motion(plain, certifier), _motion(result, certifier)
            wanted = min(polish.clearance, before["ends"])
            if after["clearance"] < wanted:
                wanted = min(wanted, _best_of_long_runs(service, certifier, query))
            yield row | {
                "failure": None,
                "certified": _certified(result),
                "kept": result.polish.kept,
                "touch": touch_on_curve(second, result.unwrap()[0], MOTION_STEP),
                "before": before,
                "after": after,
                "wanted": wanted,
                "iterations": result.polish.iterations,
                "distances": result.stage(Stage.POLISH).counts.distances,
                "gradients": result.polish.gradients,
                "polish_ms": ms - plain_ms,
            }


def panda_rows(count: int | None = None) -> Iterator[Row]:
    """The public Panda problems, planned with default requests, and optimised for 20 mm and for 2 mm."""
    robot = load_robot(problems.ROBOT)
    for problem in problems.public_problems().problems[:count]:
        service = PlannerService(robot, problem.scene)
        row: Row = {"problem": problem.id}
        for name, polish in PANDA.items():
            request = replace(problems.asked(robot, problem), polish=polish)
            ms, result = cpu_ms(lambda: service.plan(request))  # noqa: B023
            row[name] = {
                "ms": ms,
                "certified": _certified(result),
                "kept": result.polish is None or result.polish.kept,
                "length": math.nan if result.path is None else _length(result.path),
                "duration": math.nan if result.motion is None else result.motion.duration,
            }
        yield row


def warning_rows(scenes: Sequence[str] = WARNING_SCENES, count: int = queries.PER_SCENE) -> Iterator[Row]:
    """What comes of the straight line alone, and of the hybrid, on the same queries; the lesson's own first."""
    worlds: list[tuple[PlannerService, Sequence[queries.Query]]] = [(PlannerService("planar2", "discs"), (LESSON,))]
    worlds += [(PlannerService(queries.ROBOT, scene), queries.load(scene)[:count]) for scene in scenes]
    for service, asked in worlds:
        for query in asked:
            straight = plan(service, query, planner=POLISH)
            several = plan(service, query, planner=replace(POLISH, starts=4))
            outcomes = {"straight": straight, "several": several, "hybrid": plan(service, query, polish=POLISH)}
            yield {
                "scene": query.scene,
                "query": query.name,
                **{key: _outcome(result) for key, result in outcomes.items()},
                "told": None if straight.failure is None else straight.failure.detail,
                "where": straight.failure is not None and len(straight.failure.contacts) > 0,
            }


def _outcome(result: PlanResult) -> str:
    if result.failure is not None:
        return result.failure.reason.value
    return "certified" if _certified(result) else "UNCERTIFIED"


def _certified(result: PlanResult) -> bool:
    return result.certificate is not None and result.certificate.certified


def gradient_rows(scene: str = "clutter", states: int = STATES) -> Iterator[Row]:
    """Derivatives of the distances of near pairs at random states, next to both one-sided differences."""
    robot = load_robot(queries.ROBOT)
    checker = CollisionChecker(robot, load_scene(scene))
    rng = np.random.default_rng(queries.SEED)
    limits = robot.limits
    for start in range(0, states, STATES_AT_ONCE):
        Q = random_states(robot, min(STATES_AT_ONCE, states - start), rng)
        Q = np.clip(Q, limits.lower + STEP, limits.upper - STEP)
        found = checker.near(Q, NEAR)
        counts: Counter[str] = Counter(dict.fromkeys(("lost", "kinks", "derivatives", "barely", "outside"), 0))
        counts.update(states=len(Q), pairs=len(found.rows), overlapping=int((found.distances < 0.0).sum()))
        worst, keys = 0.0, list(zip(found.rows.tolist(), found.pairs.tolist(), strict=True))
        for joint in range(robot.n):
            slopes = dict(zip(keys, found.gradients[:, joint].tolist(), strict=True))
            here = dict(zip(keys, found.distances.tolist(), strict=True))
            sides = _differences(checker, Q, joint, STEP, here)
            counts["lost"] += len(keys) - len(sides)
            counts["kinks"] += sum(high - low > KINK for low, high in sides.values())
            counts["derivatives"] += len(sides)
            wide = [
                key for key, (low, high) in sides.items() if not -ROUNDING <= slopes[key] - low <= high - low + ROUNDING
            ]
            near = _differences(checker, Q, joint, CLOSER * STEP, {key: here[key] for key in wide})
            beyond = [max(low - slopes[key], slopes[key] - high) for key, (low, high) in near.items()]
            counts["barely"] += len(wide)
            counts["outside"] += sum(by > ROUNDING for by in beyond)
            worst = max([worst, *beyond])
        yield {"scene": scene, "worst": worst, **counts}


def _differences(
    checker: CollisionChecker, Q: FloatArray, joint: int, step: float, here: dict[tuple[int, int], float]
) -> dict[tuple[int, int], tuple[float, float]]:
    """The smaller and the larger one-sided difference of distances that are known here, where both can be had."""
    if not here:
        return {}
    after, before = (_moved(checker, Q, joint, sign * step) for sign in (1.0, -1.0))
    both = [key for key in here if key in after and key in before]
    pairs = {key: ((after[key] - here[key]) / step, (here[key] - before[key]) / step) for key in both}
    return {key: (min(pair), max(pair)) for key, pair in pairs.items()}


def _moved(checker: CollisionChecker, Q: FloatArray, joint: int, by: float) -> dict[tuple[int, int], float]:
    moved = Q.copy()
    moved[:, joint] += by
    found = checker.near(moved, NEAR + SPARE)
    return dict(zip(zip(found.rows.tolist(), found.pairs.tolist(), strict=True), found.distances.tolist(), strict=True))


def run() -> Report:
    """Measure it all; some four minutes."""
    hybrids = list(hybrid_rows())
    looked_up = list(hybrid_rows(count=5, polish=Optimise(method=Chomp())))
    warnings, pandas, gradients = list(warning_rows()), list(panda_rows()), list(gradient_rows())
    tables = (
        _hybrid_table("The hybrid next to shortcutting alone", hybrids),
        _hybrid_table("The same by the other method, 5 queries a scene", looked_up),
        _warning_table(warnings),
        _panda_table(pandas),
    )
    rows = (*hybrids, *looked_up, *warnings, *pandas, *gradients)
    return Report("optimise", rows, tables, promises(hybrids, warnings, gradients))


def _ratios(rows: Sequence[Row], what: str) -> list[float]:
    return [row["after"][what] / row["before"][what] for row in rows if row["failure"] is None]


def _at_equal_time(rows: Sequence[Row]) -> list[float]:
    """Integrals of squared acceleration if the optimum is slowed down to the time of the shortcut."""
    pairs = zip(_ratios(rows, "acceleration"), _ratios(rows, "duration"), strict=True)
    return [acceleration * duration**3 for acceleration, duration in pairs]


def _clear(rows: Sequence[Row]) -> list[bool]:
    return [row["failure"] is None and row["after"]["clearance"] >= row["wanted"] for row in rows]


def promises(hybrids: Sequence[Row], warnings: Sequence[Row], gradients: Sequence[Row]) -> tuple[Promise, ...]:
    """What these figures were to be."""
    rows = [row for row in hybrids if row["searched"]]
    clear = _clear(rows)
    by_scene = grouped(rows, "scene")
    caught = [row for row in warnings if row["straight"] == Reason.OPTIMUM_IN_COLLISION.value]
    solved = [row for row in caught if row["hybrid"] == "certified" and row["where"]]
    uncertified = sum(row["failure"] is None and not row["certified"] for row in rows)
    uncertified += sum("UNCERTIFIED" in (row["straight"], row["several"], row["hybrid"]) for row in warnings)
    touched = [f"{row['query']}: {row['touch']}" for row in rows if row["failure"] is None and row["touch"]]
    total: Counter[str] = Counter()
    for row in gradients:
        total.update({key: value for key, value in row.items() if key not in ("scene", "worst")})

    def medians(values: Callable[[Sequence[Row]], list[float]], most: float, text: str) -> Promise:
        told = {scene: values(here) for scene, here in by_scene.items()}
        shown = "; ".join(f"{scene} {spread(some, 2)}" for scene, some in told.items())
        return Promise(text, shown, all(p50(some) <= most for some in told.values()))

    length, duration, acceleration = (partial(_ratios, what=what) for what in ("length", "duration", "acceleration"))
    own_pace = "integral of squared acceleration at most 1/3, each at its own pace"
    equal = "integral of squared acceleration at most 1/3 in the same motion time"
    step = [row["polish_ms"] / row["iterations"] for row in rows if row["failure"] is None]
    smallest = "smallest clearance at least min(20 mm, its ends', the best of 10 long runs) on 90 % of the queries"
    rejects = "the independent checker, at every millimetre of motion, rejects no optimum"
    rejected = f"{len(touched)} of {len(rows)}" + (f": {touched[0]}" if touched else "")
    lines = "an optimum of the straight line in collision is reported, with where, and the hybrid solves the query"
    reported = f"{len(caught)} of {len(warnings)} reported, {len(solved)} of them solved"
    return (
        Promise(smallest, f"{sum(clear)} of {len(clear)}", sum(clear) >= CLEAR_SHARE * len(clear)),
        medians(length, LENGTH, "length at most 1.05 x at p50 in each scene"),
        medians(duration, DURATION, "motion time at most 0.85 x at p50 in each scene"),
        medians(acceleration, ACCELERATION, own_pace),
        medians(_at_equal_time, ACCELERATION, equal),
        Promise("no result without a proof", f"{uncertified} uncertified", uncertified == 0),
        Promise(rejects, rejected, not touched),
        Promise(lines, reported, 0 < len(caught) == len(solved)),
        Promise(
            f"derivatives lie between the one-sided differences of {STEP:g} rad",
            f"{total['derivatives'] - total['barely']:,} of {total['derivatives']:,} do, the others between those of "
            f"{CLOSER * STEP:g} rad but for {total['outside']:,} ({total['states']:,} states, {total['pairs']:,} near "
            f"pairs, {total['overlapping']:,} of them overlapping; {total['kinks']:,} kinks, {total['lost']:,} lost)",
            total["outside"] == 0,
        ),
        Promise("an iteration takes less than 10 ms", f"ms p50 / p95: {spread(step, 1)}", p50(step) < STEP_MS),
    )


def _hybrid_table(title: str, rows: Sequence[Row]) -> Table:
    def line(scene: str, all_: Sequence[Row]) -> Row:
        here = [row for row in all_ if row["searched"]]
        good = [row for row in here if row["failure"] is None]
        ratios = {"length x": "length", "time x": "duration", "accel. x": "acceleration"}
        clearances = {"clear before": "before", "after mm": "after"}
        return {
            "scene": scene,
            "queries": len(here),
            **{name: spread(_ratios(here, what), 2) for name, what in ratios.items()},
            "same time x": spread(_at_equal_time(here), 2),
            **{name: f"{p50(row[side]['clearance'] * 1e3 for row in good):.1f}" for name, side in clearances.items()},
            "clear": f"{sum(_clear(here))}/{len(here)}",
            **{what: spread([float(row[what]) for row in good]) for what in ("iterations", "distances", "gradients")},
            "polish ms": spread([row["polish_ms"] for row in good]),
            "kept/certified": f"{sum(row['kept'] for row in here)}/{sum(row['certified'] for row in here)}",
        }

    caption = (
        "p50 / p95, ratios to shortcutting alone. Accel.: integral of squared joint acceleration over time, each at "
        "its own time-optimal pace, which always uses some joint's acceleration fully; same time: the optimum slowed "
        "down to the time of the shortcut. Clear: queries that keep 20 mm, or what their ends or the best of 10 long "
        "runs allow. Polish: CPU."
    )
    return table_of(title, (line(*each) for each in grouped(rows, "scene").items()), caption=caption)


def _warning_table(rows: Sequence[Row]) -> Table:
    kinds = {"certified from the straight line": "straight", "from 4 lines": "several", "hybrid": "hybrid"}
    lines = (
        {"scene": scene, "queries": len(here)}
        | {name: sum(row[what] == "certified" for row in here) for name, what in kinds.items()}
        | {"an optimum that is none": next((row["told"] for row in here if row["told"]), "")}
        for scene, here in grouped(rows, "scene").items()
    )
    caption = "Converged is not collision-free: every other query was reported as OPTIMUM_IN_COLLISION, with where."
    return table_of("What a straight line converges to", lines, caption=caption)


def _panda_table(rows: Sequence[Row]) -> Table:
    def line(name: str) -> Row:
        own = [row[name] for row in rows]
        return {
            "": name,
            **{what: f"{sum(one[what] for one in own)}/{len(own)}" for what in ("certified", "kept")},
            "length rad": spread([one["length"] for one in own], 2),
            "motion s": spread([one["duration"] for one in own], 2),
            "CPU ms": spread([one["ms"] for one in own]),
        }

    caption = "70 problems of MotionBenchMaker, seed 0, p50 / p95; CPU of whole plans."
    return table_of("Public Panda problems", map(line, PANDA), caption=caption)
