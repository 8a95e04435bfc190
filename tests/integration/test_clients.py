"""Programs in TypeScript and C++ plan a pick-and-place over HTTP, and the simulated arm executes what they print.

``make clients`` runs this. It needs node with npm and its registry, cmake and a C++ compiler, the headers of libcurl
and nlohmann-json, and the extra ``sim``; it fails where one is missing. The simulation runs in real time.
"""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planner_service as ps
from planner_service.execute import SimulatedArm
from planner_service.execute.simulate import meant_contacts
from planner_service.geometry.arrays import FloatArray
from planner_service.records import SavedTask, load_task
from planner_service.records.scene import SceneRecord
from tests.support.served import asked, served

pytestmark = pytest.mark.clients

CLIENTS = Path(__file__).parents[2] / "examples" / "clients"
DOCS = Path(__file__).parents[2] / "docs"
TOKEN = "f" * 32

MAX_DEVIATION = 1e-4
"""Radians between what a client commands and the proven curve."""

GRIPPER_TIME, REST = 0.6, 0.7
"""Seconds for a motion of the gripper, and until the arm rests at the end of a motion."""

SQUEEZE = 0.004
"""Metres beyond contact that a gripper is commanded to close on an object."""


@dataclass
class Commanded:
    """A motion as a client prints it: the width of the gripper before it, if that changes, and rows of t, q and qd."""

    name: str
    width: float | None = None
    rows: list[tuple[float, list[float], list[float]]] = field(default_factory=list)

    def at(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Position and velocity of the last command that is due."""
        due = int(np.searchsorted([row[0] for row in self.rows], t, "right")) - 1
        _, q, qd = self.rows[due]
        return np.array(q, dtype=np.float64), np.array(qd, dtype=np.float64)


def run(*command: str, folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def typescript(folder: Path) -> list[str]:
    """The compiled program: schema generated, strictly compiled, from what the lock file says."""
    here = folder / "examples" / "clients" / "typescript"
    shutil.copytree(CLIENTS / "typescript", here, ignore=shutil.ignore_patterns("node_modules", "build", "schema.d.ts"))
    (folder / "docs" / "reference").mkdir(parents=True)
    shutil.copy(DOCS / "reference" / "openapi.json", folder / "docs" / "reference")
    run("npm", "ci", folder=here)
    run("npm", "run", "build", folder=here)
    return ["node", str(here / "build" / "pick_place.js")]


def cpp(folder: Path) -> list[str]:
    """The compiled program; warnings are errors."""
    run("cmake", "-S", str(CLIENTS / "cpp"), "-B", str(folder), folder=folder)
    run("cmake", "--build", str(folder), folder=folder)
    return [str(folder / "pick_place")]


def motions(lines: list[dict[str, Any]]) -> list[Commanded]:
    found: list[Commanded] = []
    for line in lines:
        if "motion" in line:
            found.append(Commanded(line["motion"]))
        elif "gripper" in line:
            found[-1].width = line["gripper"]
        else:
            found[-1].rows.append((line["t"], line["q"], line["qd"]))
    return found


def deviation(commanded: list[Commanded], task: SavedTask) -> float:
    """The largest distance of a commanded joint from the proven curve, in radians."""
    worst = 0.0
    for motion, segment in zip(commanded, task.segments, strict=True):
        trajectory = segment.result.unwrap()[1]
        assert motion.name == segment.name
        assert motion.rows[0][0] == 0.0
        assert motion.rows[-1][0] == trajectory.duration
        t = np.array([row[0] for row in motion.rows])
        assert np.diff(t).max() <= 0.0021
        q = np.array([row[1] for row in motion.rows])
        worst = max(worst, float(np.abs(q - trajectory(t)).max()))
    return worst


def drive(arm: SimulatedArm, commanded: list[Commanded], robot: ps.Robot) -> float:
    """Execute commands in real time; the most radians by which the arm was off all that was to be reached lately."""
    off = 0.0
    with closing(arm.connect()) as driver:
        width = robot.gripper_width
        for motion in commanded:
            if motion.width is not None:
                closing_on = motion.width < width - 1e-4
                driver.move_gripper(motion.width - SQUEEZE if closing_on else motion.width, GRIPPER_TIME)
                width = motion.width
                time.sleep(2.0 * GRIPPER_TIME)
            begin, duration = time.perf_counter(), motion.rows[-1][0]
            lately: list[FloatArray] = []
            while (t := time.perf_counter() - begin) < duration + REST:
                q, qd = motion.at(min(t, duration))
                qd = qd if t < duration else np.zeros(robot.n)
                ahead = np.clip(q + driver.lag * qd, robot.limits.lower, robot.limits.upper)
                driver.command(ahead, qd, np.zeros(robot.n))
                lately = [*lately[-60:], q]
                measured = driver.positions()
                off = max(off, float(np.abs(measured - np.array(lately)).max(axis=1).min()))
                time.sleep(0.005)
    return off


def put_scene(url: str, scene: ps.Scene) -> None:
    document = SceneRecord.of(scene).document()
    body = {name: document[name] for name in ("description", "obstacles", "attached")}
    status, _, answer = asked(url, "PUT", f"/scenes/{scene.name}", body, TOKEN)
    assert status == 200, answer


def saved_task(url: str, plan: str, file: Path) -> SavedTask:
    """The task file of the server, read strictly."""
    file.write_text(json.dumps(asked(url, "GET", f"/plans/{plan}", token=TOKEN)[2]))
    return load_task(file)


def test_the_lock_file_names_no_registry() -> None:
    lock = json.loads((CLIENTS / "typescript" / "package-lock.json").read_text("utf-8"))
    packages = {name: package for name, package in lock["packages"].items() if name}
    assert len(packages) > 10
    assert all(package["integrity"] and "resolved" not in package for package in packages.values())


@pytest.mark.parametrize("client", [typescript, cpp])
def test_a_pick_and_place_that_a_client_plans_is_executed_as_proven(
    client: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = client(tmp_path)
    token = tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    robot = ps.load_robot("wxai")
    with SimulatedArm(robot, ps.load_scene("bin"), loose=("blue_block",)) as arm:
        with served(tmp_path, "--scene", "bin", "--workers", "1", "--token-file", str(token)) as url:
            refused = subprocess.run([*command, url], capture_output=True, text=True, timeout=60)
            assert refused.returncode != 0
            assert "Authorization: expected Bearer and the token" in refused.stderr
            put_scene(url, arm.seen())
            first, *lines = map(json.loads, run(*command, url, TOKEN, folder=tmp_path).splitlines())
            task = saved_task(url, first["plan"], tmp_path / "task.json")
        commanded = motions(lines)
        far = deviation(commanded, task)
        off = drive(arm, commanded, robot)
        contacts = [contact for contact in arm.contacts() if contact.pair not in meant_contacts(task)]
        block, tray = arm.poses()["blue_block"].position, task.scene.obstacle("tray").pose.position
    with capsys.disabled():
        print(
            f"\n{client.__name__}: {len(commanded)} motions, within {far * 1e3:.5f} mrad of the proven curve, "
            f"followed within {off * 1e3:.1f} mrad by the simulated arm; unexpected contacts: {len(contacts)}"
        )
    assert 0.0 < far <= MAX_DEVIATION
    assert contacts == []
    assert math.hypot(block[0] - tray[0], block[1] - tray[1]) < 0.02
    assert block[2] > tray[2]
