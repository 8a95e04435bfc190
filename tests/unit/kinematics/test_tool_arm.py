"""What compiled arms refuse, and that each is made once."""

from __future__ import annotations

import pytest

from planner_service import Robot
from planner_service.kinematics.tool_arm import tool_arm


def test_a_robot_is_turned_into_compiled_form_once(wxai: Robot) -> None:
    assert tool_arm(wxai) is tool_arm(wxai)


@pytest.mark.parametrize("points", [0, 1])
def test_a_line_of_fewer_than_two_points_is_refused(points: int, wxai: Robot) -> None:
    pose = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    with pytest.raises(ValueError, match="at least two points"):
        tool_arm(wxai).walk(pose, pose, wxai.home, points)
