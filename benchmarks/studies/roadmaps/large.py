"""A hundred thousand milestones: built, saved, loaded, asked for the first time and again, and what they take up."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.table import Table

from benchmarks.harness.environment import ROOT
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, p50, spread, table_of
from benchmarks.studies.roadmaps.asked import TRAINING_SEED, asked, chained
from benchmarks.worlds import queries
from planner_service import LazyPRM, PlannerService, Roadmap
from planner_service.errors import BrokenInvariant

__all__ = ["large_rows", "measured", "promises", "size_row"]

SCENES = ("bin", "shelf")
MILESTONES = 100_000
OTHERS = 20
"""Other queries that are planned before the stored ones."""

LOAD_SECONDS, WARM_MS = 2.0, 20.0

CHILD = """\
import json, sys, time

from benchmarks.worlds import queries
from benchmarks.studies.states import plan
from planner_service import PlannerService, Roadmap
import scipy.spatial

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096

query = queries.load(sys.argv[2])[0]
service = PlannerService(queries.ROBOT, sys.argv[2])
plan(service, query)
empty, clock = resident(), time.process_time()
roadmap = Roadmap.load(sys.argv[1])
seconds, loaded = time.process_time() - clock, resident()
plan(service, query, planner=roadmap)
print(json.dumps({"load": seconds, "loaded": loaded - empty, "asked": resident() - empty}))
"""
"""Loads a roadmap in a process that has planned, and tells what that took, of memory also when it was asked once."""


def large_rows(scenes: Sequence[str] = SCENES, milestones: int = MILESTONES, others: int = OTHERS) -> Iterator[Row]:
    """A row of sizes, then one for each scene and kind of query."""
    first, planner = PlannerService(queries.ROBOT, scenes[0]), LazyPRM(milestones=milestones, neighbours=10)
    ms, built = cpu_ms(lambda: first.build_roadmap(planner, progress=False))
    yield {"part": "size", "build": ms / 1e3} | size_row(built)
    for scene in scenes:
        service = first.with_scene(scene)  # nothing is judged yet: it serves all
        roadmap = replace(built, remember=True)
        before, stored = queries.draw(scene, others, seed=TRAINING_SEED), queries.load(scene)
        for what, some in (("first of all", before), ("others", stored)):
            row, roadmap = chained(service, roadmap, some)
            yield {"part": "query", "scene": scene, "what": what} | row
        again = replace(roadmap, remember=False)
        yield {"part": "query", "scene": scene, "what": "again"} | asked(service, again, stored, turns=2)


def size_row(roadmap: Roadmap) -> Row:
    """Seconds to save and load, and bytes per milestone in the file and in memory."""
    count = len(roadmap.milestones)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "large.roadmap.npz"
        save, _ = cpu_ms(lambda: roadmap.save(file))
        told = _child(file)
        tracemalloc.start()
        loaded = Roadmap.load(file)
        kept, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        if loaded.hash != roadmap.hash:
            raise BrokenInvariant("a roadmap that was saved is not the one that was loaded")
        return {
            "milestones": count,
            "edges": len(roadmap.edges),
            "save": save / 1e3,
            "load": told["load"],
            "file": file.stat().st_size / count,
            "traced": kept / count,
            "resident": told["loaded"] / count,
            "resident_asked": told["asked"] / count,
        }


def _child(file: Path) -> dict[str, float]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", CHILD, str(file), SCENES[0]]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BrokenInvariant(f"a fresh process could not load a roadmap: {done.stderr.strip()[-500:]}")
    told: dict[str, float] = json.loads(done.stdout)
    return told


def measured() -> Report:
    """Measure."""
    rows = tuple(large_rows())
    return Report("large", rows, (_size_table(rows[0]), _query_table(rows[1:])), promises(rows))


def promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    """What a large roadmap was to take."""
    size, again = rows[0], [row for row in rows if row.get("what") == "again"]
    ms = [p50(row["search_ms"]) for row in again]
    load = f"{size['milestones']:,} milestones load in less than {LOAD_SECONDS:g} s"
    warm = f"{size['milestones']:,} milestones: a warm query takes less than {WARM_MS:g} ms p50"
    told = "; ".join(f"{row['scene']} {value:.1f}" for row, value in zip(again, ms, strict=True))
    return (
        Promise(load, f"{size['load']:.2f} s", size["load"] < LOAD_SECONDS),
        Promise(warm, told, max(ms) < WARM_MS),
    )


def _size_table(row: Row) -> Table:
    line = {key: f"{row[key]:,}" for key in ("milestones", "edges")}
    line |= {f"{key} s": f"{row[key]:.2f}" for key in ("build", "save", "load")}
    sizes = {"file": "file", "arrays": "traced", "resident": "resident", "asked, resident": "resident_asked"}
    line |= {f"{name} B": f"{row[key]:.0f}" for name, key in sizes.items()}
    caption = (
        f"LazyPRM({MILESTONES}, 10). CPU seconds; bytes per milestone, six joints. Arrays: what the load allocates and "
        "keeps; resident: by how much its process grows; asked: after its first query."
    )
    return table_of("A large roadmap", [line], caption=caption)


def _query_table(rows: Sequence[Row]) -> Table:
    lines = (
        {
            "scene": row["scene"],
            "asked": row["what"],
            "search states": spread(row["states"]),
            "search ms": spread(row["search_ms"], 1),
            "before proof ms": spread(row["before_ms"], 1),
            "fell back": row["fell_back"],
            "solved": f"{row['solved']}/{row['asked']}",
        }
        for row in rows
    )
    caption = (
        "p50 / p95, CPU ms. Each query is asked of the roadmap that the one before left, paths remembered. First of "
        f"all: {OTHERS} drawn ones; others: the stored ones; again: these once more."
    )
    return table_of("Queries of a large roadmap", lines, caption=caption)
