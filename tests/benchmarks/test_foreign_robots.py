"""Robots out of other packages: each is met by a process of its own, and the tool that is found is judged."""

from __future__ import annotations

import pytest

from benchmarks.harness.fresh_process import told_by
from benchmarks.harness.report import Report
from benchmarks.studies import checks, meshes, readings, robots
from benchmarks.worlds.foreign import ForeignRobot
from planner_service.errors import UnknownName


def test_a_tool_frame_that_the_file_does_not_mean_breaks_the_promise(monkeypatch: pytest.MonkeyPatch) -> None:
    met = {"joints": 6, "shapes": 7, "load_s": 1.0, "first_s": 2.0, "first": "proven", "solved": 1, "ends": 0}
    met |= {"impossible": 0, "given up": [], "ms": [3.0], "states": 10, "differ": 0, "touched": []}
    monkeypatch.setattr(ForeignRobot, "source", lambda one: one.file)
    monkeypatch.setattr(robots, "ROBOTS", (ForeignRobot("arm", "there", "arm.urdf", ("tool0", "flange")),))
    for tool, kept in (("flange", True), ("left_finger", False)):
        monkeypatch.setattr(robots, "told_by", lambda *_, tool=tool, **__: {**met, "tool": tool})
        (promise,) = [each for each in robots.run(part="plans").promises if "tool frame" in each.text]
        assert promise.kept is kept


def test_a_process_that_fails_says_how_it_ended() -> None:
    assert told_by("json.tool", "--nothing", seconds=60.0)["error"].endswith("unrecognized arguments: --nothing")
    assert told_by("timeit", "-n", 1, "-r", 1, "import time; time.sleep(9)", seconds=0.5) == {
        "error": "not done in 0.5 s"
    }


def test_a_robot_that_is_not_listed_is_refused() -> None:
    with pytest.raises(UnknownName, match="unknown robot 'UR4'; did you mean 'UR"):
        robots.run(robot="UR4")


def test_a_robot_that_no_part_can_read_has_one_line_of_the_summary(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ForeignRobot, "source", lambda one: one.file)
    monkeypatch.setattr(robots, "ROBOTS", (ForeignRobot("arm", "there", "arm.xacro", ()),))
    monkeypatch.setattr(robots, "told_by", lambda *_, **__: {"error": "no such package"})
    unread = Report("part", ({"robot": "arm", "error": "no such package"},), ())
    for part in (readings, meshes, checks):
        monkeypatch.setattr(part, "run", lambda **_: unread)
    summary = robots.run().tables[0]
    assert list(summary.columns[0].cells) == ["arm"]
    assert list(summary.columns[1].cells) == ["refused"]
