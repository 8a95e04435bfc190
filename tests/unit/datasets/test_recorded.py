"""Data sets in LeRobot's layout are read by the names of the joints, whoever recorded them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from planner_service.datasets.parquet import REAL, WHOLE, sheet_bytes
from planner_service.datasets.recorded import RecordedSet
from planner_service.errors import InvalidFile

NAMES = ["b.pos", "gripper.pos", "a.pos"]
KINDS = {"observation.state": [REAL], "action": [REAL], "timestamp": REAL, "episode_index": WHOLE}


def _written(folder: Path, names: Any = NAMES, fps: Any = 30, bad: float = 0.0) -> Path:
    features = {key: {"names": names} for key in ("observation.state", "action")}
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps({"fps": fps, "features": features}))
    rows = [
        {"observation.state": [1.0, 9.0, 2.0 + bad], "action": [3.0, 9.0, 4.0], "timestamp": k / 30, "episode_index": e}
        for e in (0, 1)
        for k in range(3 + e)
    ]
    (folder / "data").mkdir()
    (folder / "data" / "file.parquet").write_bytes(sheet_bytes(rows, KINDS))
    return folder


@pytest.mark.parametrize("names", [NAMES, {"motors": ["b", "gripper", "a"]}])
def test_joints_are_found_by_their_names(tmp_path: Path, names: Any) -> None:
    recorded = RecordedSet(_written(tmp_path, names), ("a", "b"))
    episodes = list(recorded)
    assert recorded.fps == 30.0
    assert [(each.number, len(each.times)) for each in episodes] == [(0, 3), (1, 4)]
    assert episodes[1].states[0].tolist() == [2.0, 1.0]
    assert episodes[1].actions[0].tolist() == [4.0, 3.0]


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"names": ["b.pos", "c.pos", "d.pos"]}, "has no a"),
        ({"names": None}, "does not name its joints"),
        ({"fps": "30"}, "no fps"),
        ({"fps": 0}, "fps = 0"),
    ],
)
def test_a_set_that_is_none_of_this_robot_is_refused(tmp_path: Path, options: dict[str, Any], match: str) -> None:
    folder = _written(tmp_path, **options)
    with pytest.raises(InvalidFile, match=match):
        RecordedSet(folder, ("a", "b"))


def test_numbers_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    recorded = RecordedSet(_written(tmp_path, bad=float("inf")), ("a", "b"))
    with pytest.raises(InvalidFile, match="not finite"):
        list(recorded)


def test_a_set_without_frames_is_refused(tmp_path: Path) -> None:
    folder = _written(tmp_path)
    (folder / "data" / "file.parquet").unlink()
    recorded = RecordedSet(folder, ("a", "b"))
    with pytest.raises(InvalidFile, match="no frames"):
        list(recorded)
