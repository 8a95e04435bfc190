"""A map of a million voxels, and ten thousand of them held against brute force.

Brute force draws positions in a voxel, takes all of the WidowX AI's solutions in closed form, and asks FCL about them.
A voxel that is proven to have none must have none; the witness of one that is reachable must be one.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, table_of
from planner_service import CollisionChecker, Pose, inverse_kinematics, load_robot, load_scene
from planner_service.geometry.arrays import IntArray
from planner_service.robot.model import Robot
from planner_service.workspace import ReachabilityMap, ToolOrientation, VoxelGrid, VoxelVerdict, reachability

__all__ = ["run"]

VOXELS = 10_000
"""Of the map, held against brute force unless asked otherwise."""

SIDE = 100
"""Voxels along each axis."""

DOWN = (0.5**0.5, 0.0, 0.5**0.5, 0.0)

DRAWN = 20
"""Positions in each voxel of brute force; every second one near its faces."""


def run(
    queries: int | None,
    seed: int,
    name: str | None = None,
    kept: Kept = NONE,
    side: int = SIDE,
    workers: int = 2,
) -> Report:
    """The map of the WidowX AI, the only arm there is, and ``queries`` of its voxels."""
    asked = VOXELS if queries is None else queries
    robot, scene = load_robot("wxai"), load_scene("bin")
    grid = VoxelGrid((-0.6, -0.6, -0.05), (0.6, 0.6, 0.55), (side, side, side))
    began, cpu = time.perf_counter(), time.process_time()
    found = reachability(robot, scene, grid, [ToolOrientation(DOWN)], workers=workers)
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    checker = CollisionChecker(robot, scene, backend="fcl")
    rng = np.random.default_rng(seed)
    wrong = reached = 0
    for cell in rng.integers(0, side, size=(asked, 3)):
        verdict = VoxelVerdict(int(found.verdicts[0][tuple(cell)]))
        if verdict is VoxelVerdict.REACHABLE:
            wrong += not _is_witness(robot, checker, found, cell)
        brute = _brute_force(robot, checker, grid, cell, rng)
        reached += brute
        wrong += brute and verdict in (VoxelVerdict.OUT_OF_REACH, VoxelVerdict.BLOCKED)
    shares = {kind.name.lower(): found.share(kind) for kind in VoxelVerdict}
    row = {"voxels": len(grid), "seconds": seconds, "cpu": cpu, **shares, "asked": asked, "brute": reached}
    row["wrong"] = wrong
    line = {
        "voxels": f"{len(grid):,}",
        "reachable": f"{100 * shares['reachable']:.2f} %",
        "out of reach": f"{100 * shares['out_of_reach']:.2f} %",
        "blocked": f"{100 * shares['blocked']:.2f} %",
        "unknown": f"{100 * shares['unknown']:.2f} %",
        "seconds": f"{seconds:.0f}",
        "CPU s": f"{cpu:.0f}",
        "held against brute force": f"{asked:,}",
        "which reached": f"{reached:,}",
        "contradictions": str(wrong),
    }
    caption = f"The WidowX AI in bin, the tool pointing down, 1.2 x 1.2 x 0.6 m; {workers} threads."
    promises = (
        Promise("at most 2 % of the voxels are unknown", f"{100 * shares['unknown']:.2f} %", shares["unknown"] <= 0.02),
        Promise("brute force contradicts none", str(wrong), wrong == 0),
    )
    return Report("ik maps", (row,), (table_of("A reachability map", [line], caption=caption),), promises)


def _is_witness(robot: Robot, checker: CollisionChecker, found: ReachabilityMap, cell: IntArray) -> bool:
    centre = found.grid.centres(cell[None])[0]
    q = found.witness(centre)
    if q is None or not checker.state_is_free(q):
        return False
    T = robot.tool_pose(q)
    turned = np.abs(T[:3, :3] - Pose((0.0, 0.0, 0.0), DOWN).rotation).max()
    return bool(np.all(np.abs(T[:3, 3] - centre) <= found.grid.half) and turned <= 1e-8)


def _brute_force(
    robot: Robot, checker: CollisionChecker, grid: VoxelGrid, cell: IntArray, rng: np.random.Generator
) -> bool:
    """Whether some of the positions drawn has a configuration that is free."""
    centre = grid.centres(cell[None])[0]
    for k in range(DRAWN):
        shift = rng.uniform(-1.0, 1.0, 3)
        if k % 2:
            shift = np.sign(shift) * np.abs(shift) ** 0.2
        x, y, z = (centre + shift * grid.half).tolist()
        for q in inverse_kinematics(robot, Pose((x, y, z), DOWN)):
            if checker.state_is_free(q):
                return True
    return False
