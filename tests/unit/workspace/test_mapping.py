"""Reachability maps: a planar arm has a closed form, and brute force contradicts nothing of the WidowX AI's."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner_service import CollisionChecker, Pose, Robot, Scene, inverse_kinematics, load_robot, load_scene
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.workspace import (
    ReachabilityMap,
    ToolOrientation,
    VoxelGrid,
    VoxelVerdict,
    load_map,
    prove_again,
    reachability,
    save_map,
)

ANY = ToolOrientation(tolerance=math.pi)
DOWN = (0.5**0.5, 0.0, 0.5**0.5, 0.0)
AROUND = VoxelGrid((-0.6, -0.6, -0.05), (0.6, 0.6, 0.55), (20, 20, 20))


@pytest.fixture(scope="module")
def wxai() -> Robot:
    return load_robot("wxai")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("bin")


@pytest.fixture(scope="module")
def found(wxai: Robot, scene: Scene) -> ReachabilityMap:
    return reachability(wxai, scene, AROUND, [ToolOrientation(DOWN)])


def test_a_planar_arm_reaches_the_voxels_that_its_annulus_meets() -> None:
    arm = load_robot("planar2")
    near, far, height = _annulus(arm)
    grid = VoxelGrid((-1.3 * far, -1.3 * far, height - 0.01), (1.3 * far, 1.3 * far, height + 0.01), (24, 24, 1))
    found = reachability(arm, Scene(), grid, [ANY], halvings=3)
    cells = np.argwhere(np.ones(grid.counts, dtype=bool))
    least, most = _distances(np.abs(grid.centres(cells)[:, :2]), grid.half[:2])
    verdicts = found.verdicts[0][tuple(cells.T)]
    assert not np.any((verdicts == VoxelVerdict.REACHABLE) & ((least > far + 1e-9) | (most < near - 1e-9)))
    out = verdicts == VoxelVerdict.OUT_OF_REACH
    assert not np.any(out & (least < far) & (most > near) & ((least > near) | (most < far)))
    assert out[(least > 1.1 * far) | (most < 0.9 * near)].all()


def _annulus(arm: Robot) -> tuple[float, float, float]:
    """The least and the largest distance of the tool from the base's axis, within the limits, and its height."""
    straight, folded = (arm.tool_pose([0.0, bend])[:3, 3] for bend in (0.0, float(arm.limits.upper[1])))
    return math.hypot(*folded[:2]), math.hypot(*straight[:2]), float(straight[2])


