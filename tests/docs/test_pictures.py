"""Pictures that no page draws itself are those of today's plans.

``WRITE_OUTPUTS=1`` in the environment draws them anew.
"""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from PIL import Image, ImageSequence

from planner_service import PlanResult, TaskResult
from planner_service.view.still.moving import draw_motions
from tests.docs.test_docs import DOCS, IMAGES, assert_is_shown
from tests.support.command import run

MOVING = IMAGES / "palletising.webp"
SPEED = 2.0
"""Seconds of motion in one of the picture; the pages say so."""


def test_a_picture_is_what_its_command_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = (DOCS / "guides" / "pictures.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"^ +planner-service (plan .*)$", page, re.MULTILINE)
    assert run(*shlex.split(command)).exit_code == 0
    (drawn,) = tmp_path.glob("*.png")
    assert_is_shown(drawn)


@pytest.mark.slow
def test_the_moving_picture_is_of_the_second_layer_of_the_pallet(capsys: pytest.CaptureFixture[str]) -> None:
    page = (DOCS / "guides" / "palletising.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    for code in re.findall(r"^```python\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE)[:2]:
        exec(compile(code, "palletising.md", "exec"), names)
    motions: list[TaskResult | PlanResult] = names["tasks"][-9:]
    if "WRITE_OUTPUTS" in os.environ:
        draw_motions(motions, MOVING, speed=SPEED)
    assert len(capsys.readouterr().out.splitlines()) == 8
    results = [s.result for task in motions if isinstance(task, TaskResult) for s in task.segments]
    results += [plan for plan in motions if isinstance(plan, PlanResult)]
    moving = sum(result.unwrap()[1].duration for result in results)
    with Image.open(MOVING) as picture:
        shown = sum(frame.convert("L").info["duration"] / 1000 for frame in ImageSequence.Iterator(picture))
        assert picture.info["loop"] == 0  # for ever
    assert MOVING.stat().st_size < 1_000_000
    assert shown == pytest.approx(moving / SPEED + 8 * 0.3 + 1.5, abs=0.04 * len(results))
