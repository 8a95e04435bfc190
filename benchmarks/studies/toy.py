"""The lesson's two-joint program and its exercise, recomputed."""

from __future__ import annotations

from benchmarks.baselines.lesson import Toy, ToyRun, length_of, stop_and_go_seconds
from benchmarks.harness.report import Promise, Report, p50, p95, table

__all__ = ["exercise", "run"]

SEEDS = 50


def exercise(run: ToyRun) -> dict[str, float]:
    """What the exercise asks of one run: checks, lengths in rad, seconds."""
    return {
        "growth checks": run.growth,
        "shortcut checks": run.shortcut,
        "total checks": run.checks,
        "raw length": length_of(run.raw),
        "shortcut length": length_of(run.short),
        "raw seconds": stop_and_go_seconds(run.raw),
        "shortcut seconds": stop_and_go_seconds(run.short),
    }


def run() -> Report:
    """Seed 7 and seeds 0 to 49."""
    runs = {seed: Toy.run(seed) for seed in range(SEEDS)}
    rows = {seed: exercise(run) for seed, run in runs.items()}
    seven = runs[7]

    def cells(key: str) -> tuple[str, str, str, str]:
        values = [row[key] for row in rows.values()]
        digits = 0 if "checks" in key else 3
        return key, f"{rows[7][key]:,.{digits}f}", f"{p50(values):,.{digits}f}", f"{p95(values):,.{digits}f}"

    measured = f"{seven.checks:,} checks, {len(seven.raw)} -> {len(seven.short)} waypoints"
    title = f"The lesson's toy, seeds 0 to {SEEDS - 1}"
    kept = (seven.checks, len(seven.raw), len(seven.short)) == (18_793, 49, 3)
    return Report(
        "toy",
        tuple({"seed": seed, **row, "waypoints": len(runs[seed].short)} for seed, row in rows.items()),
        (table(title, ("", "seed 7", "p50", "p95"), [cells(key) for key in rows[7]]),),
        (Promise("toy, seed 7: 18,793 checks, 49 -> 3 waypoints", measured, kept),),
    )
