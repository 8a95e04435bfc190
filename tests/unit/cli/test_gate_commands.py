"""``planner-service gate``: recordings are replayed, and drivers are measured."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from planner_service import PlannerService
from planner_service.cli.commands import app
from planner_service.datasets import EpisodeWork, episode_task, write_episodes
from planner_service.gate import ActionGate, Kind, Tracking
from planner_service.geometry.arrays import FloatArray
from planner_service.robot_setup.loading import load_robot


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A data set of one planned pick-and-place."""
    folder = tmp_path_factory.mktemp("recorded") / "set"
    write_episodes(str(folder), EpisodeWork(load_robot("wxai"), episode_task("pick-place")), 1)
    return str(folder)


def test_an_episode_passes_where_nothing_is_and_is_refused_where_a_table_is(episode: str, tmp_path: Path) -> None:
    free = CliRunner().invoke(app, ["gate", "replay", episode, "--scene", "empty", "--json"])
    assert (free.exit_code, json.loads(free.output)["refused"]) == (0, 0)
    picture = tmp_path / "refused.png"
    bin_ = CliRunner().invoke(
        app, ["gate", "replay", episode, "--scene", "bin", "--padding", "0.05", "--png", str(picture)]
    )
    assert bin_.exit_code == 1
    assert picture.read_bytes()[1:4] == b"PNG"
    assert "1 of 1 episodes would have been refused" in bin_.output


def test_a_recording_of_the_plan_itself_is_measured_as_an_exact_driver(episode: str) -> None:
    done = CliRunner().invoke(app, ["gate", "measure", episode, "--json"])
    found = json.loads(done.output)
    assert done.exit_code == 0
    assert found["goal_time"] == pytest.approx(1.0 / 30.0)
    assert max(found["errors"].values()) < 1e-6


def test_a_log_of_lines_is_measured_and_a_wrong_line_is_named(tmp_path: Path) -> None:
    lines = []
    for k in range(60):
        q = [0.1 * float(np.sin(0.1 * k))] * 6
        lines += [{"t": k / 30, "target": q, "q": [0.0] * 6}]
    log = tmp_path / "log.jsonl"
    log.write_text("\n".join(map(json.dumps, lines)))
    done = CliRunner().invoke(app, ["gate", "measure", str(log)])
    assert (done.exit_code, "error" in done.output) == (0, True)
    log.write_text('{"t": 0.0, "target": [1.0]}\n')
    wrong = CliRunner().invoke(app, ["gate", "measure", str(log)])
    assert (wrong.exit_code, "line 1: target is no list of 6 numbers" in wrong.output) == (2, True)


def recorded_log(folder: Path) -> Path:
    """The log of a gate before whose arm a post stands."""
    log = folder / "gate.jsonl"
    service = PlannerService("wxai", "post")
    gate = ActionGate(service, rate=30, tracking=Tracking(goal_time=0.1, error=0.005), log=log)
    q = np.array([1.02, 1.51, 1.35, -0.65, 0.06, -0.31])
    ease = np.linspace(0.0, 1.0, 121)[1:, None]
    gate.check(q, q + (3 * ease**2 - 2 * ease**3) * np.array([-1.9, 0, 0, 0, 0, 0]))
    return log


