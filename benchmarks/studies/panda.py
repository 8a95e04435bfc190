"""The public Panda problems for speed: this version next to 0.1.0, and next to other planners, in one run.

Every planner has a process of its own, and they take turns problem by problem, so that what disturbs the machine
disturbs all. Ours are asked with the default request; the peers as their makers recommend. The same auditor judges all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.baselines.peers.catalogue import PEERS
from benchmarks.baselines.peers.environments import Environment
from benchmarks.baselines.peers.running import STEPS, Run, rows_of, tasks_of
from benchmarks.baselines.peers.versions import HERE, THEN, TURNS, version_here, version_then
from benchmarks.harness.report import Promise, Report, Row, grouped, p50, p95, spread, table_of
from planner_service.errors import InvalidRequest

__all__ = ["SEEDS", "promises", "rows_in_turn", "run"]

SUITE = "panda"
SEEDS = 5

VAMP_MS = 0.035
"""Its own figure for the median search of these problems: arXiv 2309.14545, one core of a Ryzen 9 7950X."""

WHOLE_P50, WHOLE_P95, SEARCH_P50, SEARCH_P95 = 0.33, 0.25, 0.25, 0.12
"""Promised: parts of what 0.1.0 takes in the same run."""

LENGTH_P50 = 4.8
"""Promised: radians, L2 over the joints."""


def rows_in_turn(environments: Sequence[Environment], seeds: int, only: int | None = None) -> Iterator[Row]:
    """A results row of each planner for each problem and seed; a planner plans while the others wait.

    Args:
        only: So many problems, spread over the suite; all if None.
    """
    robot, tasks = tasks_of(SUITE, range(seeds), only)
    by_problem = sorted(tasks, key=lambda task: task.problem.id)  # what a scene needs is made once
    with ExitStack() as stack:
        asked = []
        for environment in environments:
            planner = next(iter(environment.peer.planners))
            run = Run(environment.peer, planner, SUITE, robot, tuple(by_problem))
            asked.append(stack.enter_context(closing(rows_of(run, environment, by_problem))))
        for k in range(len(by_problem)):
            yield from map(next, asked if k % 2 == 0 else asked[::-1])  # nobody is always the first


def run(seeds: int = SEEDS, against: Path | None = None, only: int | None = None) -> Report:
    """Plan all problems with each seed; some minutes with the peers.

    Args:
        against: The python of an environment with the version to compare with; 0.1.0, installed when needed, if None.
        only: So many problems, spread over the suite; all if None.

    Raises:
        InvalidRequest: no seed; or there is no such version, and it cannot be installed.
    """
    if not seeds:
        raise InvalidRequest("--seeds", seeds, "at least 1")
    peers = [Environment.of(peer) for peer in PEERS.values()]
    for peer in peers:
        if not peer.ready:
            peer.install()
    asked = [version_here(), version_then(against), *(peer for peer in peers if peer.ready)]
    console = Console(stderr=True)
    rows = tuple(
        track(
            rows_in_turn(asked, seeds, only),
            "panda",
            total=len(asked) * len(tasks_of(SUITE, range(seeds), only)[1]),
            console=console,
            disable=not console.is_terminal,
        )
    )
    left_out = [f"{peer.peer.name}: {peer.state}." for peer in peers if not peer.ready]
    return Report(SUITE, rows, (_table(rows, left_out), _ratio_table(rows)), promises(rows))


def _ms(rows: Sequence[Row], stage: str | None = None) -> list[float]:
    """CPU milliseconds of whole plans, or of a stage."""
    return [(row["cpu_seconds"] if stage is None else row["stage_cpu_seconds"].get(stage, 0.0)) * 1e3 for row in rows]


def _rejected(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["ok"] and row["audit"]["verdict"] != "free"]


def _name(rows: Sequence[Row]) -> str:
    """The planner's name, and its version as its process told it."""
    tool = rows[0]["tool"]
    told: dict[str, str] = next((row["versions"] for row in rows if row["versions"]), {})
    version = next(iter(told.values()), "")
    return f"{tool.partition('-0.')[0]} {version}" if tool in (HERE, THEN) else f"{tool} {told.get(tool, '')}".strip()


