"""The examples that no page shows whole run and keep what they promise."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import pytest

from planner_service.records.recertify import recertify

EXAMPLES = Path(__file__).parents[2] / "examples"


def printed_by(example: str, capsys: pytest.CaptureFixture[str]) -> str:
    runpy.run_path(str(EXAMPLES / example), run_name="__main__")
    return capsys.readouterr().out


def number(text: str) -> int:
    return int(text.replace(",", ""))


def test_a_block_is_taken_from_the_bin_to_the_tray_and_touched_only_where_it_is_meant(
    capsys: pytest.CaptureFixture[str],
) -> None:
    printed = printed_by("02_pick_and_place.py", capsys)
    motions = re.findall(r"^  ([a-z ]+?) +(straight|searched) +([\d,]+) states +(.*) mm clear$", printed, re.MULTILINE)
    names = ["to pregrasp", "descend", "lift", "transfer", "lower", "retreat", "to home"]
    assert [name for name, *_ in motions] == names
    assert [name for name, how, *_ in motions if how == "searched"] == ["transfer", "to home"]
    assert min(float(clear) for *_, clear in motions) > 0.0
    (total,) = re.findall(r"^([\d,]+) states for", printed, flags=re.MULTILINE)
    assert sum(number(states) for _, _, states, _ in motions) == number(total)
    meant = re.findall(r"^    not judged from s = \S+ to \S+: (.*) \(", printed, flags=re.MULTILINE)
    fingers = "finger_left x blue_block, finger_right x blue_block"
    assert meant == [fingers, "blue_block x bin_floor", "blue_block x tray", fingers]
    assert printed.rstrip().endswith("the block now stands at (0.2, 0.28, 0.0335)")


def test_an_arm_comes_with_its_contacts_explained_and_plans(capsys: pytest.CaptureFixture[str]) -> None:
    printed = printed_by("05_your_own_robot.py", capsys)
    table = re.findall(r"^  (allowed|checked) +(\w+ x \w+) +(\S.*)$", printed, flags=re.MULTILINE)
    assert len(table) == 10
    assert {reason.split(":")[0] for verdict, _, reason in table if verdict == "allowed"} == {"adjacent", "never"}
    assert all(reason.startswith("collides in") for verdict, _, reason in table if verdict == "checked")
    assert re.search(r"^blocked at .*: \w+ x post$", printed, flags=re.MULTILINE)
    assert re.search(r"^planned: ", printed, flags=re.MULTILINE)


def test_a_path_from_elsewhere_is_refused_repaired_and_proven(capsys: pytest.CaptureFixture[str]) -> None:
    printed = printed_by("06_certify_someone_elses_path.py", capsys)
    (looked, free) = re.findall(r"^at (\d+) samples, .*: (\d+) free$", printed, flags=re.MULTILINE)[0]
    assert looked == free
    refused = re.findall(r"^(\w+ x \w+) is not proven apart from s = (\S+) to (\S+): .*overlap", printed, re.MULTILINE)
    assert [pair for pair, *_ in refused] == ["link_6 x post_ahead"]
    assert re.search(r"^piece 2 planned again: ", printed, flags=re.MULTILINE)
    assert re.search(r"^proven: at least ([\d.]+) mm", printed, flags=re.MULTILINE)
    (stops, blends) = re.findall(r"^([\d.]+) s with stops, ([\d.]+) s with blends$", printed, flags=re.MULTILINE)[0]
    assert float(blends) < 0.7 * float(stops)


def test_a_motion_is_replanned_while_it_is_under_way(capsys: pytest.CaptureFixture[str]) -> None:
    printed = printed_by("07_replanning.py", capsys)
    jumps = [float(jump) for jump in re.findall(r"largest jump (\S+)$", printed, flags=re.MULTILINE)]
    assert len(jumps) > 10
    assert max(jumps) < 1e-9
    assert printed.rstrip().endswith("arrived")


def test_the_loop_on_the_page_on_replanning_runs_to_its_end(capsys: pytest.CaptureFixture[str]) -> None:
    page = (EXAMPLES.parent / "docs" / "guides" / "replanning.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    for code in re.findall(r"^```python\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE):
        exec(compile(code, "replanning.md", "exec"), names)
    clock = [0.0]
    around = {"now": lambda: clock[0], "wait_until": lambda t: clock.__setitem__(0, t)}
    names |= around | {"as_seen": lambda: names["scene"], "halt": lambda: pytest.fail("nothing is safe")}
    names["drive"](names["motion"], names["request"], names["GOAL"])


@pytest.mark.parametrize(
    ("example", "promise"),
    [
        ("04_roadmap_for_a_cell.py", r"^demo_post changed: [\d,]+ edges kept without a check"),
        ("09_keep_upright.py", r"^with a constraint.* projections$"),
        ("10_payload.py", r"^6 kg: GOAL_EXCEEDS_TORQUE .*panda_joint2 cannot hold 6 kg here: [\d.]+ of 87 Nm$"),
    ],
)
def test_an_example_prints_what_it_promises(example: str, promise: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert re.search(promise, printed_by(example, capsys), flags=re.MULTILINE)


def test_a_drawer_and_a_door_are_opened_and_every_motion_is_proven_again(capsys: pytest.CaptureFixture[str]) -> None:
    printed = printed_by("13_doors_and_drawers.py", capsys)
    assert "the drawer is 60 mm open" in printed
    assert "the door is 20 degrees open" in printed
    example = runpy.run_path(str(EXAMPLES / "13_doors_and_drawers.py"))
    for task in (example["open_drawer"](), example["open_door"]()):
        assert recertify(task).certified


def test_a_pallet_is_filled_and_all_but_the_first_box_costs_less(capsys: pytest.CaptureFixture[str]) -> None:
    printed = printed_by("14_fill_a_pallet.py", capsys)
    states = [number(each) for each in re.findall(r"^box_\d+: [\d.]+ s of motion, ([\d,]+) states$", printed, re.M)]
    assert len(states) == 24
    assert max(states[1:]) < states[0] / 3


def test_a_bottle_under_a_board_is_taken_from_the_side_and_a_mug_by_its_handle(
    capsys: pytest.CaptureFixture[str],
) -> None:
    printed = printed_by("15_mug_and_bottle.py", capsys)
    assert re.search(r"^bottle: way \d+ of \d+, side grasp, ", printed, re.M)
    assert re.search(r"^mug: way \d+ of \d+, antipodal grasp, ", printed, re.M)
    example = runpy.run_path(str(EXAMPLES / "15_mug_and_bottle.py"))
    service = example["cell"]()
    done = example["take"](service, "mug")
    assert recertify(done).certified
    (held,) = done.world.scene.attached
    x, *_ = held.pose.inverse().position  # where the fingers are, in the frame of the mug
    assert x < -0.05, "beside its wall"
