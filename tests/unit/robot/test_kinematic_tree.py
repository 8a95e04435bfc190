"""Poses of bodies have the bits of their reference, whatever axes, mimics and branches a robot has."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.robot.kinematic_tree import Body, BodyTree
from tests.reference.poses import poses

SEEDS = range(6)


def drawn(seed: int) -> tuple[BodyTree, np.random.Generator]:
    """A tree of seven joints, some of them sliding, oblique or mimics, and the generator for its configurations."""
    rng = np.random.default_rng(seed)
    bodies = [Body("base", -1, np.eye(4), np.zeros(3), False, -1)]
    for k in range(7):
        T = np.eye(4)
        if rng.random() < 0.7:
            Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
            T[:3, :3] = Q * np.linalg.det(Q)
        T[:3, 3] = rng.normal(size=3)
        axis = rng.normal(size=3)
        axis = (
            axis / np.linalg.norm(axis) if rng.random() < 0.5 else np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
        )
        multiplier = 1.0 if rng.random() < 0.7 else float(rng.normal())
        entry = 4 if k == 6 else int(rng.integers(5))
        bodies.append(Body(f"j{k}", int(rng.integers(k + 1)), T, axis, bool(rng.random() < 0.3), entry, multiplier))
    return BodyTree(bodies), rng


@pytest.mark.parametrize("seed", SEEDS)
def test_poses_have_the_bits_of_the_reference_alone_and_in_a_batch(seed: int) -> None:
    tree, rng = drawn(seed)
    Q = np.concatenate([np.zeros((1, 5)), rng.uniform(-7.0, 7.0, (9, 5)), rng.uniform(-700.0, 700.0, (2, 5))])
    R, p = tree.poses_batch(Q)
    for k, q in enumerate(Q.tolist()):
        expected = [
            (*rotation[0], *rotation[1], *rotation[2], *position) for rotation, position in poses(tree.table, q)
        ]
        assert tree.poses(q) == expected
        assert R[k].reshape(-1, 9).tolist() == [list(pose[:9]) for pose in expected]
        assert p[k].tolist() == [list(pose[9:]) for pose in expected]
