"""Robots among drawn obstacles, with a driver each, and what a policy may want of them: the cases of the chunks."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

import planner_service as ps
from auditor.checker import IndependentChecker, tables_of
from benchmarks.studies.gate.driver import Driver
from benchmarks.studies.gate.judge import Judge
from benchmarks.worlds.drawn import blocked_ends, draw_objects
from planner_service.files.package_data import data_folder
from planner_service.gate import ActionGate, Tracking
from planner_service.geometry.arrays import FloatArray

__all__ = ["ROBOTS", "World", "recorded", "world"]

ROBOTS = ("wxai", "wxai_dual", "panda", "ur5")

OBJECTS = (3, 9)

RATES = (30.0, 200.0)

GOAL_PERIODS = (1.0, 5.0)
"""Periods after which a target is due."""

ERRORS = (0.001, 0.03)
"""Radians between arm and setpoint."""

JITTERS = (0.0, 0.4)
"""Share of a period."""

LAGS = (0.0, 0.1)
"""Seconds; every other driver has none."""

MAX_CHECKS = 20_000
"""Of a plan to be followed; where that is not enough, an attack takes its place."""

NEARNESS, BESIDE, STRIDE = (0.8, 2.0), 0.01, 1 / 256
"""How far from contact an attack begins: times what the error moves any point, and metres beside; and its search."""

SHIFT = 0.03
"""Metres by which obstacles move along each axis where a scene changes, at most."""


@dataclass(frozen=True, eq=False)
class World:
    """One robot in one scene.

    Attributes:
        name: Of the robot.
        start, goal: Free configurations with something in between, (n,).
        tracking: What is assumed of its driver.
    """

    name: str
    service: ps.PlannerService
    start: FloatArray
    goal: FloatArray
    rate: float
    tracking: Tracking

    @property
    def n(self) -> int:
        """Joints."""
        return self.service.robot.n

    @cached_property
    def judge(self) -> Judge:
        """Coal's view of it."""
        return Judge(IndependentChecker(data_folder("robots") / self.name, tables_of(self.service.scene)))

    @property
    def error(self) -> FloatArray:
        """Between arm and setpoint at most, (n,)."""
        return np.broadcast_to(np.asarray(self.tracking.error, dtype=np.float64), (self.n,)).copy()

    def gate(self) -> ActionGate:
        """Before anything was sent."""
        return ActionGate(self.service, rate=self.rate, tracking=self.tracking, slow=True)

    def driver(self, q: FloatArray) -> Driver:
        """One that holds q (n,)."""
        return Driver(self.rate, self.tracking.goal_time, self.tracking.jitter, self.error, q, q, 1e3)

    def near_contact(self, rng: np.random.Generator) -> World:
        """The same, the arm on its straight way to the goal about as near to contact as it may be."""
        wanted = float(rng.uniform(*NEARNESS)) * float(self.judge.reach @ self.error) + float(rng.uniform(0.0, BESIDE))
        rate = float(self.judge.reach @ np.abs(self.goal - self.start))
        near = at = 0.0
        while at < 1.0 and (gap := self.judge.gap(self._between(at))) > wanted:
            near, at = at, at + max((gap - wanted) / rate, STRIDE)
        there = replace(self, start=self._between(near))
        vars(there)["judge"] = self.judge  # of the same scene
        return there

    def _between(self, share: float) -> FloatArray:
        return np.asarray(self.start + share * (self.goal - self.start))

    def changed(self, rng: np.random.Generator) -> World:
        """The same with one of the obstacles somewhat elsewhere."""
        scene = self.service.scene
        moved = scene.obstacles[int(rng.integers(len(scene.obstacles)))]
        x, y, z = np.asarray(moved.pose.position) + rng.uniform(-SHIFT, SHIFT, 3)
        pose = ps.Pose((x, y, z), moved.pose.quaternion)
        there = replace(self, service=self.service.with_scene(scene.moved(moved.name, pose)))
        vars(there)["judge"] = self.judge.moved(moved.name, pose.position, pose.quaternion)
        return there

    @cached_property
    def plan(self) -> ps.Trajectory | None:
        """A motion from start to goal."""
        result = self.service.plan(ps.PlanRequest(self.start, self.goal, time_limit=None, max_checks=MAX_CHECKS))
        return result.trajectory


AT_REST = 0.45
"""Of the slowest joint's speed: as fast as an arm may be from where it is held to where it is measured, which is as far
again beyond a joint limit."""


def world(name: str, seed: int, number: int) -> World:
    """The world of a number: the first of its kind that leaves room for two free configurations."""
    chance, robot = random.Random(f"gate {name} {seed} {number}"), _robot(name)
    while True:
        scene = ps.Scene(tuple(draw_objects(chance, chance.randint(*OBJECTS))))
        service = ps.PlannerService(robot, scene)
        try:
            start, goal = next(blocked_ends(service.checker, chance))
        except ps.BrokenInvariant:
            continue
        break
    rate = chance.choice(RATES)
    goal_time, slowest = chance.uniform(*GOAL_PERIODS) / rate, float(robot.limits.velocity.min())
    tracking = Tracking(
        goal_time=goal_time,
        error=min(chance.uniform(*ERRORS), AT_REST * goal_time * slowest),
        jitter=chance.uniform(*JITTERS) / rate,
        lag=chance.choice((0.0, chance.uniform(*LAGS))),
    )
    return World(name, service, start, goal, rate, tracking)


@cache
def _robot(name: str) -> ps.Robot:
    return ps.load_robot(name)


def recorded(name: str, scene: ps.Scene, start: FloatArray, goal: FloatArray, rng: np.random.Generator) -> World:
    """The world of a recording, with a driver that is drawn."""
    rate = float(rng.choice(RATES))
    tracking = Tracking(
        goal_time=float(rng.uniform(*GOAL_PERIODS)) / rate,
        error=float(rng.uniform(ERRORS[0], 0.3 * ERRORS[1])),
        jitter=float(rng.uniform(*JITTERS)) / rate,
    )
    return World(name, ps.PlannerService(_robot(name), scene), start, goal, rate, tracking)
