"""Recordings for Rerun, read back by Rerun itself."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import PlannerService, PlanRequest, PlanResult
from planner_service.records.evidence import save_plan
from planner_service.view.playback import Playback
from planner_service.view.recordings.rerun_recording import write_rerun
from tests.support.command import run
from tests.support.optional import present

rerun: Any = pytest.importorskip("rerun", reason="Rerun needs Python 3.11")

SERVICE = PlannerService("planar2", "discs")
ROBOT = SERVICE.robot


@pytest.fixture(scope="module")
def planned() -> PlanResult:
    return SERVICE.plan(PlanRequest(ROBOT.pose("lesson_start"), ROBOT.pose("lesson_goal"), time_limit=None))


def column(path: Path, entity: str, component: str) -> tuple[Any, Any]:
    """The seconds and values of one component, as Rerun reads them."""
    times, values = list[float](), list[Any]()
    for chunk in rerun.chunk.RrdReader(path).stream().to_chunks():
        if str(chunk.entity_path) == entity:
            rows = chunk.to_record_batch().to_pydict()
            if component in rows:
                times += [1e-9 * t.value if hasattr(t, "value") else t.total_seconds() for t in rows["time"]]
                values += [value[0] for value in rows[component]]
    return np.array(times), np.array(values)


def entities(path: Path) -> set[str]:
    return {str(chunk.entity_path) for chunk in rerun.chunk.RrdReader(path).stream().to_chunks()}


def test_a_recording_has_robot_curve_clearance_and_speed_over_time(planned: PlanResult, tmp_path: Path) -> None:
    path, trajectory = tmp_path / "plan.rrd", planned.unwrap()[1]
    write_rerun(SERVICE, planned, path, dt=0.02)
    obstacles = {f"/scene/{obstacle.name}" for obstacle in SERVICE.scene.obstacles}
    assert {"/robot/forearm", "/tool", "/curve/0\\ plan", "/clearance", "/speed/tool", *obstacles} <= entities(path)
    t, q, qd, _ = trajectory.sample(0.02)
    times, values = column(path, "/joint/position/shoulder", "Scalars:scalars")
    assert values.tolist() == q[:, 0].tolist()
    assert times == pytest.approx(t, abs=1e-9)
    _, speed = column(path, "/speed/tool", "Scalars:scalars")
    first, both, bend = qd[:, 0], qd.sum(axis=1), np.cos(q[:, 1])  # links of 1 and 0.5 m
    assert speed == pytest.approx(np.sqrt(first**2 + 0.25 * both**2 + first * both * bend), abs=1e-7)
    times, clearance = column(path, "/clearance", "Scalars:scalars")
    assert times == pytest.approx(t, abs=1e-9)
    (clip,) = present(Playback.of_result(SERVICE, planned)).clips
    assert clearance.tolist() == clip.clearances(t).tolist()


def test_export_writes_a_recording_and_talks_to_nobody(
    planned: PlanResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket.socket, "connect", None)
    save_plan(planned, tmp_path / "plan.json")
    for _ in range(2):  # the second time over the first
        done = run("export", tmp_path / "plan.json", "--format", "rrd", "--out", tmp_path / "plan.rrd")
        assert (done.exit_code, done.stdout) == (0, "")
    assert "/clearance" in entities(tmp_path / "plan.rrd")
