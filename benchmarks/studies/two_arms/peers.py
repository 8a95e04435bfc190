"""Two WidowX AI side by side, planned by this package, by OMPL's RRT-Connect as one robot, and by SRMP's xECBS.

The same queries, and one auditor: Coal judges each motion as it is timed, at steps of 10 ms. SRMP rounds starts and
goals to its grid of one degree and times motions by its primitives, without the arms' limits of acceleration; it runs
with its defaults in a process of its own, with the pairs of links that this package does not judge, and is ended after
``PATIENCE`` seconds.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.progress import track
from rich.table import Table

import planner_service as ps
from auditor.checker import robot_table
from benchmarks.harness.audit import Auditor
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, spread, table_of
from benchmarks.studies.two_arms.plans import DELAY
from benchmarks.worlds.placed import table_of_arms
from planner_service.cell import Arm, Cell
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray

__all__ = ["QUERIES", "run"]

QUERIES, SCENES = 20, ("shelf", "bin")
"""Of each scene."""

PATIENCE, STARTING = 20.0, 120.0
"""Seconds for a query, and for SRMP to load the cell."""

ANSWER, CHILD = "ANSWER ", Path(__file__).parents[2] / "baselines" / "peers" / "srmp_several.py"
"""How its answers begin, and what is run with SRMP."""

TOO_FAST = 1.01
"""Of the limits of velocity."""

STEP = 0.01
"""Seconds between two configurations that Coal judges."""

OURS, OMPL, SRMP = "this package, own clocks", "OMPL RRT-Connect, one robot", "SRMP xECBS"

PLACES = {side: ("wxai", ps.Pose((0.0, y, 0.0))) for side, y in (("left", 0.25), ("right", -0.25))}
"""Robots and their bases, by the names of the arms."""

Planned = tuple[float, FloatArray | None, str]
"""Milliseconds of CPU time, configurations of all arms every ``STEP`` seconds, or why there are none."""


def run(queries: int | None, seed: int, python: Path | None) -> Report:
    """Plan that many random queries in each scene.

    Args:
        python: Of an environment with SRMP; without it SRMP is left out.
    """
    rows = [row for scene in SCENES for row in _rows(scene, QUERIES if queries is None else queries, seed, python)]
    return Report("two-arms", tuple(rows), (_table(rows),), tuple(_promises(rows)))


def _rows(scene: str, queries: int, seed: int, python: Path | None) -> Iterator[Row]:
    rng = np.random.default_rng([seed, len(scene)])
    cell = Cell({side: Arm(ps.load_robot(robot), base) for side, (robot, base) in PLACES.items()}, scene)
    with TemporaryDirectory() as place:
        auditor = Auditor(table_of_arms(PLACES, Path(place)), cell.scene)
        planners: dict[str, Callable[[FloatArray, FloatArray], Planned]] = {
            OURS: partial(_own_clocks, cell),
            OMPL: partial(_composite, cell),
        }
        srmp = None if python is None else _Srmp(python, cell, Path(place))
        if srmp is not None:
            planners[SRMP] = srmp.planned
        try:
            for k in track(range(queries), description=f"peers in {scene}", transient=True):
                start, goal = (_free(cell, rng) for _ in range(2))
                for name, planned in planners.items():
                    ms, Q, why = planned(start, goal)
                    row: Row = {"scene": scene, "query": k, "planner": name, "ms": ms, "why": why}
                    row |= {"seconds": None, "audit": "none", "off": 0.0, "speed": 0.0}
                    if Q is not None:
                        ends = np.abs(Q[0] - start).max(), np.abs(Q[-1] - goal).max()
                        row |= {"seconds": STEP * (len(Q) - 1), "off": max(map(float, ends))}
                        row["audit"] = auditor.judge(Q)["verdict"]
                        rates = np.abs(np.diff(Q[:-1], axis=0)).max(axis=0, initial=0.0) / STEP
                        row["speed"] = float((rates / cell.robot.limits.velocity).max())
                    yield row
        finally:
            if srmp is not None:
                srmp.close()


def _free(cell: Cell, rng: np.random.Generator) -> FloatArray:
    limits, checker = cell.robot.limits, cell.service.checker
    while True:
        q = np.asarray(rng.uniform(limits.lower, limits.upper))
        if checker.state_is_free(q):
            return q


def _times(duration: float) -> FloatArray:
    return np.append(np.arange(0.0, duration, STEP), duration)


def _own_clocks(cell: Cell, start: FloatArray, goal: FloatArray) -> Planned:
    requests = {name: ps.PlanRequest(cell.of_arm(name, start), cell.of_arm(name, goal)) for name in cell.arms}
    ms, plan = cpu_ms(partial(cell.plan, requests, delay=DELAY))
    return (ms, plan(_times(plan.duration)), "") if plan.ok else (ms, None, str(plan.failure))


def _composite(cell: Cell, start: FloatArray, goal: FloatArray) -> Planned:
    request = ps.PlanRequest(start, goal, ps.RRTConnect())
    ms, plan = cpu_ms(partial(cell.service.plan, request))
    if plan.trajectory is None:
        return ms, None, str(plan.failure)
    return ms, plan.trajectory(_times(plan.trajectory.duration)), ""


class _Srmp:
    """SRMP in a process of its own, which is started again when it has not answered in time."""

    def __init__(self, python: Path, cell: Cell, place: Path) -> None:
        self._python, self._cell, self._description = python, cell, _described(cell, place)
        self._process: subprocess.Popen[str] | None = None
        self._lines: queue.Queue[str] = queue.Queue()

    def planned(self, start: FloatArray, goal: FloatArray) -> Planned:
        """What it answers to a query."""
        if self._process is None:
            self._begin()
        cell = self._cell
        query = {
            key: {name: cell.of_arm(name, q).tolist() for name in cell.arms}
            for key, q in (("start", start), ("goal", goal))
        }
        answer = self._asked(query, PATIENCE)
        if answer is None:
            self.close()
            return 1e3 * PATIENCE, None, f"no answer within {PATIENCE:g} s"
        if "motions" not in answer:
            return answer["ms"], None, answer["why"]
        duration = max(each["t"][-1] for each in answer["motions"].values())
        times, parts = _times(duration), {}
        for name, each in answer["motions"].items():
            t, q = np.array(each["t"]), np.array(each["q"])
            parts[name] = np.column_stack([np.interp(times, t, column) for column in q.T])
        Q = np.array([cell.joined({name: part[k] for name, part in parts.items()}) for k in range(len(times))])
        return answer["ms"], Q, ""

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._reader.join()
            with suppress(OSError):  # what it has not read is of no use any more
                assert self._process.stdin is not None
                self._process.stdin.close()
            self._process.wait()
            self._process = None

    def _begin(self) -> None:
        command = [str(self._python), str(CHILD)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        self._lines = queue.Queue()
        self._reader = threading.Thread(target=_read, args=(self._process, self._lines), daemon=True)
        self._reader.start()
        if self._asked(self._description, STARTING) is None:
            self.close()
            raise ps.InvalidRequest("against", str(self._python), "a Python with srmp 0.2.1, which loads the cell")

    def _asked(self, content: Mapping[str, Any], patience: float) -> dict[str, Any] | None:
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(content) + "\n")
            self._process.stdin.flush()
            found: dict[str, Any] | None = json.loads(self._lines.get(timeout=patience))
        except (queue.Empty, OSError):
            return None
        return found


def _read(process: subprocess.Popen[str], lines: queue.Queue[str]) -> None:
    assert process.stdout is not None
    with process.stdout:
        for line in process.stdout:
            if line.startswith(ANSWER):
                lines.put(line[len(ANSWER) :])
    lines.put("null")  # it has ended


def _described(cell: Cell, place: Path) -> dict[str, Any]:
    """The cell as SRMP is given it: URDF, the pairs that are not judged as an SRDF, and solids."""
    arms = {}
    for name, (robot, base) in PLACES.items():
        table, model = robot_table(data_folder("robots") / robot), ps.load_robot(robot)
        pairs = [contact["links"] for contact in table.get("allowed_contacts", ())]
        rows = "".join(f'<disable_collisions link1="{a}" link2="{b}" reason="Adjacent"/>\n' for a, b in pairs)
        srdf = place / f"{name}.srdf"
        srdf.write_text(f'<?xml version="1.0"?>\n<robot name="{name}">\n{rows}</robot>\n')
        pose = [*base.position, *base.quaternion]
        arms[name] = {"urdf": os.fspath(table["urdf"]), "srdf": str(srdf), "tool": model.tool_frame, "base": pose}
    solids = {}
    for each in cell.scene.obstacles:
        at = {"pose": [*each.pose.position, *each.pose.quaternion]}
        if isinstance(each.shape, ps.Box):
            solids[each.name] = at | {"size": list(each.shape.size)}
        elif isinstance(each.shape, ps.Cylinder):
            solids[each.name] = at | {"cylinder": [each.shape.radius, each.shape.length]}
        else:
            raise ps.InvalidRequest("scene", each.name, "boxes and cylinders alone")
    return {"arms": arms, "solids": solids, "planner": "xECBS"}


def _table(rows: Sequence[Row]) -> Table:
    lines = []
    for (scene, name), here in _by_planner(rows).items():
        done = [row for row in here if row["seconds"] is not None]
        lines.append(
            {
                "scene": scene,
                "planner": name,
                "queries": len(here),
                "planned": len(done),
                "touching": sum(row["audit"] != "free" for row in done),
                "CPU ms": spread([row["ms"] for row in here], 1),
                "s of motion": spread([row["seconds"] for row in done], 2) if done else "",
                "too fast": sum(row["speed"] > TOO_FAST for row in done),
                "ends off by rad": f"{max((row['off'] for row in done), default=0.0):.4f}",
            }
        )
    caption = "p50 / p95, failures included in CPU ms. SRMP's motions keep no limit of acceleration."
    return table_of("Peers", lines, caption=caption)


def _by_planner(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    return {
        (scene, name): each
        for scene, here in grouped(rows, "scene").items()
        for name, each in grouped(here, "planner").items()
    }


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    own = [row for row in rows if row["planner"] == OURS]
    touching = sum(row["audit"] not in ("free", "none") for row in own)
    yield Promise("no plan of this package touches, by Coal", f"{touching} of {len(own)}", not touching)
    missed = sum(
        row["seconds"] is None and any(o["seconds"] is not None and o["audit"] == "free" for o in rows if _same(row, o))
        for row in own
    )
    yield Promise("what another plans without a contact is planned", f"{missed} missed", not missed)


def _same(row: Row, other: Row) -> bool:
    return (row["scene"], row["query"]) == (other["scene"], other["query"])
