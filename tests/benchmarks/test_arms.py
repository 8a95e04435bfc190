"""The study of four arms: which it plans for, and what it refuses."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import planner_service as ps
from benchmarks.harness.suite import PUBLIC
from benchmarks.studies.arms import arms_in, motions_of, run


def test_the_panda_is_here_and_the_others_are_those_of_the_folder(tmp_path: Path) -> None:
    assert [arm.name for arm in arms_in(None, None)] == ["panda"]
    shutil.copy(PUBLIC, tmp_path / "mbm_fetch_sample.json")
    assert [arm.name for arm in arms_in(tmp_path, None)] == ["panda"]
    (tmp_path / "mbm_robots/fetch").mkdir(parents=True)
    (tmp_path / "mbm_robots/fetch/fetch.urdf").touch()
    assert [arm.name for arm in arms_in(tmp_path, None)] == ["panda", "fetch"]
    assert [arm.name for arm in arms_in(tmp_path, "fetch")] == ["fetch"]


def test_an_arm_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ps.InvalidRequest, match=r"--problems: .* a folder with the problems and the robot of ur5"):
        arms_in(tmp_path, "ur5")
    with pytest.raises(ps.UnknownName, match="kuka"):
        arms_in(tmp_path, "kuka")
    with pytest.raises(ps.InvalidRequest, match="--seeds"):
        run(seeds=0)


def test_ends_are_in_the_order_of_the_robots_joints() -> None:
    arm = arms_in(None, "panda")[0]
    robot = ps.load_robot(arm.source)
    motion = next(motions_of(arm, robot))
    assert motion.start.shape == motion.goals[0].shape == (robot.n,)
    assert motion.start.tolist() == [0, -0.785, 0, -2.356, 0, 1.571, 0.785]