def test_the_log_of_a_gate_is_replayed_with_pictures_of_its_last_refusal(tmp_path: Path) -> None:
    log, still, moves = recorded_log(tmp_path), tmp_path / "last.png", tmp_path / "log.webp"
    command = ["gate", "replay", str(log), "--scene", "post", "--png", str(still), "--webp", str(moves)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 1
    assert "1 refusals in 1 lines" in done.output
    assert "stop: after it the arm could not stop: link_4 x post_ahead could touch" in done.output
    assert (still.read_bytes()[1:4], moves.read_bytes()[8:12]) == (b"PNG", b"WEBP")
    found = json.loads(CliRunner().invoke(app, [*command[:5], "--json"]).output)
    assert (found["kinds"], found["places"][0]["pair"]) == ({"stop": 1}, ["link_4", "post_ahead"])


def test_options_about_data_sets_are_refused_with_a_log_and_so_is_a_log_of_another_robot(tmp_path: Path) -> None:
    log = recorded_log(tmp_path)
    wrong = CliRunner().invoke(app, ["gate", "replay", str(log), "--scene", "post", "--padding", "0.01"])
    assert (wrong.exit_code, "--padding" in wrong.output) == (2, True)
    other = CliRunner().invoke(app, ["gate", "replay", str(log), "--scene", "post", "--robot", "panda"])
    assert (other.exit_code, "the robot has 7 joints" in other.output) == (2, True)


class SteppedDriver:
    """A driver that goes straight to each target, stepped every millisecond, whose arm is late and shakes."""

    GOAL_TIME, LAG, SHAKE, JITTER = 0.1, 0.04, 0.003, 0.002

    def __init__(self, q: FloatArray, seed: int) -> None:
        self.rng, self.now = np.random.default_rng(seed), 0
        self.setpoint, self.start, self.target, self.came = q, q, q, 0
        self.trail = [q] * (1 + round(1000 * self.LAG))

    def go(self, target: FloatArray) -> None:
        """Send it to a target now."""
        self.start, self.target, self.came = self.setpoint, np.array(target), self.now

    def wait(self, periods: float) -> None:
        """Until the next target, give or take the jitter."""
        off = self.rng.uniform(-self.JITTER, self.JITTER)
        for _ in range(round(1000 * (periods / 30.0 + off))):
            self.now += 1
            share = min(1.0, (self.now - self.came) / 1000 / self.GOAL_TIME)
            self.setpoint = self.start + share * (self.target - self.start)
            self.trail.append(self.setpoint)

    def positions(self) -> FloatArray:
        """Where the arm is, (n,)."""
        late = self.trail[-1 - round(1000 * self.LAG)]
        return np.asarray(late + self.rng.uniform(-self.SHAKE, self.SHAKE, len(late)))


def swings(q: FloatArray, amplitude: float, count: int) -> FloatArray:
    """Targets that leave q slowly, swing, and are back there at the end, (count, n)."""
    times = np.arange(1, count + 1) / 30.0
    ease = np.minimum(1.0, 0.5 * np.minimum(times, times[-1] - times))
    return np.asarray(q + amplitude * (ease * np.sin(1.7 * times))[:, None] * np.array([1.0, 0.5, -0.5, 0.6, 0.7, 0.8]))


def strays(tracking: Tracking, q: FloatArray) -> bool:
    """Whether a gate that assumes so much says of another motion of the same driver that it does not follow."""
    gate = ActionGate(PlannerService("wxai", "empty"), rate=30, tracking=tracking, acceleration_scale=3.0)
    driver = SteppedDriver(q, 2)
    gate.reset(q)
    for target in swings(q, 0.25, 240):
        verdict = gate.check(driver.positions(), target)
        if verdict.refused is not None and verdict.refused.kind is Kind.TRACKING:
            return True
        assert verdict.ok
        driver.go(verdict.rows[0])
        driver.wait(1.0)
    return False


def test_a_gate_believes_the_driver_whose_log_was_measured_and_no_worse_one(tmp_path: Path) -> None:
    q = np.array([0.0, 1.3, 1.2, -0.4, 0.0, 0.0])
    driver, lines = SteppedDriver(q, 1), list[str]()
    for target in swings(q, 0.3, 600):
        driver.go(target)
        lines.append(json.dumps({"t": driver.now / 1000, "target": target.tolist()}))
        for _ in range(4):
            lines.append(json.dumps({"t": driver.now / 1000, "q": driver.positions().tolist()}))
            driver.wait(0.25)
    log = tmp_path / "log.jsonl"
    log.write_text("\n".join(lines))
    done = CliRunner().invoke(app, ["gate", "measure", str(log), "--json"])
    assert done.exit_code == 0
    found = json.loads(done.output)
    assert found["goal_time"] + found["lag"] == pytest.approx(driver.GOAL_TIME + driver.LAG, abs=0.02)
    assert driver.SHAKE <= max(found["errors"].values()) <= 3.0 * driver.SHAKE
    assert found["jitter"] <= 5.0 * driver.JITTER
    assumed = found["tracking"]
    tracking = Tracking(**(assumed | {"error": list(assumed["error"].values())}))
    assert not strays(tracking, q)
    assert strays(replace(tracking, lag=0.0), q)
    assert strays(replace(tracking, error=0.3 * driver.SHAKE), q)
