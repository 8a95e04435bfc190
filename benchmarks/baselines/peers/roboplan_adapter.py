"""roboplan: its RRT-Connect over Pinocchio and Coal, its shortcutter, its TOPP-RA along Hermite splines."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from roboplan import core, rrt, toppra

from benchmarks.baselines.peers.adapter_protocol import Answer, Table, clock, matrix_of, serve

__all__ = ["Roboplan"]

GROUP = "arm"
COLOUR = np.array([0.5, 0.5, 0.5, 1.0])


class Roboplan:
    """The robot once, a scene of its own for each problem."""

    def __init__(self, job: Table) -> None:
        self._robot, self._settings, self._limit = job["robot"], job["settings"], job["time_limit"]
        folder = Path(self._robot["urdf"]).parent
        lines = [f"  {name}:\n    max_acceleration: [{value}]" for name, value in self._accelerations()]
        (folder / "limits.yaml").write_text("joint_limits:\n" + "\n".join(lines) + "\n", "utf-8")

    def solve(self, problem: Table, seed: int, answer: Answer) -> None:
        """RRT-Connect, shortcuts, TOPP-RA."""
        with answer.stage("setup"):
            scene = self._scene(problem)
            scene.setRngSeed(seed)
        step, names = self._settings["step"], self._robot["joints"]
        start = core.JointConfiguration(names, np.array(problem["start"]))
        path = None
        for goal in problem["goals"]:
            options = rrt.RRTOptions(
                group_name=GROUP,
                max_nodes=self._settings["max_nodes"],
                collision_check_step_size=step,
                max_planning_time=clock(answer, self._limit),
                rrt_connect=True,
            )
            planner = rrt.RRT(scene, options)
            planner.setRngSeed(seed)
            with answer.stage("search"):
                path = planner.plan(start, core.JointConfiguration(names, np.array(goal)), [])
            if path is not None:
                break
        if path is None:
            answer.error = "no path within its time or nodes"
            return
        answer.raw = np.array(path.positions)
        with answer.stage("shortcut"):
            shortcuts = core.PathShortcuttingOptions(group_name=GROUP, max_step_size=step, seed=seed)
            path = core.PathShortcutter(scene, shortcuts).shortcut(path)
        answer.waypoints = np.array(path.positions)
        with answer.stage("timing"):
            timed = toppra.PathParameterizerTOPPRA(scene, GROUP).generate(path, toppra.TOPPRAOptions(dt=0.01))
        answer.times, answer.samples = np.array(timed.times), np.array(timed.positions)
        answer.velocities, answer.accelerations = np.array(timed.velocities), np.array(timed.accelerations)

    def _accelerations(self) -> list[tuple[str, float]]:
        return list(zip(self._robot["joints"], self._robot["acceleration"], strict=True))

    def _scene(self, problem: Table) -> Any:
        urdf = Path(self._robot["urdf"])
        scene = core.Scene("problem", core.loadUrdfSceneDescription(urdf, [urdf.parent]))
        scene.importSrdf(core.loadTextFile(self._robot["srdf"]))
        scene.importJointLimitsFromConfig(core.loadJointLimitsConfig(urdf.parent / "limits.yaml"))
        names = []
        for body in problem["obstacles"]:
            _add(scene, body)
            names.append(body["name"])
        allowed = list(itertools.combinations(names, 2))  # else what rests on a table is a collision of the robot
        allowed += [(link, name) for link in self._robot["base_links"] for name in names]
        if allowed:
            scene.setCollisions(allowed, False)
        return scene


def _add(scene: Any, body: Table) -> None:
    kind, where = body["kind"], ("universe",)
    placed = (np.array(matrix_of(body)), COLOUR)
    if kind == "box":
        scene.addBoxGeometry(body["name"], *where, core.Box(*body["size"]), *placed)
    elif kind == "sphere":
        scene.addSphereGeometry(body["name"], *where, core.Sphere(body["radius"]), *placed)
    elif kind == "cylinder":
        scene.addCylinderGeometry(body["name"], *where, core.Cylinder(body["radius"], body["length"]), *placed)
    else:
        raise ValueError(f"{body['name']}: roboplan has no {kind}")


if __name__ == "__main__":
    serve(("roboplan", "roboplan-core", "coal", "numpy"), Roboplan)
