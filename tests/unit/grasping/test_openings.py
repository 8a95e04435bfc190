"""How wide a gripper opens: the usual room first, then less, never less than the object nor more than the gripper."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service import load_robot, load_scene
from planner_service.errors import InvalidRequest
from planner_service.grasping.openings import FINGER_ROOMS, opened, openings, tells_of_fingers
from planner_service.scene.names import Names
from tests.support.optional import present

GRIPPERS = {name: present(load_robot(name).gripper) for name in ("wxai", "kinova_gripper", "ur5_vacuum")}


@given(st.sampled_from(["wxai", "kinova_gripper"]), st.floats(0.0, 0.13))
@settings(max_examples=60, deadline=None)
def test_openings_get_smaller_and_hold_the_object_with_room_as_far_as_the_gripper_opens(
    name: str, width: float
) -> None:
    gripper = GRIPPERS[name]
    if width > gripper.upper:
        with pytest.raises(InvalidRequest, match=r"target: got '.* m wide'; expected an object at most"):
            openings(gripper, width)
        return
    widths = openings(gripper, width)
    assert widths == tuple(sorted(set(widths), reverse=True))
    assert widths[0] == min(gripper.upper, width + 0.024)
    assert all(width <= each <= gripper.upper for each in widths)
    assert widths[-1] == min(gripper.upper, width + 2 * FINGER_ROOMS[-1])


def test_a_wanted_opening_is_the_only_one_and_holds_the_object() -> None:
    assert openings(GRIPPERS["wxai"], 0.04, 0.05) == (0.05,)
    with pytest.raises(InvalidRequest, match=r"open_width: got 0\.03; expected at least the object.s width, 0\.0400 m"):
        openings(GRIPPERS["wxai"], 0.04, 0.03)


def test_a_cup_refuses_a_wanted_opening() -> None:
    with pytest.raises(InvalidRequest, match=r"open_width: got 0\.04; expected None: a cup does not open"):
        openings(GRIPPERS["ur5_vacuum"], 0.0, 0.04)


def test_a_cup_has_one_opening_and_no_words_for_it() -> None:
    cup = GRIPPERS["ur5_vacuum"]
    assert openings(cup, 0.0) == (0.0,)
    assert opened(cup, 0.0) == ""
    assert opened(GRIPPERS["wxai"], 0.0691) == "gripper 69.1 mm open"


@pytest.mark.parametrize(
    ("reason", "told"),
    [
        ("way 1: finger_left x other_1 touch", True),
        ("descend: straight line blocked at 50%: finger_right x other (1.2 mm)", True),
        ("the gripper cannot open from 45.0 to 69.0 mm: other x finger_left at a width of 50.0 mm", True),
        ("way 2: finger_left would stand 3.0 mm inside block", True),
        ("way 1: link_6 x other touch", False),
        ("way 1: finger_left_cover x other touch", False),
        ("out of reach", False),
    ],
)
def test_reasons_about_fingers_are_known_by_the_names_of_the_fingers(reason: str, told: bool) -> None:
    names = Names(load_robot("wxai"), load_scene("table"))
    assert tells_of_fingers(reason, ("finger_left", "finger_right"), names) is told
    assert not tells_of_fingers(reason, (), names)
