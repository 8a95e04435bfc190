"""Pictures of what a gate refused: where the arm was, where it comes to rest, and in red what would touch."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageSequence

from planner_service import InvalidRequest, PlannerService
from planner_service.gate import ActionGate, Kind, Tracking
from planner_service.gate.log import Logged
from planner_service.gate.log_reader import read_log
from planner_service.view.still import moving
from planner_service.view.still import pictures as still
from planner_service.view.still.lettering import CAPTION
from planner_service.view.still.moving import draw_refusals
from planner_service.view.still.pictures import draw_refusal, refusal_picture
from tests.support.optional import present
from tests.unit.certify.test_certifier import PLANAR, ball_beyond
from tests.unit.gate.test_action_gate import RATE, START, TRACKING, ramp

Pixels = NDArray[np.uint8]


@pytest.fixture(autouse=True)
def _smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(still, "SIZE", (640, 400))
    monkeypatch.setattr(moving, "SIZE", (320, 200))


def logged(folder: Path, *chunks: NDArray[np.float64], tracking: Tracking = TRACKING) -> tuple[Logged, ...]:
    """The log of a gate in front of a ball, whose arm stands still."""
    log = folder / "gate.jsonl"
    gate = ActionGate(PlannerService(PLANAR, ball_beyond(-0.05)), rate=RATE, tracking=tracking, log=log)
    for k, chunk in enumerate(chunks):
        gate.check(START, chunk, sent=0 if k else None)
    return read_log(log, 2)


def reds(picture: Pixels) -> int:
    r, g, b = (picture[:-CAPTION, :, k].astype(int) for k in range(3))
    return int(np.count_nonzero((r > 150) & (g < 120) & (b < 120)))


def test_a_refusal_for_its_stop_is_drawn_with_the_pair_that_would_touch_in_red(tmp_path: Path) -> None:
    (line,) = logged(tmp_path, ramp(90))
    assert present(line.refused).kind is Kind.STOP
    service, file = PlannerService(PLANAR, ball_beyond(-0.05)), tmp_path / "refused.png"
    draw_refusal(service, line, file)
    with Image.open(file) as image:
        drawn = np.asarray(image.convert("RGB"))
    other = replace(line, refused=replace(present(line.refused), pair=None))
    assert reds(drawn) > reds(refusal_picture(service, other)) + 100


def test_what_is_drawn_is_where_the_arm_was_and_where_it_comes_to_rest(tmp_path: Path) -> None:
    (line,) = logged(tmp_path, ramp(90))
    service = PlannerService(PLANAR, ball_beyond(-0.05))
    pictures = [refusal_picture(service, each) for each in (line, replace(line, q=()), replace(line, rest=()))]
    assert not np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])


def test_a_log_is_a_picture_that_moves_with_a_frame_for_each_line(tmp_path: Path) -> None:
    lines = logged(tmp_path, ramp(90), START + 0.5)
    file = tmp_path / "log.webp"
    draw_refusals(PlannerService(PLANAR, ball_beyond(-0.05)), lines, file)
    with Image.open(file) as picture:
        frames = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(picture)]
    assert len(lines) == len(frames) == 2
    assert not np.array_equal(frames[0], frames[1])


def test_lines_that_do_not_say_where_the_arm_was_cannot_be_drawn(tmp_path: Path) -> None:
    (line,) = logged(tmp_path, ramp(90))
    unknown = replace(line, q=(), rest=(), refused=replace(present(line.refused), at=()))
    service, file = PlannerService(PLANAR, ball_beyond(-0.05)), tmp_path / "log.webp"
    with pytest.raises(InvalidRequest, match="where the robot was"):
        draw_refusals(service, [unknown], file)
    with pytest.raises(InvalidRequest, match="where the robot was"):
        draw_refusal(service, unknown, tmp_path / "one.png")
    assert not file.exists()
