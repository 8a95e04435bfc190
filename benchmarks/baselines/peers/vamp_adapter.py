"""VAMP as its authors evaluate it: RRTConnect with their range for the robot, then their simplifier.

Obstacles are made as its own evaluation makes them: a cylinder is a capsule, and a box in the problems called box,
which need a grasp from above. Nothing times the path. Its seed is how much of the Halton sequence is skipped.
"""

from __future__ import annotations

import math
from typing import Any

import vamp

from benchmarks.baselines.peers.adapter_protocol import Answer, Table, serve

__all__ = ["Vamp"]

SKIPPED = 1_000
"""Numbers of the sequence that are skipped for each seed."""


class Vamp:
    """One robot of VAMP's own; the joints are the problem's."""

    def __init__(self, job: Table) -> None:
        settings = job["settings"]
        most = settings["samples"]
        self._made = vamp.configure_robot_and_planner_with_kwargs(
            settings["robot"], settings["planner"], max_iterations=most, max_samples=most
        )

    def solve(self, problem: Table, seed: int, answer: Answer) -> None:
        """Search, then simplify."""
        module, search, search_settings, simple_settings = self._made
        with answer.stage("setup"):
            world = vamp.Environment()
            for body in problem["obstacles"]:
                _add(world, body, problem["problem"].startswith("box/"))
            sampler = module.halton()
            sampler.skip(SKIPPED * seed)
        with answer.stage("search"):
            found = search(problem["start"], problem["goals"], world, search_settings, sampler)
        if not found.solved:
            answer.error = f"no path in {found.iterations} iterations"
            return
        with answer.stage("shortcut"):
            short = module.simplify(found.path, world, simple_settings, sampler)
        answer.waypoints = short.path.numpy()


def _add(world: Any, body: Table, boxed: bool) -> None:
    """Put an obstacle into a world."""
    place, turn = body["position"], _euler(body["quaternion_wxyz"])
    if body["kind"] == "box":
        world.add_cuboid(vamp.Cuboid(place, turn, [size / 2 for size in body["size"]]))
    elif body["kind"] == "sphere":
        world.add_sphere(vamp.Sphere(place, body["radius"]))
    elif boxed:
        world.add_cuboid(vamp.Cuboid(place, turn, [body["radius"], body["radius"], body["length"] / 2]))
    else:
        world.add_capsule(vamp.Cylinder(place, turn, body["radius"], body["length"]))


def _euler(quaternion: list[float]) -> list[float]:
    """Angles (rad) about the fixed x, then y, then z axis."""
    w, x, y, z = quaternion
    return [
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x)))),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    ]


if __name__ == "__main__":
    serve(("vamp-planner",), Vamp)
