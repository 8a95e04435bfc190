"""This package, at the version that is installed in the environment: the default request, as a user writes it.

A scene's first problem builds the scene and its service and plans once ("setup"); after that, the fastest of a few
turns counts. The path handed back is sampled from the timed motion, which follows exactly the curve that was proven.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.baselines.peers.adapter_protocol import Answer, Table, serve

time.perf_counter = time.thread_time  # by which a result's stages are timed: CPU time, as the whole is
ROOT = str(Path(__file__).parents[3])
sys.path[:] = [*(folder for folder in sys.path if folder != ROOT), ROOT]  # this environment's version, if it has one

import numpy as np  # noqa: E402

import planner_service as ps  # noqa: E402

STEP = 0.005
"""Radians that a joint turns at most between two samples of the path handed back."""


class PlannerService:
    """The service of the scene that was asked for last."""

    def __init__(self, job: Table) -> None:
        self._robot, self._turns = ps.load_robot(job["robot"]["name"]), job["settings"]["turns"]
        joints = list(job["robot"].get("joints", self._robot.joint_names))
        self._order = [joints.index(name) for name in self._robot.joint_names]
        self._world: Any = None

    def solve(self, problem: Table, seed: int, answer: Answer) -> None:
        """Plan, prove, time."""
        start, *goals = (np.array(q)[self._order] for q in (problem["start"], *problem["goals"]))
        request = ps.PlanRequest(start, goals[0] if len(goals) == 1 else goals, seed=seed)
        with answer.stage("setup"):
            self._prepare(problem, request)
        spent: dict[str, list[float]] = {"whole": []}
        for _ in range(self._turns):
            clock = time.process_time()
            result = self._service.plan(request)
            spent["whole"].append(time.process_time() - clock)
            for report in result.stages:
                spent.setdefault(report.stage.value, []).append(report.seconds)
        answer.cpu_seconds = min(spent.pop("whole"))
        answer.stage_cpu_seconds |= {stage: min(seconds) for stage, seconds in spent.items()}
        answer.checks = {report.stage.value: report.counts.states for report in result.stages}
        proof = result.certificate
        if result.trajectory is None or proof is None or not proof.certified:
            answer.error = str(result.failure or "not certified")
            return
        answer.times, Q = _sampled(result.trajectory)
        answer.waypoints = Q[:, np.argsort(self._order)]

    def _prepare(self, problem: Table, request: ps.PlanRequest) -> None:
        world = (problem.get("scene"), problem.get("edge_step"), problem.get("obstacles"))
        if world == self._world:
            return
        scene = problem["scene"] if world[0] else ps.Scene(tuple(map(_obstacle, problem["obstacles"])))
        step = None if world[1] is None else getattr(ps, world[1][0])(world[1][1])
        self._world, self._service = world, ps.PlannerService(self._robot, scene, edge_step=step)
        self._service.plan(request)


def _sampled(trajectory: ps.Trajectory) -> tuple[Any, Any]:
    """Instants and configurations of a motion, no joint turning more than ``STEP`` from one to the next."""
    count = 2 + int(trajectory.path.length / STEP)
    while True:
        times = np.linspace(0.0, trajectory.duration, count)
        rows = trajectory(times)
        if np.abs(np.diff(rows, axis=0)).max(initial=0.0) <= STEP:
            return times, rows
        count *= 2


def _obstacle(body: Table) -> ps.Obstacle:
    pose = ps.Pose(tuple(body["position"]), tuple(body["quaternion_wxyz"]))
    return ps.Obstacle(body["name"], _shape(body), pose)


def _shape(body: Table) -> Any:
    kind = body["kind"]
    if kind == "box":
        return ps.Box(tuple(body["size"]))
    if kind == "sphere":
        return ps.Sphere(body["radius"])
    return {"cylinder": ps.Cylinder, "capsule": ps.Capsule}[kind](body["radius"], body["length"])


if __name__ == "__main__":
    serve(("planner-service",), PlannerService)