def _distances(centres: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    least = np.maximum(centres - half, 0.0)
    return np.hypot(*least.T), np.hypot(*(centres + half).T)


def test_every_witness_is_one(wxai: Robot, scene: Scene, found: ReachabilityMap) -> None:
    judge = CollisionChecker(wxai, scene, backend="fcl")
    cells = np.argwhere(found.verdicts[0] == VoxelVerdict.REACHABLE)
    assert len(cells) > 300
    for centre in AROUND.centres(cells):
        q = found.witness(centre)
        assert q is not None
        assert np.all(np.abs(wxai.tool_pose(q)[:3, 3] - centre) <= AROUND.half)
        assert np.abs(wxai.tool_pose(q)[:3, :3] - ToolOrientation(DOWN).rotation).max() < 1e-8
    assert judge.states_are_free(found.witnesses).all()


def test_what_is_proven_is_not_contradicted_by_solutions_in_closed_form(
    wxai: Robot, scene: Scene, found: ReachabilityMap
) -> None:
    checker, rng = CollisionChecker(wxai, scene), np.random.default_rng(3)
    for kind in (VoxelVerdict.OUT_OF_REACH, VoxelVerdict.BLOCKED):
        cells = np.argwhere(found.verdicts[0] == kind)
        near = cells[np.abs(AROUND.centres(cells)).max(axis=1) < 0.4]
        for cell in rng.permutation(near)[:150]:
            for _ in range(10):
                x, y, z = (AROUND.centres(cell[None])[0] + rng.uniform(-1.0, 1.0, 3) * AROUND.half).tolist()
                Q = inverse_kinematics(wxai, Pose((x, y, z), DOWN))
                assert not (len(Q) if kind is VoxelVerdict.OUT_OF_REACH else any(map(checker.state_is_free, Q)))
    assert found.share(VoxelVerdict.BLOCKED) > 0.03
    assert found.share(VoxelVerdict.UNKNOWN) < 0.06


def test_workers_and_interruptions_change_nothing(wxai: Robot, scene: Scene, found: ReachabilityMap) -> None:
    begun = reachability(wxai, scene, AROUND, found.orientations, time_limit=0.0)
    assert not begun.complete
    assert begun.share(VoxelVerdict.UNKNOWN) == 1.0
    calls: list[tuple[int, int]] = []
    again = reachability(
        wxai, scene, AROUND, found.orientations, workers=2, resume=begun, progress=lambda *counts: calls.append(counts)
    )
    assert [made for made, _ in calls] == list(range(1, found.done.size + 1))
    assert np.array_equal(again.verdicts, found.verdicts)
    assert np.array_equal(again.witnesses, found.witnesses)


def test_proofs_of_a_file_are_proven_here_before_they_count(
    wxai: Robot, scene: Scene, found: ReachabilityMap, tmp_path: Path
) -> None:
    save_map(found, tmp_path / "map.npz")
    loaded = load_map(tmp_path / "map.npz", wxai, scene)
    proven = found.share(VoxelVerdict.OUT_OF_REACH) + found.share(VoxelVerdict.BLOCKED)
    assert loaded.share(VoxelVerdict.SAID_UNREACHABLE) == pytest.approx(proven)
    assert np.array_equal(load_map(tmp_path / "map.npz", wxai, scene, trusted=True).verdicts, found.verdicts)
    forged = loaded.verdicts.copy()
    forged[forged == VoxelVerdict.UNKNOWN] = VoxelVerdict.SAID_UNREACHABLE
    assert np.array_equal(prove_again(replace(loaded, verdicts=forged), wxai, scene).verdicts, found.verdicts)


def test_a_forged_witness_is_refused(wxai: Robot, scene: Scene, found: ReachabilityMap, tmp_path: Path) -> None:
    for k, shift in ((0, 0.3), (5, 1e-3)):
        moved = found.witnesses.copy()
        moved[k, 0] += shift
        save_map(replace(found, witnesses=moved), tmp_path / "map.npz")
        with pytest.raises(InvalidFile, match=rf"witnesses\[{k}\]"):
            load_map(tmp_path / "map.npz", wxai, scene, trusted=True)


def test_a_map_of_another_scene_is_refused(wxai: Robot, found: ReachabilityMap, tmp_path: Path) -> None:
    save_map(found, tmp_path / "map.npz")
    with pytest.raises(InvalidFile, match="the scene of the map"):
        load_map(tmp_path / "map.npz", wxai, Scene())
    with pytest.raises(InvalidRequest, match="a map of the same scene"):
        reachability(wxai, Scene(), AROUND, found.orientations, resume=found)


def test_arms_with_too_many_joints_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="lock some"):
        reachability(load_robot("panda"), Scene(), AROUND, [ANY])


def test_a_locked_arm_of_seven_joints_has_a_map() -> None:
    panda = load_robot("panda")
    arm = panda.locked({panda.joint_names[2]: 0.0})
    grid = VoxelGrid((0.2, -0.2, 0.1), (1.2, 0.2, 0.5), (10, 4, 4))
    found = reachability(arm, Scene(), grid, [ToolOrientation((0.0, 1.0, 0.0, 0.0))])
    assert found.share(VoxelVerdict.REACHABLE) > 0.2
    assert found.share(VoxelVerdict.OUT_OF_REACH) > 0.2
    assert found.verdict((1.19, 0.0, 0.45)) is VoxelVerdict.OUT_OF_REACH
    assert found.verdict((0.45, 0.0, 0.3)) is VoxelVerdict.REACHABLE