def _table(rows: Sequence[Row], left_out: Sequence[str]) -> Table:
    def line(here: Sequence[Row]) -> Row:
        done, rejected = [row for row in here if row["ok"]], _rejected(here)
        deepest = max((row["audit"]["depth"] or 0.0 for row in rejected), default=0.0)
        timed = [row["duration"] for row in done if row["duration"] is not None]
        whole = _ms(here)
        return {
            "planner": _name(here),
            "solved": f"{len(done)}/{len(here)}",
            "rejected": f"{len(rejected)} ({len(rejected) / max(len(done), 1):.0%}, {deepest * 1e3:.1f} mm)",
            "search ms": spread(_ms(here, "search"), 2),
            "whole ms": f"{spread(whole, 1)} / {max(whole):,.0f}",
            "rad p50": f"{p50(row['length'] for row in done):.2f}" if done else "-",
            "motion s p50": f"{p50(timed):.2f}" if timed else "not timed",
        }

    lines = [line(here) for here in grouped(rows, "tool").values()]
    published = dict.fromkeys(lines[0], "-") | {"planner": "vamp, its own figure", "search ms": f"{VAMP_MS} / -"}
    caption = (
        "CPU ms, p50 / p95 / most, failures included, with the world built before. Whole: search, shortcut, timing; "
        f"ours with the proof, and the least of {TURNS} turns. Rejected: by the auditor, of paths or timed motions, in "
        f"joint steps of {STEPS[0]:g} and {STEPS[-1]:g} rad; share of the solved, and deepest. vamp: its median "
        "search on its own spheres, as published, on another processor; not run here."
    )
    caption = " ".join([caption, *left_out])
    return table_of("Public Panda problems", [*lines, published], caption=caption)


def _ratios(rows: Sequence[Row], stage: str | None = None) -> tuple[list[float], list[float]]:
    """Parts of the older version's milliseconds at p50 and p95, and these milliseconds."""
    now, then = _both(rows, stage)
    return [at(now) / at(then) for at in (p50, p95)], [at(then) for at in (p50, p95)]


def _both(rows: Sequence[Row], stage: str | None) -> list[list[float]]:
    """Milliseconds of this version and of the older one."""
    by_tool = grouped(rows, "tool")
    return [_ms(by_tool[tool], stage) for tool in (HERE, THEN)]


def _ratio_table(rows: Sequence[Row]) -> Table:
    stages = dict.fromkeys(stage for row in rows if row["tool"] == HERE for stage in row["stage_cpu_seconds"])
    del stages["setup"]

    def line(name: str, stage: str | None) -> Row:
        now, then = _both(rows, stage)
        ratio = f"{p50(now) / p50(then):.2f} / {p95(now) / p95(then):.2f}" if p50(then) and p95(then) else "-"
        return {"stage": name, "ms": spread(now, 2), "ms then": spread(then, 2), "ratio": ratio}

    caption = "CPU ms and ratios of p50 / p95; both versions planned each problem in turn."
    lines = [line("whole", None), *(line(stage, stage) for stage in stages)]
    return table_of(f"Next to {_name(grouped(rows, 'tool')[THEN])}, stage by stage", lines, caption=caption)


def promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    """What these figures were to be."""
    ours = [row for row in rows if row["tool"] == HERE]
    lost = [f"{row['problem']} seed {row['seed']}: {row['detail']}" for row in ours if not row["ok"]]
    rejected = [f"{row['problem']} seed {row['seed']}: {row['audit']['pair']}" for row in _rejected(ours)]
    length = p50(row["length"] for row in ours if row["ok"]) if len(lost) < len(ours) else float("inf")
    return (
        Promise(f"{len(ours)} of {len(ours)} plans by the default request", "; ".join(lost) or "all", not lost),
        Promise("0 rejected by the auditor", "; ".join(rejected) or "none", not rejected),
        _faster("whole plans", None, WHOLE_P50, WHOLE_P95, rows),
        _faster("search", "search", SEARCH_P50, SEARCH_P95, rows),
        Promise(f"length at most {LENGTH_P50:g} rad at p50", f"{length:.2f}", length <= LENGTH_P50),
    )


def _faster(what: str, stage: str | None, at_p50: float, at_p95: float, rows: Sequence[Row]) -> Promise:
    (first, second), then = _ratios(rows, stage)
    older = _name(grouped(rows, "tool")[THEN])
    text = f"{what}: at most {at_p50:g} / {at_p95:g} of the CPU time of {older} at p50 / p95"
    measured = f"{first:.2f} / {second:.2f} of {then[0]:.2f} / {then[1]:.2f} ms"
    return Promise(text, measured, first <= at_p50 and second <= at_p95)
