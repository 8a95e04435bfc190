"""Checks a proof in a file that no path exists: its walls collide, and they enclose the start or all goals.

    python -m auditor no_path.json

The values of some joints are cut into boxes, whose corners lie on a grid. The region is made of boxes that hold the one
end and not the other. Each face of one of them is covered by faces of other boxes of the region and of walls, or lies
on a limit of its joint: who leaves the region passes through a wall.

A wall is a box in which two solids overlap wherever the joints are, those included that are not cut into boxes. Let c
be s deep in the one and d be t deep in the other, at least, in the middle of the box; outside, s or t is minus the
distance. In each direction n the one reaches ``n.c + s`` at least, and the other ``n.d - t`` back. So they overlap if
``abs(c - d) < s + t``, and all over the box if ``abs(c - d) + m < s + t``, where m is how far c and d move with their
bodies against each other. It is bounded joint by joint, outermost first: one that turns by an angle a moves a point by
at most ``min(a, 2) r``, r being the distance from its axis in the middle, and how far joints beyond have moved it.

The claim is for this start and these goals, number by number; another end of the same tool pose is another claim.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from auditor.schema import check_file, require
from auditor.trails import SLACK, Solid, World, chain, digest, filled, frame, placed, unpacked

Array = Any
Json = Any

FORMAT = "planner-service/no-path"
MOST_JOINTS, MOST_DIVISIONS = 4, 2**20  # volumes of faces are whole numbers of 64 bits


def depth(solid: Json, name: str, points: Array, document: Json) -> Array:
    """How deep points (m, 3) are in a solid, at least, (m,); outside of it minus the distance, or -inf."""
    kind, r, half = solid["kind"], float(solid.get("radius", 0.0)), float(solid.get("length", 0.0)) / 2
    if kind == "compound":
        parts = [(part["shape"], frame(part["pose"])) for part in solid["parts"]]
        found = [depth(one, name, (points - T[:3, 3]) @ T[:3, :3], document) for one, T in parts]
        return np.max(found, axis=0)
    if kind in ("cloud", "heights"):
        rows = filled(name, solid, document["boxes"][name])
        return np.max([outside(np.abs(points - row.mean(axis=0)) - np.ptp(row, axis=0) / 2) for row in rows], axis=0)
    if kind in ("sphere", "capsule"):
        return r - np.linalg.norm(points - np.clip(points, [0, 0, -half], [0, 0, half]), axis=1)
    if kind == "cylinder":
        return outside(np.column_stack([np.hypot(points[:, 0], points[:, 1]) - r, np.abs(points[:, 2]) - half]))
    if kind == "box":
        return outside(np.abs(points) - np.array(solid["size"], float) / 2)
    require(kind == "mesh", f"{name}: no such solid: {kind}")
    return in_mesh(solid, points, document["faces"][hashlib.sha256(solid["vertices"].encode()).hexdigest()])


def outside(beyond: Array) -> Array:
    """Depths (m,) of points that are so far beyond pairs of parallel faces, or of a cylinder's side and its ends."""
    return -np.linalg.norm(np.maximum(beyond, 0), axis=1) - np.minimum(beyond.max(axis=1), 0)


def in_mesh(solid: Json, points: Array, faces: str) -> Array:
    """How far points are from the planes of triangles between corners, if they are behind all of these.

    The triangles close: each edge is there once each way. Seen from a point behind all of them, they cover all
    directions, and each is in the hull: so is a ball that reaches no plane.
    """
    corners, triangles = unpacked(solid["vertices"], "<f8", 3, small=False), unpacked(faces, "<i4", 3)
    edges = {(a, b) for row in triangles.tolist() for a, b in zip(row, row[1:] + row[:1], strict=True)}
    closes = len(edges) == 3 * len(triangles) > 0 and edges == {(b, a) for a, b in edges} and (triangles >= 0).all()
    require(closes, "triangles of a mesh that do not close")
    a, b, c = corners[triangles].transpose(1, 0, 2)
    n = np.cross(b - a, c - a)
    n /= np.linalg.norm(n, axis=1)[:, None]
    least = ((a * n).sum(1) - points @ n.T).min(axis=1)
    return np.where(least > 0, least, -np.inf)


