"""A thousand episodes: written, read back, audited by a checker that is not ours."""

from __future__ import annotations

import json
import resource
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from pathlib import Path

from rich.table import Table

from benchmarks.harness.report import Promise, Report, table
from benchmarks.studies.episode_audit import Audit, EpisodeAudit
from benchmarks.worlds import queries
from planner_service import load_robot
from planner_service.datasets import EpisodesSummary, EpisodeWork, episode_task, write_episodes
from planner_service.parallel import Lost, Processes
from planner_service.parallel.processes import available_cores

__all__ = ["run"]

COUNT, FIRST = 1000, 100
"""Requests, and how many of them are made first, to see whether memory grows."""

SEED = 0

MOST_FAILURES = 0.05

OPEN = {"journal.jsonl", "frames"}
"""What is kept in ``meta`` to go on with."""

READER = """
import json, sys
from importlib.metadata import version
from lerobot.datasets.lerobot_dataset import LeRobotDataset
read = LeRobotDataset("local/episodes", root=sys.argv[1])
episodes = [int(frame["episode_index"]) for frame in read]
print(json.dumps({"lerobot": version("lerobot"), "frames": len(episodes), "episodes": len(set(episodes))}))
"""
"""What an environment with LeRobot runs: every frame is read through LeRobot's own class."""

KEPT = ("requests", "episodes", "failures", "motions", "certified", "frames", "motion_seconds", "states")
"""The fields of the summary that are printed."""


@dataclass(frozen=True)
class _Cost:
    """Of making the data set: wall seconds, CPU seconds of this process and of the workers, and peak memory in MB."""

    wall: float
    writer: float
    workers: float
    memory: float

    @classmethod
    def now(cls) -> _Cost:
        own, others = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        writer, workers = (usage.ru_utime + usage.ru_stime for usage in (own, others))
        return cls(time.perf_counter(), writer, workers, own.ru_maxrss / 1024)

    def since(self, before: _Cost) -> _Cost:
        """What came after; memory is what was added to the peak."""
        return _Cost(*(now - then for now, then in zip(astuple(self), astuple(before), strict=True)))


def run(seed: int = SEED, against: Path | None = None) -> Report:
    """Write the data set with a worker on every core, then ask about every motion and every frame of it.

    Args:
        against: The interpreter of an environment with LeRobot, which reads it, too.
    """
    work = EpisodeWork(load_robot(queries.ROBOT), episode_task("pick-place"), seed=seed)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "episodes"
        write_episodes(folder, work, FIRST)
        start = _Cost.now()
        summary = write_episodes(folder, work, COUNT)
        cost = _Cost.now().since(start)
        sizes = _sizes(folder)
        audits = list(_audited(folder, summary.episodes))
        read = None if against is None else _read_by_lerobot(folder, against)
    row = {
        "read": read,
        **{key: getattr(summary, key) for key in KEPT},
        "seed": seed,
        "cost": vars(cost),
        "new": summary.new,
        "cores": available_cores(),
        "bytes": sizes,
        "audited": {"configurations": sum(a.configurations for a in audits), "frames": sum(a.frames for a in audits)},
        "objections": [f"episode {k}: {text}" for k, audit in enumerate(audits) for text in audit.objections],
    }
    rejected = sum(bool(audit.objections) for audit in audits)
    promises = _promises(row, rejected)
    if read is not None:
        whole = (read.get("frames"), read.get("episodes")) == (summary.frames, summary.episodes)
        promises += (Promise("LeRobot reads every frame of every episode", json.dumps(read), whole),)
    return Report("episodes", (row,), (_table(summary, cost, sizes),), promises)


def _read_by_lerobot(folder: Path, python: Path) -> dict[str, object]:
    """What LeRobot in another environment finds, or what it says instead."""
    done = subprocess.run([python, "-c", READER, folder], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        return {"error": done.stderr.strip()[-500:]}
    found: dict[str, object] = json.loads(done.stdout.splitlines()[-1])
    return found


def _audited(folder: Path, episodes: int) -> Iterator[Audit]:
    """What the independent checker says of each; a worker that dies has objected."""
    answers = Processes().run(EpisodeAudit(str(folder), queries.ROBOT), range(episodes))
    for _, answer in answers:
        yield Audit(objections=[answer.detail]) if isinstance(answer, Lost) else answer


def _sizes(folder: Path) -> dict[str, float]:
    """Bytes per episode in frames, tables and the rest; what is kept to go on with is not counted."""
    episodes = json.loads((folder / "meta" / "info.json").read_text("utf-8"))["total_episodes"]
    sums = dict.fromkeys(("data", "tables", "meta"), 0)
    for part in sums:
        files = (file for file in (folder / part).rglob("*") if file.is_file() and not OPEN & set(file.parts))
        sums[part] = sum(file.stat().st_size for file in files)
    return {part: size / episodes for part, size in sums.items()}


def _table(summary: EpisodesSummary, cost: _Cost, sizes: dict[str, float]) -> Table:
    share = 1 - summary.episodes / summary.requests
    failed = ", ".join(f"{number} {reason}" for reason, number in summary.failures.items()) or "none"
    per_core = (cost.writer + cost.workers) / summary.new
    rows = [
        ("requests, episodes", f"{summary.requests:,}, {summary.episodes:,}"),
        ("failures", f"{failed} ({100 * share:.1f} %)"),
        ("motions, certified", f"{summary.motions:,}, {summary.certified:,}"),
        ("frames, seconds of motion", f"{summary.frames:,}, {summary.motion_seconds:,.0f}"),
        ("states per request", f"{summary.states / summary.requests:,.0f}"),
        ("CPU seconds per request", f"{per_core:.3f}"),
        ("of these the writer's", f"{cost.writer / summary.new:.4f}"),
        ("requests per second and core", f"{1 / per_core:.1f}"),
        (f"requests per second, {available_cores()} cores, wall", f"{summary.new / cost.wall:.1f}"),
        ("bytes per episode: frames, tables, meta", " + ".join(f"{size:,.0f}" for size in sizes.values())),
        (f"memory added to the writer after {FIRST} requests, MB", f"{cost.memory:.1f}"),
    ]
    return table("Episodes of pick-place", ("what", "measured"), rows)


def _promises(row: dict[str, object], rejected: int) -> tuple[Promise, ...]:
    requests, episodes, motions = (int(str(row[key])) for key in ("requests", "episodes", "motions"))
    uncertified = motions - int(str(row["certified"]))
    share = 1 - episodes / requests
    return (
        Promise(f"{COUNT:,} requests: 0 uncertified motions", str(uncertified), uncertified == 0),
        Promise("0 episodes rejected by the independent checker", str(rejected), rejected == 0),
        Promise("at most 5 % of the requests fail", f"{100 * share:.1f} %", share <= MOST_FAILURES),
    )
