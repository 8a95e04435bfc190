"""Replanning at 10 Hz: 50 steps in a row while an obstacle, or the goal, moves 1 cm a step.

The robot goes to and fro between the ends of stored queries, with a ball crossing its way, or after a goal that wanders
through the room. Each step builds the changed scene's checkers, replans and hands over the next motion.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import NamedTuple

import numpy as np
from rich.table import Table

import planner_service as ps
from benchmarks.harness.report import Promise, Report, Row, p50, p95, spread, table_of
from benchmarks.worlds import queries
from planner_service.geometry.arrays import FloatArray
from planner_service.replanning import Outcome, Replanned

__all__ = ["SCENES", "drive", "promises", "rows", "run"]

SCENES = ("bin", "post", "clutter")
RUNS, STEPS, PERIOD, STRIDE = 4, 50, 0.1, 0.01
"""Runs of each kind in each scene; steps of one, seconds between them, and metres that things move in one."""

RADIUS, EARLY, ROOM = 0.04, 0.12, 0.03
"""Metres: of the ball, how far from the middle of the first way it begins, and how far it stays from both ends."""

PADDING = 0.03
"""Metres that ways keep from everything: what moves in three steps."""

LATER = (2, 4, 6, 8)
"""Steps after which what moves is expected where it will then be."""

DRAWS = 1000

MOST_MS, USUAL_MS, MOST_STOPS, MOST_JUMP = 100.0, 5.0, 2, 1e-9

SAMPLING = 0.005
"""Seconds between configurations of a motion that are judged once more."""


class Change(NamedTuple):
    """What one step brings: the scene with where things will soon be, sooner, and without; and where to go."""

    scenes: Sequence[ps.Scene]
    goal: ps.Pose | FloatArray


TO_AND_FRO = [STRIDE * (STEPS // 2 - abs(step - STEPS // 2)) for step in range(STEPS)]
"""Metres from where it began that something is at each step."""

SPARSE = 3
"""Of so many steps one is looked at with more room."""

POSTS = {"bin": "demo_post", "post": "post_ahead", "clutter": "post_0"}
"""What moves in each scene."""

Changes = Callable[[int, bool], Change]
"""What a step brings, given its number and whether the robot has arrived."""


Setting = tuple[ps.PlanResult, Changes]
"""The plan that is being executed at first, and what then changes."""


@dataclass
class Drive:
    """What happened on the way: CPU milliseconds a step, jumps of q, qd and qdd, outcomes, stops short of a goal."""

    ms: list[float] = field(default_factory=list)
    states: list[int] = field(default_factory=list)
    jumps: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    outcomes: Counter[Outcome] = field(default_factory=Counter)
    now: int = 0
    stops: int = 0
    arrivals: int = 0
    uncertified: int = 0
    touching: int = 0
    peak: float = 0.0


def drive(service: ps.PlannerService, first: ps.PlanResult, changes: Changes, steps: int = STEPS) -> Drive:
    """Execute a plan, replanning every 0.1 s."""
    told = Drive()
    previous: ps.PlanResult | Replanned = first
    at, outcome, request = 0.0, Outcome.NEW, _request(service.robot.home, service.robot.home)
    for step in range(steps):
        old = _trajectory(previous)
        rests = min(at + PERIOD, old.duration) == old.duration
        scenes, goal = changes(step, rests and outcome is not Outcome.STOP)
        clock = time.process_time()
        states = 0
        for scene in scenes:
            found = service.replan(previous, at_time=at, latency=PERIOD, scene=scene, goal=goal, request=request)
            states += found.counts.states
            if found.ok:
                break
            told.now += 1
        told.ms.append((time.process_time() - clock) * 1e3)
        told.states.append(states)
        told.outcomes[found.outcome] += 1
        _stopped(told, old, at, outcome)
        if not found.ok:
            break
        _verified(told, service, scene, found, (old, at))
        previous, at, outcome = found, 0.0, found.outcome
    return told


def _request(start: FloatArray, goal: FloatArray, seed: int = 0) -> ps.PlanRequest:
    return ps.PlanRequest(start, goal, seed=seed, padding=PADDING, max_checks=20_000, time_limit=None)


def _trajectory(motion: ps.PlanResult | Replanned) -> ps.Trajectory:
    if motion.trajectory is None:
        raise ValueError("no motion")
    return motion.trajectory


def _stopped(told: Drive, old: ps.Trajectory, at: float, outcome: Outcome) -> None:
    """Count what ends in the period that begins then: at the goal, or short of it."""
    speeds = old.coefficients[:, 1]
    knots = old.knots[:-1][speeds <= 1e-9 * speeds.max(initial=0.0)]
    told.stops += int(np.sum((knots > at) & (knots <= at + PERIOD)))
    if at < old.duration <= at + PERIOD:
        told.stops += outcome is Outcome.STOP
        told.arrivals += outcome is not Outcome.STOP


def _verified(
    told: Drive, service: ps.PlannerService, scene: ps.Scene, found: Replanned, before: tuple[ps.Trajectory, float]
) -> None:
    """Judge a motion once more, with what is executed of the old one, and measure the splice."""
    (old, at), new = before, _trajectory(found)
    told.uncertified += found.certificate is None or not found.certificate.certified
    checker = service.with_scene(scene).checker
    until = min(at + PERIOD, old.duration)
    times = np.append(np.arange(at, until, SAMPLING), until)
    told.touching += int(np.sum(~checker.states_are_free(np.concatenate([old(times), new.sample(SAMPLING).q]))))
    for order in range(3):
        if order == 2 and until == old.duration:
            break  # from rest any motion begins with a jump of acceleration
        told.jumps[order] = max(told.jumps[order], float(np.abs(old(until, order) - new(0.0, order)).max()))
    if found.result.motion is not None:
        peaks = found.result.motion.peaks
        told.peak = max(told.peak, peaks.velocity.ratio, peaks.acceleration.ratio)


def moving_post(service: ps.PlannerService, query: queries.Query) -> Setting | None:
    """One of the scene's posts moves along a horizontal line, and back, while the robot goes to and fro."""
    post = next(o for o in service.scene.obstacles if o.name == POSTS[service.scene.name])
    rng = np.random.default_rng([queries.SEED, query.number])
    for _ in range(DRAWS):
        angle = rng.uniform(0.0, 2.0 * math.pi)
        places = [_moved(post.pose, angle, distance) for distance in TO_AND_FRO]
        scenes = [service.scene.moved(post.name, place) for place in places]
        found = _to_and_fro(service, query, (scenes, _soon(scenes, post.name)), scenes)
        if found is not None:
            return found
    return None


