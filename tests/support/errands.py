"""Pick-and-place on the simulated arm, a motion through an obstacle, and a driver that fails on the way."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

import planner_service as ps
from planner_service import execute as streaming
from planner_service.geometry.arrays import FloatArray
from planner_service.records.plan_file import SavedTask
from planner_service.tasks import Segment
from planner_service.tasks.pick_place import places_on

__all__ = ["Cut", "Errand", "control", "errand"]

STREAMING = streaming.Streaming(latest=0.5)
"""A stream that is half a second late shows nothing; less happens on a machine that does other things."""

PADDING = 0.005
"""Metres that plans keep: the arm leaves its path by 1 to 3 mm."""


@dataclass(frozen=True, eq=False)
class Errand:
    """A pick-and-place with the world as it is during each of its motions, and the object's place in the end."""

    task: SavedTask
    scenes: tuple[ps.Scene, ...]
    end: ps.Pose


def errand(arm: streaming.SimulatedArm) -> Errand:
    """Out of the bin round the post onto the tray."""
    service = ps.PlannerService("wxai", arm.seen())
    home = service.robot.home
    request = ps.PlanRequest(home, home, padding=PADDING, time_limit=None)
    block, onto = service.scene.obstacle("blue_block"), "tray"
    grasps, places = ps.top_grasps(service.robot, block), places_on(block, service.scene.obstacle(onto))
    taking = ps.Handling(support="bin_floor", request=request)
    picked = _done(ps.pick(service, home, block.name, grasps, taking))
    putting = ps.Handling(support=onto, request=request)
    placed = _done(ps.place(ps.PlannerService.of(picked.world), picked.q, block.name, places, putting))
    back = ps.PlannerService.of(placed.world).plan(ps.PlanRequest(placed.q, home, padding=PADDING, time_limit=None))
    back.unwrap()
    home_again = Segment("home", back, placed.world.robot.gripper_width)
    to, into, lift, transfer, lower, away = (*picked.segments, *placed.segments)
    worlds = (service.scene, service.scene, *3 * (picked.world.scene,), *2 * (placed.world.scene,))
    segments = (to, into, lift, transfer, lower, away, home_again)
    task = SavedTask(service.world, "bin", segments, picked.choosing + placed.choosing, 0.0)
    return Errand(task, worlds, placed.world.scene.obstacle(block.name).pose)


def _done(result: ps.TaskResult) -> ps.TaskResult:
    if result.failure is not None:
        raise RuntimeError(str(result.failure))
    return result


def control() -> tuple[ps.Trajectory, streaming.Rehearsal]:
    """The straight joint motion from above the bin to above the tray, through the post, which nobody planned."""
    scene = ps.load_scene("bin").without("blue_block")
    robot = ps.load_robot("wxai")
    service = ps.PlannerService(robot, scene)
    over_bin, over_tray = (
        service.plan(ps.PlanRequest(robot.home, ps.Pose(at, (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)))).unwrap()[0]
        for at in ((0.33, 0.0, 0.13), (0.2, 0.28, 0.13))
    )
    path = ps.JointPath(np.array([over_bin.waypoints[-1], over_tray.waypoints[-1]]))
    if service.checker.edge_is_free(*path.waypoints):
        raise RuntimeError("the control is free: it shows nothing")
    motion = ps.Trapezoidal().time_path(path, robot.limits)
    with streaming.SimulatedArm(robot, scene, path.waypoints[0]) as arm:
        return motion, streaming.rehearse(arm, motion, robot, STREAMING, allow_unproven=True)


class Cut:
    """A driver that fails at some moment, and then holds where the arm is."""

    def __init__(self, driver: streaming.Driver, moment: float) -> None:
        self.driver, self.moment = driver, moment
        self.simulated, self.lag = driver.simulated, driver.lag
        self.began = math.inf
        self.stood = driver.positions()

    def limits(self) -> streaming.ArmLimits:
        return self.driver.limits()

    def positions(self) -> FloatArray:
        return self.driver.positions()

    def command(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> None:
        self.began = min(self.began, time.perf_counter())
        if time.perf_counter() - self.began >= self.moment:
            raise OSError("cut")
        self.driver.command(q, qd, qdd)

    def hold(self, q: ArrayLike) -> None:
        self.stood = np.array(q)
        self.driver.hold(q)

    def gripper_width(self) -> float:
        return self.driver.gripper_width()

    def move_gripper(self, width: float, seconds: float) -> None:
        self.driver.move_gripper(width, seconds)

    def close(self) -> None:
        self.driver.close()
