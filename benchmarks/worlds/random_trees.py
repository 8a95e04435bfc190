"""Arms that are drawn at random, as plan files write them, and how far their points move."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from auditor.trails import World, chain, placed

__all__ = ["TreeDraw", "draw_points", "draw_tree"]

Array = Any

KINDS = ("box", "sphere", "capsule", "cylinder", "compound", "compound", "compound")


class TreeDraw(NamedTuple):
    """An arm: ``robot`` holds the keys of a plan file's robot that its geometry is in."""

    robot: dict[str, Any]


def _pose(chance: np.random.Generator, far: float) -> dict[str, Any]:
    quaternion = chance.normal(size=4)
    return {
        "position": chance.uniform(-far, far, 3).tolist(),
        "quaternion_wxyz": (quaternion / np.linalg.norm(quaternion)).tolist(),
    }


def _solid(chance: np.random.Generator, kind: str) -> dict[str, Any]:
    size = chance.uniform(0.01, 0.4, 3)
    if kind == "box":
        return {"kind": kind, "size": size.tolist()}
    if kind == "compound":
        parts = [_solid(chance, str(chance.choice(KINDS[:4]))) for _ in range(int(chance.integers(1, 4)))]
        return {"kind": kind, "parts": [{"shape": part, "pose": _pose(chance, 0.4)} for part in parts]}
    return {"kind": kind, "radius": float(size[0])} | ({} if kind == "sphere" else {"length": float(size[1])})


def _matrix(pose: dict[str, Any]) -> list[list[float]]:
    w, x, y, z = pose["quaternion_wxyz"]
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R = np.eye(3) + 2 * w * K + 2 * K @ K
    return [*(np.column_stack([R, pose["position"]]).tolist()), [0.0, 0.0, 0.0, 1.0]]


def draw_tree(chance: np.random.Generator) -> TreeDraw:
    """A tree of up to eight bodies on turning and sliding joints, some of which move with another one's."""
    joints = int(chance.integers(1, 5)) if chance.random() < 0.5 else 1
    bodies: list[dict[str, Any]] = [
        {"name": "base", "parent": -1, "placement": np.eye(4).tolist(), "axis": [0.0, 0.0, 0.0], "q_index": -1}
        | {"prismatic": False}
    ]
    for k in range(int(chance.integers(joints, 9)) if joints > 1 else 1):
        axis = chance.normal(size=3)
        axis /= np.linalg.norm(axis)
        own = k < joints
        bodies.append(
            {
                "name": f"body_{k}",
                "parent": int(chance.integers(0, len(bodies))),
                "placement": _matrix(_pose(chance, 0.5)),
                "axis": axis.tolist(),
                "prismatic": bool(chance.random() < 0.3),
                "q_index": k if own else int(chance.integers(0, joints)),
                "multiplier": 1.0 if own else float(chance.choice([-2.0, -1.0, 0.5, 1.0, 3.0])),
            }
        )
    shapes = [
        {"link": f"link_{k}_{j}", "body": k, "pose": _pose(chance, 0.5 if chance.random() < 0.5 else 0.02)}
        | {"shape": _solid(chance, str(chance.choice(KINDS)))}
        for k in range(len(bodies))
        for j in range(int(chance.integers(1, 3)))
    ]
    robot = {
        "bodies": bodies,
        "joint_names": [f"joint_{k}" for k in range(joints)],
        "shapes": shapes,
        "gripper": None,
        "tool_body": len(bodies) - 1,
        "tool_placement": np.eye(4).tolist(),
        "allowed_contacts": [],
    }
    return TreeDraw(robot)


def draw_points(world: World, chance: np.random.Generator, count: int) -> tuple[float, float]:
    """By how much points move farther than their levers allow, and how much of these they use, at most.

    They are points of some pieces, on random ways between two configurations, seen from the innermost body that
    carries them and another body. The first number is in metres, and not above 0 if the bound holds.

    Args:
        count: Points drawn, each on a way of its own.
    """
    columns = world.column + 1
    first = int(chance.integers(len(world.of)))
    solid = world.solids[world.of[first]]
    end = int(chance.integers(first + 1, solid.end + 1))
    other = int(chance.integers(len(world.bodies)))
    most = chance.uniform(0.1, 7.0, columns)
    lever = world.levers(first, end, other, most)
    carrier = max({0, *chain(world.bodies, solid.body)} & {0, *chain(world.bodies, other)})
    here = chance.uniform(-1, 1, (count, columns)) * most
    there = np.clip(here + chance.uniform(-0.2, 0.2, (count, columns)), -most, most)  # chords are as long as arcs
    steps = 16
    ways = here + (there - here) * np.linspace(0, 1, steps + 1)[:, None, None]
    allowed = np.abs(there - here) @ lever
    rows = chance.integers(world.starts[first], world.starts[end], count)
    points, axes = world.points[rows], world.axes[rows]
    outward = np.where(chance.random((count, 1)) < 0.5, points, chance.normal(size=(count, 3)))
    disc = outward - (outward * axes).sum(axis=1)[:, None] * axes
    disc /= np.maximum(np.linalg.norm(disc, axis=1), 1e-12)[:, None]
    ball = outward / np.maximum(np.linalg.norm(outward, axis=1), 1e-12)[:, None]
    own = points + world.discs[rows, None] * disc + world.balls[rows, None] * ball
    moved = np.zeros(count)
    before = None
    for q in ways:
        at = placed(world.bodies, q)
        seen = np.linalg.inv(at[carrier]) @ at[solid.body]
        place = (seen[:, :3, :3] @ own[:, :, None])[:, :, 0] + seen[:, :3, 3]
        moved += 0.0 if before is None else np.linalg.norm(place - before, axis=1)
        before = place
    used = moved / np.maximum(allowed, 1e-12)
    shared = set(chain(world.bodies, solid.body)) == set(chain(world.bodies, other))
    return float((moved - allowed).max()), 0.0 if shared else float(used.max())