def unannounced_post(service: ps.PlannerService, query: queries.Query) -> Setting | None:
    """The same without a word of where it will be."""
    setting = moving_post(service, query)
    if setting is None:
        return None
    first, changes = setting

    def change(step: int, arrived: bool) -> Change:
        scenes, goal = changes(step, arrived)
        return Change(scenes[-1:], goal)

    return first, change


def crossing_ball(service: ps.PlannerService, query: queries.Query) -> Setting | None:
    """A ball crosses the middle of the first way, while the robot goes to and fro: the worst there is."""
    path = service.plan(_request(query.start, query.goal, query.number)).unwrap()[0]
    middle = service.robot.tool_pose(path(path.length / 2.0))[:3, 3]
    rng = np.random.default_rng([queries.SEED, query.number])
    for _ in range(DRAWS):
        way = rng.normal(size=3)
        way = way / math.sqrt(math.fsum((way * way).tolist()))
        places = [middle + way * (STRIDE * step - EARLY) for step in range(STEPS)]
        scenes, wide = ([_with_ball(service.scene, at, more) for at in places] for more in (0.0, ROOM))
        found = _to_and_fro(service, query, (scenes, _soon(scenes, "ball")), wide)
        if found is not None:
            return found
    return None


def _soon(scenes: Sequence[ps.Scene], name: str) -> list[tuple[ps.Scene, ...]]:
    """Each scene with what moves also where it will be in some steps, and in fewer."""
    moving = [next(o for o in scene.obstacles if o.name == name) for scene in scenes]
    out = []
    for step, scene in enumerate(scenes):
        ways = []
        for later in LATER:
            there = moving[min(step + later, len(moving) - 1)]
            scene = scene.with_obstacle(replace(there, name=f"{name} in {later} steps"))
            ways.append(scene)
        out.append(tuple(reversed(ways)))
    return out


def _to_and_fro(
    service: ps.PlannerService,
    query: queries.Query,
    worlds: tuple[Sequence[ps.Scene], Sequence[Sequence[ps.Scene]]],
    wide: Sequence[ps.Scene],
) -> Setting | None:
    """The first plan and what follows, if in all of the scenes both ends are free, the wide ones included."""
    ends, (scenes, soon) = np.array([query.start, query.goal]), worlds
    if not all(service.with_scene(scene).checker.states_are_free(ends).all() for scene in (*wide[::SPARSE], *scenes)):
        return None
    first = service.with_scene(scenes[0]).plan(_request(query.start, query.goal, query.number))
    turns = [query.goal]

    def change(step: int, arrived: bool) -> Change:
        if arrived and step:
            turns.append(query.start if turns[-1] is query.goal else query.goal)
        return Change((*soon[step], scenes[step]), turns[-1])

    return (first, change) if first.ok else None


def _with_ball(scene: ps.Scene, centre: FloatArray, more: float) -> ps.Scene:
    return scene.with_obstacle(ps.Obstacle("ball", ps.Sphere(RADIUS + more), ps.Pose(tuple(centre.tolist()))))


