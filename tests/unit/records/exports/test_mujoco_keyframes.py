"""Keyframes, read back by mujoco."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from planner_service.planning.request import PlanRequest
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import Segment
from planner_service.records.evidence import save_plan
from planner_service.records.exports.mujoco_keyframes import keyframes_text
from planner_service.service import PlannerService
from tests.support.command import run

SERVICE = PlannerService("planar2", "empty")
NAMES = SERVICE.robot.joint_names

MODEL = """<mujoco>
  {include}
  <worldbody>
    <body name="loose" pos="2 0 0.5"><freejoint name="floats"/><geom size="0.1"/></body>
    <body name="forearm"><joint name="elbow" axis="0 0 1"/><geom size="0.1"/>
      <body name="finger"><joint name="finger" type="slide" ref="0.25"/><geom size="0.1"/></body>
    </body>
    <body name="upper"><joint name="shoulder" axis="0 0 1"/><geom size="0.1"/></body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def motion() -> PlanResult:
    return SERVICE.plan(PlanRequest((0.0, 0.0), (0.3, -0.4)))


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "model.xml"
    path.write_text(MODEL.format(include=""))
    return path


def compiled(model: Path, keys: str) -> Any:
    (model.parent / "keys.xml").write_text(keys)
    whole = model.with_name("whole.xml")
    whole.write_text(MODEL.format(include='<include file="keys.xml"/>'))
    return mujoco.MjModel.from_xml_path(str(whole))


def test_a_model_that_includes_the_keyframes_has_the_motions_bits(motion: PlanResult, model: Path) -> None:
    back = SERVICE.plan(PlanRequest((0.3, -0.4), (0.0, 0.0)))
    segments = [Segment('there & "back"', motion, 0.0), Segment("back", back, 0.0)]
    found = compiled(model, keyframes_text(segments, NAMES, 0.05, model=model))
    (t, q, qd, _), (t_back, q_back, qd_back, _) = (plan.unwrap()[1].sample(0.05) for plan in (motion, back))
    arm = [found.joint(name).qposadr[0] for name in NAMES]
    turn = [found.joint(name).dofadr[0] for name in NAMES]
    assert found.key_time.tolist() == [*t, *(t[-1] + t_back)]
    assert np.array_equal(found.key_qpos[:, arm], [*q, *q_back])
    assert np.array_equal(found.key_qvel[:, turn], [*qd, *qd_back])
    rest = np.setdiff1d(np.arange(found.nq), arm)
    assert (found.key_qpos[:, rest] == found.qpos0[rest]).all()
    assert found.key(0).name == '0 there & "back"'


def test_export_writes_keyframes_for_a_model_and_asks_for_it(motion: PlanResult, model: Path, tmp_path: Path) -> None:
    save_plan(motion, tmp_path / "plan.json")
    arguments = ("export", tmp_path / "plan.json", "--dt", "0.05")
    for _ in range(2):  # the second time over the first
        done = run(*arguments, "--format", "mujoco", "--model", model, "--out", tmp_path / "keys.xml")
        assert (done.exit_code, done.stdout) == (0, "")
    written = (tmp_path / "keys.xml").read_text()
    assert written == keyframes_text([Segment("plan", motion, 0.0)], NAMES, 0.05, model=model)
    for wrong in (("--format", "mujoco"), ("--format", "csv", "--model", model)):
        refused = run(*arguments, *wrong)
        assert refused.exit_code == 2
        assert "expected an MJCF file with format mujoco, and none with another format" in refused.stderr
