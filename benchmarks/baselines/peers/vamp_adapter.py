"""vamp: its vectorised RRT-Connect (or FCIT*) and its simplifier, with the spheres and robots compiled into it.

It has no meshes, no cylinders and no timing: its own spheres stand for the robot, a cylinder becomes a capsule, in the
problems named "box" a box, as its own benchmark has it. Seconds are wall clock of its calls from Python.
"""

from __future__ import annotations

import math
from typing import Any

import vamp

from benchmarks.baselines.peers.adapter_protocol import Answer, Table, matrix_of, serve

__all__ = ["Vamp"]

ROBOTS = {"panda_mbm": "panda"}
"""What a robot of ours is called there."""


class Vamp:
    """Settings once, an environment for each problem."""

    def __init__(self, job: Table) -> None:
        name = job["robot"]["name"]
        if name not in ROBOTS:
            raise ValueError(f"vamp is compiled for panda, ur5, fetch and baxter, and for no {name}")
        settings = {key: value for key, value in job["settings"].items() if key != "planner"}
        self._robot, self._plan, self._planning, self._simplifying = vamp.configure_robot_and_planner_with_kwargs(
            ROBOTS[name], job["settings"]["planner"], **settings
        )

    def solve(self, problem: Table, seed: int, answer: Answer) -> None:
        """The planner, then the simplifier; a seed is how many of the Halton points are left out."""
        with answer.stage("setup"):
            world = self._world(problem)
            sampler = self._robot.halton()
            sampler.reset()
            sampler.skip(1000 * seed)
        with answer.stage("search"):
            found = self._plan(problem["start"], problem["goals"], world, self._planning, sampler)
        if not found.solved:
            answer.error = f"no path within {found.iterations} iterations"
            return
        answer.raw = found.path.numpy()  # iterating a path never ends
        with answer.stage("shortcut"):
            shorter = self._robot.simplify(found.path, world, self._simplifying, sampler)
        answer.waypoints = shorter.path.numpy()

    def _world(self, problem: Table) -> Any:
        world = vamp.Environment()
        boxed = problem["problem"].partition("/")[0] == "box"
        for body in problem["obstacles"]:
            kind, where = body["kind"], body["position"]
            if kind == "sphere":
                world.add_sphere(vamp.Sphere(where, body["radius"]))
            elif kind == "box" or (kind == "cylinder" and boxed):
                size = body.get("size") or [2 * body.get("radius", 0.0), 2 * body.get("radius", 0.0), body["length"]]
                world.add_cuboid(vamp.Cuboid(where, _euler(body), [side / 2 for side in size]))
            elif kind in ("cylinder", "capsule"):
                capsule = getattr(vamp, "Capsule", vamp.Cylinder)  # before it had both, its cylinders were capsules
                world.add_capsule(capsule(where, _euler(body), body["radius"], body["length"]))
            else:
                raise ValueError(f"{body['name']}: vamp has no {kind}")
        return world


def _euler(body: Table) -> list[float]:
    """Angles of turns about the fixed x, then the fixed y, then the fixed z."""
    turn = matrix_of(body)
    y = math.asin(max(-1.0, min(1.0, -turn[2][0])))
    return [math.atan2(turn[2][1], turn[2][2]), y, math.atan2(turn[1][0], turn[0][0])]


if __name__ == "__main__":
    serve(("vamp-planner", "numpy"), Vamp)
