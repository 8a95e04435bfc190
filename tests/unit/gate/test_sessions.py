"""Whole sessions with a simulated driver: whatever is wanted, and however late it comes, the arm touches nothing."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import PlannerService, load_robot
from planner_service.collision import CollisionChecker
from planner_service.gate import ActionGate, Kind, Tracking
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Scene
from tests.unit.certify.test_certifier import PLANAR, ball_beyond

RATE = 30.0
PERIOD = 1.0 / RATE


class Driver:
    """Goes straight to each target, to be there when it is due; its arm is late and off by as much as is assumed."""

    def __init__(self, tracking: Tracking, q: FloatArray, rng: np.random.Generator) -> None:
        self.tracking, self.rng = tracking, rng
        self.now = 0.0
        self.ways = [(-10.0, q, q)]  # when each target came, where the setpoint was, and that target

    def setpoint(self, time: float) -> FloatArray:
        came, start, target = next(way for way in reversed(self.ways) if way[0] <= time)
        return np.asarray(start + min((time - came) / self.tracking.goal_time, 1.0) * (target - start))

    def arm(self, time: float) -> FloatArray:
        late = self.rng.uniform(0.0, self.tracking.lag)
        off = self.tracking.of(len(self.ways[0][1])) * self.rng.uniform(-1.0, 1.0, len(self.ways[0][1]))
        return self.setpoint(time - late) + off

    def send(self, time: float, target: FloatArray) -> None:
        self.ways.append((time, self.setpoint(time), target))
        self.now = time


def wanted(rng: np.random.Generator, robot: Robot, at: FloatArray, step: int, goal: FloatArray) -> FloatArray:
    """What a policy asks for: mostly a bit nearer to where it wants to go, at times anything."""
    chunk = at + np.linspace(0.0, 1.0, 9)[1:, None] * np.clip(goal - at, -0.3, 0.3)
    return np.asarray(rng.uniform(*robot.bounds, (3, robot.n)) if step % 23 == 0 else np.clip(chunk, *robot.bounds))


@pytest.mark.parametrize("lag", [0.0, 0.06])
@pytest.mark.parametrize("name", ["planar2", "wxai"])
def test_an_arm_whose_targets_come_early_late_or_not_at_all_touches_nothing_and_has_a_proven_stop(
    name: str, lag: float
) -> None:
    robot: Robot = PLANAR if name == "planar2" else load_robot(name)
    scene: Scene = ball_beyond(-0.3, angle=0.4) if name == "planar2" else load_scene("table")
    tracking, rng = Tracking(goal_time=0.1, error=0.004, jitter=0.004, lag=lag), np.random.default_rng(1)
    service, checker = PlannerService(robot, scene), CollisionChecker(robot, scene)
    refused, passed, moved = dict[str, int](), 0, 0.0
    for _ in range(6):
        start = robot.home if name != "planar2" else np.array([-0.5, 0.0])
        gate, driver = ActionGate(service, rate=RATE, tracking=tracking, slow=True), Driver(tracking, start, rng)
        gate.reset(start)
        sent, goal = 0, start
        for step in range(120):
            if step % 15 == 0:
                goal = rng.uniform(*robot.bounds)
            wait = PERIOD * (rng.choice([0.4, 1.0, 1.0, 1.0, 1.0, 2.5]) if rng.uniform() < 0.3 else 1.0)
            now = max(driver.now + wait + tracking.jitter * rng.uniform(-1.0, 1.0), driver.now)
            measured = driver.arm(now)
            chunk = wanted(rng, robot, driver.setpoint(driver.now), step, goal)
            verdict = gate.check(measured, chunk, sent=sent, elapsed=wait)
            assert verdict.proven, str(verdict.refused)
            if verdict.refused is not None:
                assert verdict.refused.kind is not Kind.TRACKING, str(verdict.refused)
                refused[verdict.refused.kind.value] = refused.get(verdict.refused.kind.value, 0) + 1
            passed += verdict.accepted
            sent = min(int(rng.choice([1, 1, 1, 3])), len(verdict.rows))
            for k, row in enumerate(verdict.rows[:sent]):
                now += (PERIOD + tracking.jitter * rng.uniform(-1.0, 1.0)) if k else 0.0
                driver.send(now, row)
            for instant in np.linspace(driver.now - 2.0 * PERIOD, driver.now + 0.2, 8):
                q = driver.arm(float(instant))
                assert checker.state_is_free(np.clip(q, *robot.bounds))
            moved += float(np.abs(driver.setpoint(driver.now) - start).max())
    assert sum(refused.values()) > 50
    assert passed > 500
    assert moved > 30.0


class Extreme(Driver):
    """As late and as far off as it may be, or not at all."""

    def arm(self, time: float) -> FloatArray:
        off = self.tracking.of(len(self.ways[0][1])) * self.rng.choice([-1.0, 0.0, 1.0], len(self.ways[0][1]))
        return np.asarray(self.setpoint(time - self.rng.choice([0.0, self.tracking.lag])) + off)


def drawn_tracking(rng: np.random.Generator, robot: Robot) -> Tracking:
    error = rng.choice([0.0, 0.0005, 0.003], robot.n)
    jitter, lag = PERIOD * rng.choice([0.0, 0.1, 0.9, 1.0, 2.5]), rng.choice([0.0, PERIOD, 0.07, 0.2])
    return Tracking(float(rng.uniform(0.01, 0.2)), error=error, jitter=float(jitter), lag=float(lag))


@pytest.mark.parametrize("name", ["planar2", "wxai"])
def test_an_arm_that_is_exactly_as_late_and_as_far_off_as_it_may_be_is_never_called_astray(name: str) -> None:
    robot: Robot = PLANAR if name == "planar2" else load_robot(name)
    service, rng, moved = PlannerService(robot, Scene()), np.random.default_rng(9), 0.0
    for _ in range(12):
        tracking, start = drawn_tracking(rng, robot), np.clip(robot.home + 0.1, *robot.bounds)
        gate, driver = ActionGate(service, rate=RATE, tracking=tracking, slow=True), Extreme(tracking, start, rng)
        gate.reset(start)
        sent, goal = 0, start
        for step in range(30):
            wait = PERIOD * float(rng.choice([0.0, 0.4, 1.0, 1.0, 1.0, 2.5, 7.0]))
            now = max(driver.now + wait + tracking.jitter * rng.choice([-1.0, 0.0, 1.0]), driver.now)
            if step % 8 == 0:
                goal = rng.uniform(*robot.bounds)
            chunk = wanted(rng, robot, driver.setpoint(now), 1, goal)
            verdict = gate.check(driver.arm(now), chunk, sent=sent, elapsed=wait)
            refused = verdict.refused
            assert refused is None or refused.kind is not Kind.TRACKING, (tracking, str(refused))
            if not verdict.proven:  # the robot is in its own way
                break
            sent = int(rng.integers(1, len(verdict.rows) + 1))
            for k, row in enumerate(verdict.rows[:sent]):
                now = max(now + PERIOD + tracking.jitter * rng.choice([-1.0, 0.0, 1.0]), now) if k else now
                driver.send(now, row)
            moved += float(np.abs(driver.setpoint(now) - start).max())
    assert moved > 10.0


@pytest.mark.parametrize("beyond", [-1e-6, 1e-6])
def test_an_arm_that_is_farther_off_than_it_may_be_is_noticed_at_once(beyond: float) -> None:
    """Where nothing is late or drawn, so that it is known where the arm can be: to less than what a sensor sees."""
    rng, robot = np.random.default_rng(4), load_robot("panda")
    service = PlannerService(robot, Scene())
    for _ in range(20):
        tracking = Tracking(float(rng.uniform(0.04, 0.2)), error=rng.uniform(0.0, 0.01, robot.n), jitter=0.0)
        gate, driver = ActionGate(service, rate=RATE, tracking=tracking, slow=True), Driver(tracking, robot.home, rng)
        gate.reset(robot.home)
        goal = np.clip(robot.home + rng.uniform(-0.5, 0.5, robot.n), *robot.bounds)
        for step in range(int(rng.integers(1, 30))):
            chunk = wanted(rng, robot, driver.setpoint(driver.now + PERIOD), 1, goal)
            verdict = gate.check(driver.setpoint(driver.now + PERIOD), chunk, sent=1 if step else 0)
            assert verdict.proven
            driver.send(driver.now + PERIOD, verdict.rows[0])
        setpoint, joint = driver.setpoint(driver.now + PERIOD), int(rng.integers(robot.n))
        off = np.zeros(robot.n)
        off[joint] = rng.choice([-1.0, 1.0]) * (tracking.of(robot.n)[joint] + beyond)
        verdict = gate.check(setpoint + off, setpoint, sent=1)
        lost = verdict.refused is not None and verdict.refused.kind is Kind.TRACKING
        assert lost == (beyond > 0.0)
