"""Constraints as values: what they say, and what they refuse."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from planner_service import InvalidRequest, Pose
from planner_service.constraints import (
    InBox,
    JointRange,
    KeepOrientation,
    KeepUpright,
    OnLine,
    OnPlane,
    RelativePose,
    ToolRegion,
)

NAN, INF = math.nan, math.inf
WRONG: Any = 3


def test_what_makes_no_sense_is_refused_by_field() -> None:
    make: Any
    for make, field in [
        (lambda: KeepUpright((0.0, 0.0, 0.0), 0.1), "tool_axis"),
        (lambda: KeepUpright((0.0, 0.0, 1.0), 0.0), "tolerance"),
        (lambda: KeepUpright((0.0, 0.0, 1.0), 0.1, up=(NAN, 0.0, 1.0)), "up"),
        (lambda: KeepOrientation(WRONG, 0.1), "orientation"),
        (lambda: OnPlane(Pose(), 5e-5), "tolerance"),
        (lambda: OnPlane(Pose(), 0.001, point=(0.0, INF, 0.0)), "point"),
        (lambda: OnLine((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.001), "end"),
        (lambda: InBox(Pose(), (0.1, 0.1, -0.1)), "size[2]"),
        (lambda: RelativePose("a", WRONG, Pose(), 0.01, 0.1), "relative_to"),
        (lambda: ToolRegion(tilt=0.1, name="up\x1b[31m"), "name"),
        (lambda: JointRange("j" * 65, 0.0, 0.5), "joint"),
        (lambda: ToolRegion(), "upper"),
        (lambda: ToolRegion(lower=(0.0, 0.0, 1.0), upper=(1.0, 1.0, 0.0)), "upper[2]"),
        (lambda: ToolRegion(lower=(NAN, 0.0, 1.0)), "lower[0]"),
        (lambda: ToolRegion(turn=0.1), "tilt"),
        (lambda: ToolRegion(tilt=2.0, turn=0.1), "tilt"),
        (lambda: ToolRegion(frame=WRONG, tilt=0.1), "frame"),
        (lambda: ToolRegion(frame=Pose((0.0, 2e3, 0.0)), tilt=0.1), "position of frame"),
        (lambda: OnPlane(Pose(), 0.001, point=(1e308, 0.0, 0.0)), "position of tool"),
        (lambda: JointRange("joint_0", 0.5, 0.5), "upper"),
        (lambda: JointRange("joint_0", NAN, 0.5), "lower"),
    ]:
        with pytest.raises(InvalidRequest) as refused:
            make()
        assert refused.value.field == field


def test_a_short_form_is_the_region_that_it_stands_for() -> None:
    upright = KeepUpright((0.0, 0.0, 1.0), 0.1)
    region = ToolRegion(tilt=0.1, name="upright")
    assert (upright, hash(upright), repr(upright)) == (region, hash(region), repr(region))
    assert replace(upright, tilt=0.2) == KeepUpright((0.0, 0.0, 1.0), 0.2)
    assert type(RelativePose("a", "b", Pose(), 0.01, 0.1)) is ToolRegion
    match upright:
        case ToolRegion(name="upright", tilt=tilt):
            assert tilt == 0.1


def test_short_forms_mean_what_they_say() -> None:
    upright = KeepUpright((-2.0, 0.0, 0.0), 0.1)
    assert upright.tilt == 0.1
    assert upright.tool.rotation[:, 2] == pytest.approx([-1.0, 0.0, 0.0])
    line = OnLine((0.0, 0.0, 0.0), (0.0, 0.5, 0.0), 0.001)
    assert line.frame.rotation[:, 2] == pytest.approx([0.0, 1.0, 0.0])
    assert line.upper == (0.001, 0.001, 0.501)
    down = KeepUpright((0.0, 0.0, -1.0), 0.1)
    assert down.tool.rotation[:, 2] == pytest.approx([0.0, 0.0, -1.0])
