"""The independent checker reads robots as their makers name things."""

from __future__ import annotations

from pathlib import Path

import pytest

from auditor.checker import IndependentChecker

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="post"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="slider"/>
  <link name="jaw"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <joint name="post" type="fixed"><parent link="base"/><child link="post"/></joint>
  <joint name="slide" type="prismatic"><parent link="post"/><child link="slider"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="1" velocity="1" effort="1"/></joint>
  <joint name="jaw" type="prismatic"><parent link="slider"/><child link="jaw"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>"""


@pytest.mark.parametrize("at", [0.0, 0.2, -0.2])
def test_a_joint_may_be_called_as_a_link_is_and_stand_still(tmp_path: Path, at: float) -> None:
    """The jaw's middle is at slide + at; it touches the post within 0.1 of it."""
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    told = {"urdf": file, "package_dirs": [], "joints": ["slide"], "locked_joints": {"jaw": at}, "tool_frame": "jaw"}
    checker = IndependentChecker(told, {})
    for slide in (0.0, 0.05, 0.15, 0.25, 0.35):
        assert checker.free([slide]) == (abs(slide + at) > 0.1)
        assert checker.tool_pose([slide])[0, 3] == pytest.approx(slide + at, abs=1e-12)