def collide(world: World, pair: Json, centres: Array, Q: Array, half: Array, document: Json) -> Array:
    """Which boxes of joint values about Q (m, n), of half widths (m, n), are walls by a pair, (m,).

    ``centres`` (m, 2, 3) are in the frames of the bodies of the two.
    """
    owners = [[solid for solid in world.solids if solid.name == name] for name in pair]
    at, bodies = placed(world.bodies, Q), [those[0].body for those in owners]
    room, places = np.zeros(len(Q)), list[Array]()
    for k, (those, body, other) in enumerate(zip(owners, bodies, bodies[::-1], strict=True)):
        require([solid.body == body for solid in those], f"{pair[k]}: not of one body")
        c, m = (at[body][:, :3, :3] @ centres[:, k, :, None])[:, :, 0] + at[body][:, :3, 3], np.zeros(len(Q))
        for joint in chain(world.bodies, body):
            if joint not in chain(world.bodies, other):
                it, T = world.bodies[joint], at[joint]
                r = np.linalg.norm(np.cross(T[:, :3, :3] @ it["axis"], c - T[:, :3, 3]), axis=1)
                way = abs(it["multiplier"]) * half[:, it["q_index"]]
                m = m + (way if it["prismatic"] else np.minimum(way, 2) * (r + m))
        room += np.max([deep(solid, centres[:, k], document) for solid in those], axis=0) - m
        places.append(c)
    return np.linalg.norm(places[0] - places[1], axis=1) + SLACK < room


def deep(solid: Solid, points: Array, document: Json) -> Array:
    """How deep points in the frame of the body that carries a solid are in it."""
    name, R, t = solid.name.removesuffix(" (object)"), solid.at[:3, :3], solid.at[:3, 3]
    return depth(solid.record, name, (points - t) @ R, document)


def enclosed(region: Array, walls: Array, divisions: Array, endless: Array) -> None:
    """Show that each face of the region is covered: boxes that are disjoint cover as much as they share with it."""
    boxes = np.concatenate([region, walls])
    whole = (boxes[:, 0] >= 0).all() and (boxes[:, 0] < boxes[:, 1]).all() and (boxes[:, 1] <= divisions).all()
    require(whole and (divisions > 0).all() and (divisions <= MOST_DIVISIONS).all(), "boxes that are not on the grid")
    for box in boxes:
        shared = np.minimum(boxes[:, 1], box[1]) > np.maximum(boxes[:, 0], box[0])
        require(shared.all(axis=1).sum() == 1, "boxes that overlap")
    for box in region:
        for axis, side in ((axis, side) for axis in range(len(divisions)) for side in (0, 1)):
            edge = box[side, axis]
            if edge == (0, divisions[axis])[side]:
                if not endless[axis]:
                    continue
                edge = divisions[axis] - edge
            beside = boxes[boxes[:, 1 - side, axis] == edge]
            shared = np.maximum(np.minimum(beside[:, 1], box[1]) - np.maximum(beside[:, 0], box[0]), 0)
            covered = np.delete(shared, axis, axis=1).prod(axis=1).sum() == np.delete(box[1] - box[0], axis).prod()
            require(covered, f"the region is open at {box.tolist()}")


