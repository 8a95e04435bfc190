"""Constraints as values: what they say, and what they refuse."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
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


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: KeepUpright((0.0, 0.0, 0.0), 0.1), "tool_axis"),
        (lambda: KeepUpright((0.0, 0.0), 0.1), "tool_axis"),
        (lambda: KeepUpright((0.0, 0.0, 1.0), 0.0), "tolerance"),
        (lambda: KeepUpright((0.0, 0.0, 1.0), 5.7), "tolerance"),
        (lambda: KeepUpright((0.0, 0.0, 1.0), NAN), "tolerance"),
        (lambda: KeepUpright((0.0, 0.0, 1.0), 0.1, up=(NAN, 0.0, 1.0)), "up"),
        (lambda: KeepUpright((0.0, 0.0, 1.0), 0.1, link=WRONG), "link"),
        (lambda: KeepOrientation(WRONG, 0.1), "orientation"),
        (lambda: KeepOrientation(Pose(), 2.0), "tolerance"),
        (lambda: OnPlane(Pose(), 5e-5), "tolerance"),
        (lambda: OnPlane(Pose(), 0.001, point=(0.0, INF, 0.0)), "point"),
        (lambda: OnLine((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.001), "end"),
        (lambda: InBox(Pose(), (0.1, 0.1, 1e-4)), "size[2]"),
        (lambda: InBox(Pose(), (0.1, 0.1, -0.1)), "size[2]"),
        (lambda: InBox(Pose(), WRONG), "size"),
        (lambda: RelativePose("a", WRONG, Pose(), 0.01, 0.1), "relative_to"),
        (lambda: RelativePose("a", "b", Pose(), 0.01, 0.0), "angle_tolerance"),
        (lambda: ToolRegion(), "upper"),
        (lambda: ToolRegion(lower=(0.0, 0.0, 1.0), upper=(1.0, 1.0, 0.0)), "upper[2]"),
        (lambda: ToolRegion(lower=(NAN, 0.0, 1.0)), "lower[0]"),
        (lambda: ToolRegion(lower=(2e3, 0.0, 1.0)), "lower"),
        (lambda: ToolRegion(turn=0.1), "tilt"),
        (lambda: ToolRegion(tilt=2.0, turn=0.1), "tilt"),
        (lambda: ToolRegion(frame=WRONG, tilt=0.1), "frame"),
        (lambda: JointRange("joint_0", 0.5, 0.5), "upper"),
        (lambda: JointRange("joint_0", NAN, 0.5), "lower"),
        (lambda: JointRange(WRONG, 0.0, 0.5), "joint"),
    ],
)
def test_what_makes_no_sense_is_refused_by_field(make: Callable[[], Any], field: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        make()
    assert refused.value.field == field


def test_short_forms_are_regions_and_survive_pickling() -> None:
    upright = KeepUpright((-2.0, 0.0, 0.0), 0.1)
    assert upright.tilt == 0.1
    assert upright.tool.rotation[:, 2] == pytest.approx([-1.0, 0.0, 0.0])
    assert pickle.loads(pickle.dumps(upright)) == upright
    line = OnLine((0.0, 0.0, 0.0), (0.0, 0.5, 0.0), 0.001)
    assert line.frame.rotation[:, 2] == pytest.approx([0.0, 1.0, 0.0])
    assert line.upper == (0.001, 0.001, 0.501)
    down = KeepUpright((0.0, 0.0, -1.0), 0.1)
    assert down.tool.rotation[:, 2] == pytest.approx([0.0, 0.0, -1.0])
