"""Moving pictures: how long they are, that they begin again, what is seen to move, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageSequence

from planner_service import Handling, InvalidRequest, PlannerService, PlanRequest, PlanResult, pick, top_grasps
from planner_service.files.writing import write_whole
from planner_service.view.still import moving
from planner_service.view.still.lettering import CAPTION
from planner_service.view.still.moving import draw_motions

Pixels = NDArray[np.uint8]


@pytest.fixture(autouse=True)
def _smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(moving, "SIZE", (320, 200))


@pytest.fixture(scope="module")
def planned() -> PlanResult:
    service = PlannerService("planar2", "discs")
    return service.plan(PlanRequest(service.robot.pose("lesson_start"), service.robot.pose("lesson_goal")))


def read(file: Path) -> tuple[list[Pixels], list[float]]:
    """The frames of a picture that begins again for ever, and the milliseconds of each."""
    frames, shown = [], []
    with Image.open(file) as picture:
        for frame in ImageSequence.Iterator(picture):
            frames.append(np.asarray(frame.convert("RGB")))
            shown.append(float(frame.info["duration"]))
        assert picture.info["loop"] == 0
    return frames, shown


def test_a_plan_takes_its_time_and_begins_again(planned: PlanResult, tmp_path: Path) -> None:
    file = tmp_path / "plan.webp"
    draw_motions([planned], file, speed=4.0)
    frames, shown = read(file)
    moves = planned.unwrap()[1].duration / 4.0
    assert math.isclose(sum(shown) / 1000, moves + moving.END, abs_tol=2 / moving.RATE)
    assert all((a != b).any() for a, b in pairwise(frames))


def test_a_gripper_is_seen_to_close_while_the_arm_stands(tmp_path: Path) -> None:
    service = PlannerService("wxai", "bin")
    grasps = top_grasps(service.robot, service.scene.obstacle("blue_block"))
    taken = pick(service, service.robot.home, "blue_block", grasps, Handling(support="bin_floor"))
    file = tmp_path / "pick.webp"
    draw_motions([taken], file, speed=10.0)
    _, shown = read(file)
    grips = sum(segment.gripper is not None for segment in taken.segments)
    assert grips == 2
    expected = taken.duration / 10.0 + grips * moving.GRIP + moving.END
    assert math.isclose(sum(shown) / 1000, expected, abs_tol=(len(taken.segments) + 2) / moving.RATE)


def test_the_camera_stands_still(planned: PlanResult, tmp_path: Path) -> None:
    file = tmp_path / "plan.webp"
    draw_motions([planned], file, speed=10.0)
    frames, _ = read(file)
    corner = [frame[: CAPTION // 4, : CAPTION // 4].astype(int) for frame in frames]
    assert max(np.abs(each - corner[0]).max() for each in corner) < 10  # sky, as far as the file keeps it


def test_what_has_no_motion_or_no_scene_is_refused(planned: PlanResult, tmp_path: Path) -> None:
    file = tmp_path / "plan.webp"
    service = PlannerService("planar2", "discs")
    beyond = service.robot.limits.upper + 1.0
    failed = service.plan(PlanRequest(service.robot.home, beyond))
    with pytest.raises(InvalidRequest, match=r"motions: .* plans and tasks that succeeded"):
        draw_motions([failed], file)
    with pytest.raises(InvalidRequest, match=r"motions: .* a plan that knows its scene"):
        draw_motions([replace(planned, origin=None)], file)
    with pytest.raises(InvalidRequest, match=r"motions: got '0 frames'; expected 1 to 1,000"):
        draw_motions([], file)
    with pytest.raises(InvalidRequest, match=r"speed: .*in \[0.1, 10\]"):
        draw_motions([planned], file, speed=0.0)
    assert not file.exists()


def test_a_file_of_another_kind_stays_as_it_is(planned: PlanResult, tmp_path: Path) -> None:
    file = tmp_path / "notes.webp"
    write_whole(file, b"notes", moving.OURS)
    with pytest.raises(Exception, match=r"notes\.webp"):
        draw_motions([planned], file, speed=10.0)
    assert file.read_bytes() == b"notes"
