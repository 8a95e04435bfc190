"""Constraint files give the constraints that they describe, and say everything that is wrong."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from planner_service import InvalidFile, Pose
from planner_service.constraints import JointRange, ToolRegion, load_constraints

INF = math.inf

GOOD = """
[[constraint]]
kind = "tool region"
name = "over the board"
frame = { position = [0.3, 0, 0.2], quaternion_wxyz = [0.8, 0.0, 0.36, 0.48] }
lower = [-inf, -0.1, 0.05]
upper = [inf, 0.1, inf]
tilt = 0.1
turn = 0.2
tool = { position = [0.05, 0.0, 0.0] }
link = "link_6"
relative_to = "link_2"

[[constraint]]
kind = "tool region"
tilt = 1

[[constraint]]
kind = "joint range"
joint = "joint_4"
lower = -1
upper = 1.5
"""


REGION = "[[constraint]]\nkind = 'tool region'"
RANGE = "[[constraint]]\nkind = 'joint range'\n"


def load(text: str, folder: Path) -> object:
    (folder / "region.toml").write_text(text)
    return load_constraints(folder / "region.toml")


def test_a_file_gives_the_constraints_that_it_describes(tmp_path: Path) -> None:
    frame, tool = Pose((0.3, 0.0, 0.2), (0.8, 0.0, 0.36, 0.48)), Pose((0.05, 0.0, 0.0))
    bounds = (-INF, -0.1, 0.05), (INF, 0.1, INF)
    region = ToolRegion(frame, *bounds, 0.1, 0.2, tool, "link_6", "link_2", "over the board")
    assert load(GOOD, tmp_path) == (region, ToolRegion(tilt=1.0), JointRange("joint_4", -1.0, 1.5))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "constraint: missing; expected tables, each headed [[constraint]]"),
        ("[[constraint]]\ntilt = 0.1", "constraint[0].kind: missing"),
        (
            "[[constraint]]\nkind = 'cone'",
            "constraint[0].kind: got 'cone'; expected one of 'tool region', 'joint range'",
        ),
        (REGION + "\ntillt = 1.0", "unknown key 'tillt'; did you mean 'tilt'?"),
        (
            REGION + "\ntilt = 4.0",
            "constraint[0].tilt: got 4.0; expected radians in [0.001, pi]",
        ),
        (
            REGION,
            "upper: got (inf, inf, inf); expected a bound on a coordinate, or a tilt",
        ),
        (
            REGION + "\ntilt = 1.0\nframe = { quaternion_wxyz = [1, 1, 0, 0] }",
            "constraint[0].frame: quaternion: got (1.0, 1.0, 0.0, 0.0); expected a unit quaternion",
        ),
        (RANGE + "joint = 'a'\nlower = 1.0", "constraint[0].upper: missing"),
        (GOOD * 6, "at most 16 entries; there are 18"),
    ],
)
def test_what_is_wrong_is_named_with_its_table_and_key(text: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidFile) as caught:
        load(text, tmp_path)
    assert "region.toml" in str(caught.value)
    assert problem in "\n".join(caught.value.problems)


def test_every_problem_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile) as caught:
        load(GOOD.replace("0.2\n", "'a'\n").replace("upper = 1.5", "upper = -3"), tmp_path)
    assert len(caught.value.problems) == 2