def wandering_goal(service: ps.PlannerService, query: queries.Query) -> Setting | None:
    """A goal of the tool that moves along a horizontal line, and back."""
    first = service.plan(_request(query.start, query.goal, query.number))
    there = ps.Pose.from_matrix(service.robot.tool_pose(query.goal))
    rng = np.random.default_rng([queries.SEED, query.number, 1])
    for _ in range(DRAWS):
        angle = rng.uniform(0.0, 2.0 * math.pi)
        goals = [_moved(there, angle, distance) for distance in TO_AND_FRO]
        if all(_reachable(service, goal) for goal in goals):
            return first, _going(service.scene, goals)
    return None


def _going(scene: ps.Scene, goals: Sequence[ps.Pose]) -> Changes:
    return lambda step, arrived: Change((scene,), goals[step])


def _moved(pose: ps.Pose, angle: float, distance: float) -> ps.Pose:
    x, y, z = pose.position
    return ps.Pose((x + distance * math.cos(angle), y + distance * math.sin(angle), z), pose.quaternion)


def _reachable(service: ps.PlannerService, goal: ps.Pose) -> bool:
    return any(service.checker.state_is_free(q) for q in ps.inverse_kinematics(service.robot, goal))


UNANNOUNCED = "a post moves, unannounced"
KINDS = {
    "a post moves": moving_post,
    "the goal moves": wandering_goal,
    "a ball crosses": crossing_ball,
    UNANNOUNCED: unannounced_post,
}
"""Without a word of where it will be a post may be where the robot cannot stop any more: that is told, not promised."""


def rows(scenes: Sequence[str] = SCENES, count: int = RUNS, steps: int = STEPS) -> Iterator[Row]:
    """A row for each kind and scene."""
    for kind, setting in KINDS.items():
        for scene in scenes:
            service = ps.PlannerService(queries.ROBOT, scene)
            settings = filter(None, (setting(service, query) for query in queries.load(scene)))
            drives = [drive(service, *one, steps) for one in islice(settings, count)]
            yield {
                "kind": kind,
                "scene": scene,
                "ms": [ms for told in drives for ms in told.ms],
                "states": [states for told in drives for states in told.states],
                "jumps": [max(told.jumps[order] for told in drives) for order in range(3)],
                "outcomes": {o.name: sum(told.outcomes[o] for told in drives) for o in Outcome},
                **{name: [getattr(told, name) for told in drives] for name in ("stops", "arrivals")},
                **{name: sum(getattr(told, name) for told in drives) for name in ("uncertified", "touching")},
                "peak": max(told.peak for told in drives),
            }


def run() -> Report:
    """Measure it all; about a minute."""
    found = list(rows())
    return Report("replan", tuple(found), (_table(found),), promises(found))


def promises(found: Sequence[Row]) -> tuple[Promise, ...]:
    """What these figures were to be."""
    jumps = [max(row["jumps"][order] for row in found) for order in range(3)]
    wrong = [sum(row[name] for row in found) for name in ("uncertified", "touching")]
    announced = [row for row in found if row["kind"] != UNANNOUNCED]
    unsafe = sum(row["outcomes"][Outcome.UNSAFE.name] for row in announced)
    times = "; ".join(f"{row['scene']} {spread(row['ms'], 1)}" for row in found)
    in_time = all(p95(row["ms"]) <= MOST_MS for row in found)
    usual = [p50(row["ms"]) for row in found]
    stops = "; ".join(f"{row['scene']} {max(row['stops'])}" for row in found)
    few_stops = all(max(row["stops"]) <= MOST_STOPS for row in found)
    told = ", ".join(f"{jump:.1e}" for jump in jumps)
    return (
        Promise(f"{STEPS} steps in a row, each inside {MOST_MS:g} ms at p95", times, in_time),
        Promise(f"a step in at most {USUAL_MS:g} ms at p50", f"at most {max(usual):.1f}", max(usual) <= USUAL_MS),
        Promise("every motion certified, and nothing touched", f"{wrong[0]} and {wrong[1]} samples", not any(wrong)),
        Promise("a certified motion at every step, if what moves is announced", f"{unsafe} without", not unsafe),
        Promise("at the splice q, qd and qdd go on without a jump", told, max(jumps) <= MOST_JUMP),
        Promise(f"at most {MOST_STOPS} full stops in {STEPS} steps", stops, few_stops),
    )


def _table(found: Sequence[Row]) -> Table:
    lines = (
        {
            "": row["kind"],
            "scene": row["scene"],
            "steps": len(row["ms"]),
            "ms": spread(row["ms"], 1),
            "states": spread(row["states"]),
            **row["outcomes"],
            "full stops": " ".join(map(str, row["stops"])),
            "arrivals": sum(row["arrivals"]),
            "peak": f"{row['peak']:.9f}",
        }
        for row in found
    )
    caption = (
        f"p50 / p95 of CPU ms and states of each step, the new scene's checkers included; {RUNS} runs of {STEPS} steps "
        f"each, which end where nothing is safe. Where what moves will be in {LATER[-1]} steps is part of the scene, "
        f"unless it comes unannounced. Full stops short of a goal, run by run; peak: the largest share of a limit."
    )
    return table_of("Replanning at 10 Hz", lines, caption=caption)
