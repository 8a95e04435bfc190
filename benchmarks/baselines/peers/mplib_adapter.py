"""mplib: its only planner, OMPL's RRTConnect over FCL, shortened by OMPL and timed by toppra along a spline.

Its ``Planner.plan_qpos`` is these three calls in a row; they are made one by one so that each can be timed.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import mplib
import numpy as np
from mplib.pymp.collision_detection import fcl

from benchmarks.baselines.peers.adapter_protocol import Answer, Table, clock, serve

__all__ = ["Mplib"]

TIME_STEP = 0.01


class Mplib:
    """One planner for each problem: it has no way to forget a scene."""

    def __init__(self, job: Table) -> None:
        self._robot, self._settings, self._limit = job["robot"], job["settings"], job["time_limit"]
        for mesh in Path(self._robot["urdf"]).parent.rglob("*.stl"):
            if not mesh.name.endswith(".convex.stl"):  # where it looks for the hull of a mesh
                shutil.copyfile(mesh, mesh.with_name(mesh.name + ".convex.stl"))

    def solve(self, problem: Table, seed: int, answer: Answer) -> None:
        """RRTConnect, then OMPL's simplifier, then toppra."""
        with answer.stage("setup"):
            planner = self._planner(problem)
        mplib.set_global_seed(seed)
        start, goals = np.array(problem["start"]), [np.array(goal) for goal in problem["goals"]]
        planner.robot.set_qpos(start, True)
        with answer.stage("search"):
            status, path = planner.planner.plan(
                start, goals, time=self._limit, range=self._settings["range"], simplify=False
            )
        if status != "Exact solution":
            answer.error = str(status)
            return
        answer.raw = path
        with answer.stage("shortcut"):
            answer.waypoints = planner.planner.simplify_path(path)
        if clock(answer, self._limit) <= 0.01:
            return
        with answer.stage("timing"):
            times, samples, velocities, accelerations, _ = planner.TOPP(np.asarray(answer.waypoints), TIME_STEP)
        answer.times, answer.samples = times, samples
        answer.velocities, answer.accelerations = velocities, accelerations

    def _planner(self, problem: Table) -> Any:
        robot = self._robot
        planner = mplib.Planner(
            urdf=robot["urdf"],
            srdf=robot["srdf"],
            move_group=robot["tool_frame"],
            use_convex=True,
            user_joint_names=robot["joints"],
            joint_vel_limits=robot["velocity"],
            joint_acc_limits=robot["acceleration"],
        )
        acm = planner.planning_world.get_allowed_collision_matrix()
        for body in problem["obstacles"]:
            pose = mplib.Pose(body["position"], body["quaternion_wxyz"])
            shape = fcl.CollisionObject(_shape(body))
            planner.planning_world.add_object(fcl.FCLObject(body["name"], pose, [shape], [mplib.Pose()]))
            for link in robot["base_links"]:
                acm.set_entry(link, body["name"], True)
        return planner


def _shape(body: Table) -> Any:
    kind = body["kind"]
    if kind == "box":
        return fcl.Box(body["size"])
    if kind == "sphere":
        return fcl.Sphere(body["radius"])
    return {"cylinder": fcl.Cylinder, "capsule": fcl.Capsule}[kind](body["radius"], body["length"])


if __name__ == "__main__":
    serve(("mplib", "toppra", "numpy"), Mplib)
