"""The page of a gate shows what it decided last, and asks the gate for nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.gate import ActionGate, Kind
from planner_service.geometry.arrays import FloatArray
from planner_service.scene.scene import Scene
from planner_service.view import GateViewer, watch
from tests.support.chromium import executable, headless, new_window, pixels
from tests.support.optional import present
from tests.unit.certify.test_certifier import ball_beyond
from tests.unit.gate.test_action_gate import START, gate_of, ramp


@pytest.fixture
def gate() -> ActionGate:
    return gate_of(ball_beyond(-0.05))


@pytest.fixture
def viewer(gate: ActionGate) -> Iterator[GateViewer]:
    with watch(gate, port=0) as found:
        yield found


def test_nothing_is_shown_before_the_first_check_and_after_a_reset(gate: ActionGate, viewer: GateViewer) -> None:
    page = viewer.page
    page.draw()
    before = page.shown
    gate.check(START, ramp(20))
    page.draw()
    after = page.shown
    gate.reset()
    page.draw()
    assert (before, page.shown) == (None, None)
    assert after is not None


def test_the_last_decision_is_shown_with_its_margin_and_the_last_refusal_stays(
    gate: ActionGate, viewer: GateViewer
) -> None:
    refused = present(gate.check(START, ramp(90)).refused)
    viewer.page.draw()
    gate.check(START, START, sent=0)
    viewer.page.draw()
    assert viewer.page.shown is gate.decision
    assert viewer.page.refusal is refused
    assert viewer.page.margin > 0.0


def test_a_changed_scene_and_an_arm_that_is_lost_are_shown(gate: ActionGate, viewer: GateViewer) -> None:
    gate.check(START, ramp(20))
    gate.update(Scene(), sent=3)
    viewer.page.draw()
    free = viewer.page.margin
    gate.check(START + np.array([np.nan, 1.0]), ramp(3), sent=0)
    viewer.page.draw()
    assert (present(viewer.page.refusal).kind, viewer.page.margin) == (Kind.TRACKING, 0.0)
    assert free > 0.0


def test_a_page_that_is_closed_draws_no_more_and_the_gate_goes_on(gate: ActionGate) -> None:
    with watch(gate, port=0) as viewer:
        page = viewer.page
    gate.check(START, ramp(20))
    page.draw()
    assert (page.shown, viewer.open) == (None, False)


def test_only_a_gate_is_watched() -> None:
    with pytest.raises(InvalidRequest, match=r"gate: .*an ActionGate"):
        watch(START, port=0)  # type: ignore[arg-type]


def until(holds: Callable[[], Any]) -> None:
    end = time.monotonic() + 90.0
    while not holds():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.2)


def reds(window: Any) -> int:
    r, g, b = (pixels(window)[190:, :400, k].astype(int) for k in range(3))
    return int(np.count_nonzero((r > 150) & (g < 130) & (b < 130)))


@pytest.mark.browser
@pytest.mark.slow
@pytest.mark.skipif(executable() is None, reason="no Chromium; set PLANNER_SERVICE_CHROMIUM to the path of one")
def test_a_window_shows_the_refusal_in_red_for_a_while_and_says_its_pair_and_depth(
    gate: ActionGate, viewer: GateViewer
) -> None:
    def waiting(q: FloatArray) -> None:
        gate.check(START, q, sent=0 if gate.decision else None)

    with headless() as browser:
        window = new_window(browser, viewport={"width": 800, "height": 500})
        window.goto(viewer.url)
        window.get_by_text("no check yet").first.wait_for()
        waiting(START)
        window.get_by_text("margin of the tube").first.wait_for()
        none = reds(window)

        def red_after_a_refusal() -> bool:  # each anew: a busy machine may draw none while one is shown
            waiting(ramp(90))
            return reds(window) > none + 100

        until(red_after_a_refusal)
        window.get_by_text("could touch").or_(window.get_by_text("would overlap")).first.wait_for()
        until(lambda: reds(window) <= none)
