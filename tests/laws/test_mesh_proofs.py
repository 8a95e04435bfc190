"""Proofs with hulls: how far their corners move, what is certified, and what faults cannot reach."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.certify import MARGIN, Certifier, separation
from planner_service.certify import motion_bounds as motion
from planner_service.certify.hulls import Corners
from planner_service.certify.motion_bounds import Motion
from planner_service.certify.pairs import ProofPairs
from planner_service.collision import backends as backends
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Shape
from planner_service.path.joint_path import JointPath
from tests.laws.test_certify_laws import COAL, anywhere, samples, walks
from tests.laws.test_collision_laws import near_contact
from tests.laws.test_mesh_laws import blunt, loose, uncentred
from tests.reference.pair_proof import nearest
from tests.support.hull_arm import HELD, NEEDLE, HullSetup

seeds = st.integers(0, 2**32 - 1)


@settings(deadline=None, max_examples=20)
@given(seed=seeds)
def test_no_corner_moves_farther_than_reach_and_motion_bounds_say(folder: Path, seed: int) -> None:
    setup = HullSetup("moving", folder, attached=(HELD, NEEDLE))
    robot, rng = setup.robot(), np.random.default_rng(seed)
    listed = ProofPairs(robot, setup.whole_scene(), ())
    moves = Motion(robot, listed)
    q = anywhere(robot, rng, 1)[0]
    path = JointPath(np.array([q, q + (anywhere(robot, rng, 1)[0] - q) * rng.choice([0.01, 0.2, 1.0])]))
    _, radii = moves.nodes(path([0.0, path.length]))
    travel = path.travel([path.length])
    bound = moves.motions(radii[:1], radii[1:], travel)[:, 0]
    reach = np.array(setup.checker()._reach)
    R, t = robot.body_poses_batch(path(np.linspace(0.0, path.length, 150)))
    for k, piece in enumerate(listed.riding):
        if isinstance(piece.shape, Mesh):
            frame = np.array(piece.frame)
            corners = piece.shape.vertices @ frame[:, :3].T + frame[:, 3]
            world = np.einsum("mij,pj->mpi", R[:, piece.body], corners) + t[:, piece.body, None]
            way = np.sqrt((np.diff(world, axis=0) ** 2).sum(axis=-1)).sum(axis=0).max()
            assert way <= bound[piece.body, k] + 1e-12  # body k is moved by k joints
            assert way <= (reach * travel[0]).sum() + 1e-12


# certificates


def judged(setup: HullSetup, count: int, seed: int) -> Iterator[tuple[bool, str]]:
    """Of ``count`` walks whether each is certified, and what the reference says against that."""
    robot, second = setup.robot(), setup.independent()
    certifier = Certifier(robot, setup.whole_scene())
    for path in walks(robot, second, np.random.default_rng(seed), count):
        found, (low, high), wrong = certifier.certify(path), nearest(second, path), ""
        if found.certified and found.clearance > high + COAL:
            wrong = f"{found.clearance} proven, {high} found"
        elif not found.certified and low > MARGIN:
            wrong = f"refused at {low}"
        yield found.certified, wrong


def test_a_certified_path_of_hulls_touches_nothing_and_a_free_one_is_certified(setup: HullSetup) -> None:
    found = list(judged(setup, 8, seed=14))
    assert {wrong for _, wrong in found} == {""}
    assert 2 <= sum(certified for certified, _ in found) <= 7


def uncentred_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motion, "centre_of", lambda shape: (0.0, 0.0, 0.0))


def symmetric_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hull's support value along n is taken for that along -n."""
    whole, clouds = Corners.extended, Corners.clouds
    monkeypatch.setattr(Corners, "extended", lambda corners, n, found: whole(corners, -n, found))
    monkeypatch.setattr(Corners, "clouds", lambda corners: [-cloud for cloud in clouds(corners)])


def shrunk_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = separation._corners

    def smaller(shape: Shape) -> Any:
        corners = whole(shape)
        return None if corners is None else 0.9 * corners

    monkeypatch.setattr(separation, "_corners", smaller)
    monkeypatch.setattr(separation, "_solids", separation._solids.__wrapped__)  # none that were right are kept


@pytest.mark.parametrize("fault", [uncentred_proof, symmetric_proof, shrunk_proof])
def test_the_reference_notices_a_fault_in_the_proof(
    folder: Path, fault: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    fault(monkeypatch)
    assert any(wrong for _, wrong in judged(HullSetup("faulty", folder, attached=(HELD,)), 12, seed=14))


@pytest.mark.parametrize("fault", [uncentred, loose, blunt])
def test_a_fault_of_the_search_with_hulls_does_not_reach_the_proof(
    folder: Path, fault: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = HullSetup("fooled", folder, attached=(HELD,))
    robot, scene, sound = setup.robot(), setup.whole_scene(), setup.checker()
    rng, edges = np.random.default_rng(15), []
    for q in near_contact(robot, sound.state_is_free, rng, 200):
        edge = np.clip([q, q + rng.normal(size=4) * 0.02], robot.limits.lower, robot.limits.upper)
        if not sound.edge_is_free(*edge):
            edges.append(edge)
    fault(monkeypatch)
    faulty = setup.checker()
    fooled = [edge for edge in edges if faulty._first_collision(samples(JointPath(edge), robot.reach(), 0.002)) is None]
    assert len(fooled) >= 3
    certifier = Certifier(robot, scene)
    assert [certifier.certify(JointPath(edge)).certified for edge in fooled] == [False] * len(fooled)
    assert [certifier.certify_edge(*edge).free for edge in fooled] == [False] * len(fooled)


def test_compiled_code_says_with_equal_bits_how_far_hulls_extend() -> None:
    rng = np.random.default_rng(3)
    clouds = [rng.normal(size=(3, count)) for count in (4, 8, 9, 57)]
    every = [clouds[0], None, *clouds[1:], clouds[1]]
    corners, n, expected = Corners.of(every), rng.normal(size=(5, 3, 6)), np.full((5, 6), -7.0)
    assert corners is not None
    for k, cloud in enumerate(every):
        if cloud is not None:
            x, y, z = n[:, :, k].T[:, :, None]
            expected[:, k] = (x * cloud[0] + y * cloud[1] + z * cloud[2]).max(axis=1)
    assert corners.extended(n, np.full((5, 6), -7.0)).tobytes() == expected.tobytes()