def verify(document: Json) -> Iterator[str]:
    """What a file shows, line by line; Invalid if that is not that no path exists."""
    check_file(document)
    robot, scene, names = document["robot"], document["scene"], document["joints"]
    require(document["version"] == 1 and 1 <= len(set(names)) == len(names) <= MOST_JOINTS, "another version")
    for part in ("robot", "scene"):
        yield f"{part} {digest(document[part])}"
    columns, k = [robot["joint_names"].index(name) for name in names], len(names)
    endless = np.array(robot.get("continuous") or [False] * len(robot["joint_names"]))
    lower, upper = (np.where(endless, 0.0, np.array(robot["limits"][side], float)) for side in ("lower", "upper"))
    low, high = (np.array(row, float) for row in document["range"])
    limits = np.where(endless[columns], np.abs(high - low - 2 * math.pi), np.abs(low - lower[columns]))
    same = (limits < SLACK) & ((np.abs(high - upper[columns]) < SLACK) | endless[columns])
    require(same, "boxes of other ranges than the joints have")

    moved = document["moved"]
    world = World(robot, scene["obstacles"], scene["attached"], document["allowed"], document["boxes"], moved)
    require(world.stands(robot["gripper_width"]), "fingers elsewhere")
    divisions, pairs = np.array(document["divisions"], np.int64), document["pairs"]
    require(divisions.shape == low.shape == high.shape == (k,), "a range or divisions of other joints")
    region = unpacked(document["region"], "<i8", 2 * k).reshape(-1, 2, k)
    walls, of = np.split(unpacked(document["walls"], "<i8", 2 * k + 1), [2 * k], axis=1)
    walls, centres = walls.reshape(-1, 2, k), unpacked(document["centres"], "<f8", 6).reshape(-1, 2, 3)
    require(len(centres) == len(walls) and ((of >= 0) & (of < len(pairs))).all(), "walls of no pair")
    enclosed(region, walls, divisions, endless[columns])

    Q = np.tile([*(lower + upper) / 2, moved], (len(walls), 1))
    half = np.tile([*np.where(endless, math.inf, (upper - lower) / 2), 0.0], (len(walls), 1))
    Q[:, columns] = low + (high - low) * walls.mean(axis=1) / divisions
    half[:, columns] = (high - low) * np.diff(walls, axis=1)[:, 0] / divisions / 2 + SLACK
    wanted = {frozenset((one.name, two.name)) for one, two in world.wanted()}
    excepted = [pair for retreat in robot["retreats"] for pair in retreat["pairs"]]
    wanted -= {frozenset(world.label("link", name) for name in pair) for pair in excepted}
    for number, pair in enumerate(pairs):
        on = np.flatnonzero(of[:, 0] == number)
        require(frozenset(pair) in wanted, f"{pair} need not be apart")
        sure = collide(world, pair, centres[on], Q[on], half[on], document)
        where = walls[on[~sure][0]].tolist() if not sure.all() else []
        require(sure, f"{pair[0]} x {pair[1]} are not shown to collide in all of the box {where}")
        yield f"walls of {pair[0]} x {pair[1]}: {len(on)}"

    start, goals, held = document["start"], document["goals"], document["encloses"]
    require(held in ("start", "goals") and len(goals) > 0, "ends that are none")
    for q, inside in [(start, held == "start"), *((goal, held == "goals") for goal in goals)]:
        x = np.array(q, float)[columns]
        require(np.isfinite(x), f"{q} is no configuration")
        x = np.where(endless[columns], low + (x - low) % (2 * math.pi), np.clip(x, low, high))  # as planners clip it
        boxes, x = np.concatenate([region, walls]) if inside else region, (x - low) / (high - low) * divisions
        slack = 0.0 if inside else SLACK * divisions
        holds = ((x >= boxes[:, 0] - slack) & (x <= boxes[:, 1] + slack)).all(axis=1).any()
        require(holds == inside, f"{q} is not where the proof needs it")
    yield f"from {start} no path leads to any of {len(goals)} goals:"
    yield from (f"  {goal}" for goal in goals)
    yield from (f"may touch: {pair} (allowed by the author)" for pair in document["allowed"])
    yield "verified: that its walls collide and leave no way between; not verified: hashes"
