"""Whether fingers pass through each other, which no check of a gripper notices: they ride on one body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from planner_service.collision import CollisionChecker, Contact
from planner_service.geometry.decomposition import pieces_of_mesh
from planner_service.geometry.mesh import Mesh
from planner_service.robot.model import Robot
from planner_service.robot.urdf_model import Urdf, UrdfJoint
from planner_service.scene.scene import Scene

__all__ = ["finger_overlap"]

DRAWS = 100
"""Random positions of the joints of fingers."""

CROSSING = 0.005
"""Metres of overlap that is more than pads that touch."""


def finger_overlap(urdf: Urdf, fingers: Sequence[UrdfJoint], robot: Robot) -> tuple[Contact, str] | None:
    """The deepest overlap of two fingers within the ranges of their joints, and at which; None if they meet at most.

    Where the hulls of their meshes overlap, these are cut into convex pieces, and the pieces have to, too.

    Args:
        fingers: The joints of the fingers.
        robot: With these as joints like others.
    """
    names = {joint.name for joint in fingers}
    roots = {}
    for link in {item.link for item in robot.shapes}:
        above = link
        while above in urdf.above:
            joint = urdf.above[above]
            above = joint.parent
            if joint.name in names:
                roots[link] = joint.name
    columns = [k for k, name in enumerate(robot.joint_names) if name in names]
    found = _deepest(robot, columns, roots) if columns else None
    return None if found is None else _deepest(_in_pieces(robot, roots), columns, roots)


def _deepest(robot: Robot, columns: Sequence[int], roots: Mapping[str, str]) -> tuple[Contact, str] | None:
    checker, (lower, upper) = CollisionChecker(replace(robot, allowed_contacts=()), Scene()), robot.bounds
    Q = np.repeat(robot.home[None], DRAWS, axis=0)
    Q[:, columns] = np.random.default_rng(0).uniform(lower[columns], upper[columns], (DRAWS, len(columns)))
    Q[0, columns], Q[1, columns] = lower[columns], upper[columns]
    deepest: tuple[Contact, str] | None = None
    for q in Q:
        for contact in checker.contacts(q):
            a, b = roots.get(contact.a), roots.get(contact.b)
            if a and b and a != b and contact.depth > (CROSSING if deepest is None else deepest[0].depth):
                deepest = contact, ", ".join(f"{robot.joint_names[k]}={q[k]:.3g}" for k in columns)
    return deepest


def _in_pieces(robot: Robot, links: Mapping[str, str]) -> Robot:
    """A robot whose meshes of these links are cut into convex pieces."""
    shapes = []
    for item in robot.shapes:
        cut = item.link in links and isinstance(item.shape, Mesh)
        pieces = pieces_of_mesh(item.shape) if cut and isinstance(item.shape, Mesh) else (item.shape,)
        shapes += [replace(item, shape=piece) for piece in pieces]
    return replace(robot, shapes=tuple(shapes))
