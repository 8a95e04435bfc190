"""What a driver commands by the rows of a gate keeps the limits of the robot, however late the targets come."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from planner_service import PlannerService, load_robot
from planner_service.gate import ActionGate, Kind, Tracking, Verdict
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from tests.unit.certify.test_certifier import PLANAR

ROUNDING = 1e-6
RUNS = 24


@dataclass(eq=False)
class Drivers:
    """Drivers that get the same targets at times of their own; the first gets them in time and began in place."""

    tracking: Tracking
    rate: float
    setpoint: FloatArray  # (runs, n)
    rng: np.random.Generator
    target: FloatArray = field(init=False)
    speed: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.target, self.speed = self.setpoint, np.zeros_like(self.setpoint)

    def copy(self) -> Drivers:
        other = Drivers(self.tracking, self.rate, self.setpoint, self.rng)
        other.target, other.speed = self.target, self.speed
        return other

    def wait(self, seconds: float) -> None:
        """Go on for so long, give or take the jitter: always early, always late, or drawn."""
        late = self.rng.uniform(-1.0, 1.0, (len(self.setpoint), 1))
        late[:3, 0] = 0.0, -1.0, 1.0
        share = np.clip((seconds + self.tracking.jitter * late) / self.tracking.goal_time, 0.0, 1.0)
        self.setpoint = self.setpoint + share * (self.target - self.setpoint)
        if seconds - self.tracking.jitter >= self.tracking.goal_time:
            self.speed = np.zeros_like(self.speed)

    def send(self, target: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The speeds of all, (runs, n), and by how much the first changes its own, (n,)."""
        before, self.target = self.speed[0], np.broadcast_to(target, self.setpoint.shape)
        self.speed = (self.target - self.setpoint) / self.tracking.goal_time
        return np.abs(self.speed), np.abs(self.speed[0] - before)

    def arm(self) -> FloatArray:
        """Where one of them has the arm, as far off as it may be."""
        error = self.tracking.of(self.setpoint.shape[1])
        one = self.setpoint[self.rng.integers(len(self.setpoint))]
        return np.asarray(one + error * self.rng.choice([-1.0, 1.0], one.shape))


def drawn_chunk(rng: np.random.Generator, robot: Robot, at: FloatArray, rate: float) -> FloatArray:
    """Targets towards somewhere, at up to a speed that is too much, reached at once or by and by."""
    count, goal = int(rng.integers(1, 30)), rng.uniform(*robot.bounds)
    way = goal - at
    fast = rng.uniform(0.2, 1.3) * float((robot.limits.velocity / np.maximum(np.abs(way), 1e-9)).min()) / rate
    ramp = np.minimum(np.arange(1, count + 1) / float(rng.choice([1.0, 5.0, 20.0])), 1.0)
    return np.asarray(np.clip(at + np.minimum(np.cumsum(ramp) * fast, 1.0)[:, None] * way, *robot.bounds))


def excess(gate: ActionGate, drivers: Drivers, verdict: Verdict, period: float) -> tuple[float, float]:
    """The largest shares of the limits of velocity and acceleration that are used on the way to rest."""
    others, fastest, hardest = drivers.copy(), 0.0, 0.0
    for k, row in enumerate(verdict.rows):
        if k:
            others.wait(period)
        speeds, change = others.send(row)
        fastest = max(fastest, float((speeds / gate.robot.limits.velocity).max()))
        hardest = max(hardest, float((change / period / gate.robot.limits.acceleration).max()))
    return fastest, hardest


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize("name", ["planar2", "wxai", "panda", "ur5"])
def test_targets_and_every_stop_keep_velocity_and_acceleration_with_jitters_of_up_to_five_periods(
    name: str, slow: bool
) -> None:
    robot = PLANAR if name == "planar2" else load_robot(name)
    service, rng = PlannerService(robot, Scene()), np.random.default_rng([7, slow])
    accepted, fastest = 0, 0.0
    for _ in range(25):
        rate = float(rng.choice([10.0, 30.0, 200.0]))
        period = 1.0 / rate
        jitter = period * float(rng.choice([0.0, 0.06, 0.5, rng.uniform(0.0, 5.0), 5.0]))
        tracking = Tracking(
            goal_time=float(rng.uniform(0.5 * min(period, 0.1), 0.2)),
            jitter=jitter,
            error=float(rng.choice([0.0, 2e-3])),
        )
        gate = ActionGate(service, rate=rate, tracking=tracking, slow=slow)
        home = np.asarray(np.clip(robot.home + rng.uniform(-0.3, 0.3, robot.n), *robot.bounds))
        off = tracking.of(robot.n) * rng.choice([-1.0, 1.0], (RUNS, robot.n))
        off[0] = 0.0
        drivers = Drivers(tracking, rate, home + off, rng)
        if not tracking.of(robot.n).any() or rng.uniform() < 0.5:
            gate.reset(home)
            drivers = Drivers(tracking, rate, np.tile(home, (RUNS, 1)), rng)
        measured, sent, waited = home, None, None
        at = home
        for _ in range(12):
            chunk = drawn_chunk(rng, robot, at, rate)
            verdict = gate.check(measured, chunk, sent=sent, elapsed=waited)
            assert verdict.refused is None or verdict.refused.kind is not Kind.TRACKING, str(verdict.refused)
            if not verdict.proven:  # the robot is in its own way, in a scene without anything
                break
            accepted += verdict.accepted
            used, changed = excess(gate, drivers, verdict, period)
            assert used <= 1.0 + ROUNDING, (rate, tracking, verdict.accepted)
            if waited is None or verdict.accepted:
                assert changed <= 1.0 + ROUNDING, (rate, tracking, verdict.accepted)
            fastest = max(fastest, used)
            sent = int(rng.integers(1, len(verdict.rows) + 1))
            for k, row in enumerate(verdict.rows[:sent]):
                drivers.wait(period) if k else None
                drivers.send(row)
            waited = None if rng.uniform() < 0.7 else float(rng.uniform(0.0, 3.0)) * period
            drivers.wait(period if waited is None else waited)
            measured, at = drivers.arm(), drivers.setpoint[0]
    assert accepted > 50
    assert fastest > 0.9
