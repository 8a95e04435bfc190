"""Picks shared out between two arms: how long they take, and whether anything touches, however late arms are.

Twelve blocks lie in a bin between two WidowX AI, one colour for each arm's tray. In ``near`` every block goes to the
tray of its half of the bin, in ``mixed`` colours are drawn, so that arms reach past each other. Each schedule is proven
again and carried out many times with arms that are late, each for itself, by as much as is tolerated: by a constant, or
by another amount at every moment. FCL judges both arms, what they hold, and all objects where they are by then. A
schedule in which each arm goes on at once, without the waits, is planted: it is proven, or else what touches is found.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from rich.progress import track
from rich.table import Table

import planner_service as ps
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, p50, spread, table_of
from planner_service.cell import Arm, Cell
from planner_service.geometry.arrays import FloatArray
from planner_service.scheduling import PickJob, Schedule, prove_schedule, schedule_picks
from tests.reference.schedule import Sampler, lateness

__all__ = ["run"]

BLOCKS = 12
"""Of each schedule, at most: as many as the bin holds."""

SCHEDULES = 5
"""Of each kind."""

EXECUTIONS, MOMENTS = 20, 400
"""Of each schedule, with late arms, and the moments of each at which it is judged."""

DELAY = 0.1
"""Seconds that schedules are asked to tolerate."""

SHARE = 0.65
"""Of the time of the same picks one after the other, at most."""

KINDS = ("near", "mixed")


def run(schedules: int | None = None, seed: int = 0, *, blocks: int = BLOCKS, executions: int = EXECUTIONS) -> Report:
    """Schedule that many picks so many times of each kind, and carry out each schedule so many times."""
    rows = list(_rows(SCHEDULES if schedules is None else schedules, seed, blocks, executions))
    return Report("two-arms", tuple(rows), (_table(rows),), tuple(_promises(rows)))


def cell_and_jobs(kind: str, rng: np.random.Generator, blocks: int = BLOCKS) -> tuple[Cell, list[PickJob]]:
    """A bin of blocks, each near a place of a grid of three by four, and where each of them goes."""
    walls = {
        "table": ((1.4, 1.4, 0.1), (0.3, 0.0, -0.051)),
        "bin_front": ((0.008, 0.36, 0.06), (0.17, 0.0, 0.03)),
        "bin_back": ((0.008, 0.36, 0.06), (0.43, 0.0, 0.03)),
        "bin_left": ((0.252, 0.008, 0.06), (0.3, 0.176, 0.03)),
        "bin_right": ((0.252, 0.008, 0.06), (0.3, -0.176, 0.03)),
    }
    obstacles = [ps.Obstacle(name, ps.Box(size), ps.Pose(at)) for name, (size, at) in walls.items()]
    jobs, filled = list[PickJob](), {1: 0, -1: 0}
    sides = rng.permutation([1] * 6 + [-1] * 6)
    for k in range(blocks):
        i, j = divmod(k, 4)
        x, y = 0.23 + 0.065 * i + rng.uniform(-0.008, 0.008), -0.12 + 0.08 * j + rng.uniform(-0.008, 0.008)
        block = ps.Obstacle(
            f"block_{k}", ps.Box((0.03, 0.03, 0.04)), ps.Pose.from_rpy((x, y, 0.021), (0, 0, rng.uniform(0, 3)))
        )
        side = (1 if j >= 2 else -1) if kind == "near" else int(sides[k])
        row, column = divmod(filled[side], 3)
        filled[side] += 1
        place = ps.Pose((0.2 + 0.08 * column, side * (0.27 + 0.08 * row), 0.021), block.pose.quaternion)
        obstacles.append(block)
        jobs.append(PickJob(block.name, place, "table"))
    robot = ps.load_robot("wxai")
    arms = {name: Arm(robot, ps.Pose((0.0, y, 0.0))) for name, y in (("left", 0.25), ("right", -0.25))}
    return Cell(arms, ps.Scene(tuple(obstacles), name=kind)), jobs


def _rows(schedules: int, seed: int, blocks: int, executions: int) -> Iterator[Row]:
    for kind in KINDS:
        for k in track(range(schedules), description=f"picks, {kind}", transient=True):
            rng = np.random.default_rng([seed, k])
            cell, jobs = cell_and_jobs(kind, rng, blocks)
            ms, schedule = cpu_ms(partial(schedule_picks, cell, jobs, delay=DELAY))
            row: Row = {"kind": kind, "schedule": k, "ms": ms, "ok": schedule.ok}
            row |= {"why": "" if schedule.failure is None else str(schedule.failure)}
            yield row | (_carried_out(schedule, rng, executions) if schedule.ok else {})


def _carried_out(schedule: Schedule, rng: np.random.Generator, executions: int) -> Row:
    row: Row = {"seconds": schedule.duration, "in turn": schedule.sequential, "tolerates": schedule.tolerates}
    row |= {"rectangles": schedule.rectangles, "bounds": schedule.distances}
    row["shares"] = {name: len(schedule.of_arm(name)) for name in schedule.starts}
    row["proof ms"], proven = cpu_ms(partial(prove_schedule, schedule))
    row |= {"proven": proven.certified, "executions": executions}
    row["touched"] = _touched(schedule, rng, schedule.tolerates, executions)
    hasty = _without_waits(schedule)
    row["waits"] = hasty is not schedule
    row["planted proven"] = prove_schedule(hasty).certified
    row["planted touched"] = _touched(hasty, rng, 0.0, 1)
    return row


def _touched(schedule: Schedule, rng: np.random.Generator, most: float, executions: int) -> int:
    """Executions in which something touches."""
    sampler = Sampler(schedule)
    times: FloatArray = np.linspace(0.0, schedule.duration + most, MOMENTS, dtype=np.float64)
    return sum(any(sampler.contacts(times, lateness(schedule, times, rng, most))) for _ in range(executions))


def _without_waits(schedule: Schedule) -> Schedule:
    """The same where each chain starts when its arm is through with the one before; itself if none waits."""
    starts = dict[int, float]()
    for name in schedule.starts:
        until = 0.0
        for chain in schedule.of_arm(name):
            starts[id(chain)] = until
            until += chain.seconds
    if all(abs(starts[id(chain)] - chain.start) < 1e-6 for chain in schedule.chains):
        return schedule
    return replace(schedule, chains=tuple(replace(chain, start=starts[id(chain)]) for chain in schedule.chains))


def _table(rows: Sequence[Row]) -> Table:
    def line(kind: str, here: Sequence[Row]) -> Row:
        done = [row for row in here if row["ok"]]
        shares = [row["seconds"] / row["in turn"] for row in done]
        planted = [row for row in done if row["waits"]]
        return {
            "picks": kind,
            "schedules": len(here),
            "planned": len(done),
            "seconds": spread([row["seconds"] for row in done], 1) if done else "",
            "one after the other": spread([row["in turn"] for row in done], 1) if done else "",
            "share": spread(shares, 2) if done else "",
            "tolerates s": f"{min(row['tolerates'] for row in done):.3f}" if done else "",
            "CPU s": spread([row["ms"] / 1e3 for row in here], 1),
            "proof, CPU s": spread([row["proof ms"] / 1e3 for row in done], 1) if done else "",
            "proven again": sum(row["proven"] for row in done),
            "late executions touching": f"{sum(r['touched'] for r in done)} of {sum(r['executions'] for r in done):,}",
            "without waits: proven, touching": f"{sum(r['planted proven'] for r in planted)}, "
            f"{sum(r['planted touched'] for r in planted)} of {len(planted)}",
        }

    return table_of("Picks of two arms", [line(*each) for each in grouped(rows, "kind").items()], caption="p50 / p95.")


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    for kind, here in grouped(rows, "kind").items():
        done = [row for row in here if row["ok"]]
        yield Promise(f"{kind}: all picks are scheduled", f"{len(done)} of {len(here)}", len(done) == len(here))
        if done:
            share = p50([row["seconds"] / row["in turn"] for row in done])
            text = f"{kind}: at most {SHARE} of the time one after the other, p50"
            yield Promise(text, f"{share:.2f}", share <= SHARE)
    done = [row for row in rows if row["ok"]]
    touched, executions = (sum(row[key] for row in done) for key in ("touched", "executions"))
    yield Promise("no execution of picks with late arms touches, by FCL", f"{touched} of {executions:,}", not touched)
    proven = sum(row["proven"] for row in done)
    yield Promise("every schedule is proven again", f"{proven} of {len(done)}", proven == len(done))
    wrong = sum(row["planted proven"] and row["planted touched"] for row in done)
    yield Promise("no schedule without waits that touches is proven", f"{wrong} of {len(done)}", not wrong)
