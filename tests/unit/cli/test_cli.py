"""The commands: what they print, for people and for machines, and the code they end with."""

from __future__ import annotations

import json
import logging
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from planner_service import __version__
from planner_service.cli import main
from planner_service.cli.commands import app
from planner_service.cli.exit_codes import OUR_BUG
from planner_service.cli.view import opened
from planner_service.constraints import KeepUpright, ToolRegion
from planner_service.errors import BrokenInvariant, MissingDependency
from planner_service.files.package_data import data_folder
from planner_service.geometry.shapes import Box, Pose
from planner_service.planners import PRMstar
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import PlanResult
from planner_service.records.plan_file import load_plan, load_task
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import places_on, standing_on
from tests.support.command import document, interrupt_growing, refused, run
from tests.support.optional import present

PLANAR = ("plan", "--robot", "planar2", "--scene", "discs", "--time-limit", "inf")
BLOCKED = (*PLANAR, "--start", "lesson_start", "--goal", "lesson_goal")


@pytest.fixture(scope="module")
def blocked() -> Result:
    return run(*BLOCKED)


@pytest.fixture(scope="module")
def picked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    path = tmp_path_factory.mktemp("task") / "task.json"
    return run("pick-place", "--out", str(path)), path


def test_a_plan_is_printed_stage_by_stage_and_adds_up(blocked: Result) -> None:
    assert blocked.exit_code == 0
    head, *rows = blocked.stdout[: blocked.stdout.index("motion:")].splitlines()
    assert " ".join(head.split()) == "planned: planar2 in discs, lesson_start -> lesson_goal states edges distances ms"
    names = [row[:19].strip() for row in rows]
    assert names == [
        "endpoints",
        "straight line",
        "search",
        "shortcut",
        "polish",
        "certify",
        "timing",
        "total",
    ]
    *parts, total = [[int(word.replace(",", "")) for word in row.split()[-4:-1]] for row in rows]
    assert [sum(column) for column in zip(*parts, strict=True)] == total
    assert "blocked at" in rows[1]


def test_the_numbers_of_a_plan_are_those_of_the_library(blocked: Result) -> None:
    service = PlannerService("planar2", "discs")
    found = document(*BLOCKED)
    start, goal = service.robot.pose("lesson_start"), service.robot.pose("lesson_goal")
    assert found["request"]["start"] == start.tolist()
    assert found["request"]["goals"] == [{"joints": goal.tolist()}]
    counts = found["result"]["counts"]
    (total,) = [line for line in blocked.stdout.splitlines() if line.startswith("  total")]
    assert total.split()[-4:-1] == [f"{counts[name]:,}" for name in ("states", "edges", "distances")]


def test_the_proof_and_the_motion_are_told_in_words(blocked: Result) -> None:
    result = document(*BLOCKED)["result"]
    words = " ".join(blocked.stdout.split())
    proof, motion = result["certificate"], result["motion"]
    assert f"proof: {math.floor(proof['clearance'] * 1e5) / 100:.2f} mm clear, between samples too" in words
    assert f"({proof['distances']:,} bounds)" in words
    assert f"motion: {motion['duration']:.2f} s ({motion['stop_duration']:.2f} s with a stop at each corner)" in words


def test_no_line_is_wider_than_the_terminal_nor_than_it_needs_to_be() -> None:
    for columns in [20, 60, 88, 100, 200]:
        lines = run(*BLOCKED, columns=columns).stdout.splitlines()
        assert max(map(len, lines)) <= max(min(columns, 100), 20)


def test_planners_are_chosen_by_name() -> None:
    found = document(*BLOCKED, "--planner", "KPIECE1")
    assert found["request"]["planner"]["name"] == "kpiece1"
    assert found["result"]["ok"]


def test_timing_laws_are_chosen_by_name() -> None:
    assert document(*BLOCKED, "--timing", "S-Curve")["request"]["timing"]["name"] == "s-curve"


def test_settings_reach_the_request() -> None:
    settings = ("--seed", "7", "--max-checks", "9999", "--padding", "0.002", "--start-overlap", "0.001")
    asked = document(*BLOCKED, *settings)["request"]
    assert (asked["seed"], asked["max_checks"], asked["padding"], asked["time_limit"]) == (7, 9999, 0.002, None)
    assert asked["start_overlap"] == 0.001


def test_joint_values_may_be_negative_and_a_goal_a_pose_of_the_tool() -> None:
    goal = "pose:0.3,0.1,0.25,0.7071067811865476,0,0.7071067811865476,0"
    found = document(
        "plan", "--scene", "table", "--start", "-0.1,0.95,1.15,-1.25,0,0", "--goal", goal, "--goal", "home"
    )
    assert found["request"]["start"][0] == -0.1
    assert found["request"]["goals"][0]["pose"]["position"] == [0.3, 0.1, 0.25]
    assert found["result"]["goal_index"] in (0, 1)


def test_start_and_goal_may_be_the_same() -> None:
    result = run("plan", "--scene", "table", "--start", "home", "--goal", "home")
    assert result.exit_code == 0
    assert "nothing to do" in result.stdout


def test_a_plan_file_is_what_json_prints(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    found = document(*BLOCKED, "--out", str(path))
    assert json.loads(path.read_text()) == found
    assert load_plan(path).result.ok


@pytest.mark.parametrize(
    ("goal", "reason"),
    [
        ("0,0.95,9,0,0,0", "GOAL_OUTSIDE_LIMITS .*joint_2 = 9 is outside"),
        ("0,2.2,0.6,0,0,0", "GOAL_IN_COLLISION .*link_6 x table \\(at most"),
        ("pose:1,0,0,1,0,0,0", "NO_IK_SOLUTION"),
    ],
)
def test_no_plan_ends_with_1_the_reason_and_a_file(goal: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    result = run("plan", "--scene", "table", "--start", "home", "--goal", goal, "--out", str(path))
    assert result.exit_code == 1
    assert result.stdout.startswith("no plan: wxai in table")
    assert re.search(f"^no plan: {reason}", result.stderr)
    failure = present(load_plan(path).result.failure)
    assert re.match(reason.split()[0], failure.reason.value)


def test_no_plan_is_one_json_document_too() -> None:
    found = document(*BLOCKED, "--max-checks", "20", code=1)["result"]
    assert (found["ok"], found["path"], found["trajectory"]) == (False, None, None)
    assert found["failure"]["reason"] == "CHECK_BUDGET_EXHAUSTED"


HOME = ("plan", "--scene", "table", "--start", "home", "--goal", "ready")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((*HOME, "--start", "nan,0,0,0,0,0"), "start: got nan; expected a finite value for joint_0"),
        ((*HOME, "--start", "0,0,0"), "--start: got 3 values (0,0,0); expected 6: joint_0, joint_1"),
        ((*HOME, "--start", "0,0,x,0,0,0"), "--start: got '0,0,x,0,0,0'; expected 6 numbers, separated by commas"),
        ((*HOME, "--start", ""), "--start: unknown pose ''"),
        ((*HOME, "--start", "hom"), "--start: unknown pose 'hom'; did you mean 'home'?"),
        ((*HOME, "--goal", "pose:1,2,3"), "--goal (2 of 2): got 'pose:1,2,3'; expected pose:x,y,z,qw,qx,qy,qz"),
        ((*HOME, "--goal", "pose:0,0,0,1,1,0,0"), "a unit quaternion (w, x, y, z); its norm is 1.41421"),
        ((*HOME, "--scene", "tabel"), "unknown scene 'tabel'; did you mean 'table'?"),
        ((*HOME, "--robot", "wxa1"), "unknown robot 'wxa1'; did you mean 'wxai'?"),
        ((*HOME, "--planner", "rrtconect"), "unknown planner 'rrtconect'; did you mean 'rrtconnect'?"),
        ((*HOME, "--timing", "topra"), "unknown timing law 'topra'; did you mean 'toppra'?"),
        ((*HOME, "--plannr", "rrt"), "--planner"),
        ((*HOME, "--seed", "x"), "--seed"),
        ((*HOME, "--seed", "-1"), "seed: got -1; expected a whole number"),
        ((*HOME, "--padding", "-0.001"), "padding: got -0.001; expected a number in [0, 0.1]"),
        ((*HOME, "--max-checks", "0"), "max_checks: got 0"),
        ((*HOME, "--time-limit", "nan"), "time_limit: got nan"),
        ((*HOME, "--out", "/no/such/folder/plan.json"), "cannot be written: No such file or directory"),
        ((*HOME, "--out", "/dev/null"), "cannot be written: it exists and is not a regular file"),
        (("plan", "--scene", "table", "--start", "home"), "Missing option '--goal'"),
        (("plna",), "No such command 'plna'"),
        (("check", "--scene", "table", "--q", "0,9,0,0,0,0"), "got 9.0; expected joint_1 in [0.0000, 3.1416]"),
        (("check", "--scene", "table", "--q", "0,nan,0,0,0,0"), "got nan"),
        (("robots", "wxi"), "unknown robot 'wxi'; did you mean 'wxai'?"),
        (("scenes", "no/such.toml"), "no such file"),
        (("pick-place", "--object", "blue_blok"), "unknown obstacle for --object 'blue_blok'; did you mean 'blue_b"),
        (("pick-place", "--onto", "trai"), "unknown obstacle for --onto 'trai'; did you mean 'tray'?"),
        (("pick-place", "--onto", "blue_block"), "expected another obstacle than the object itself"),
        (("pick-place", "--robot", "planar2"), "expected a robot with a gripper"),
        (("pick-place", "--object", "table"), "an object at most 0.080 m wide"),
    ],
)
def test_bad_input_ends_with_2_and_says_what_would_be_right(arguments: tuple[str, ...], message: str) -> None:
    assert message in refused(*arguments)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[[obstacle]\nname = "a"', "malformed TOML"),
        ('[[obstacle]]\nname = "a"\nsphere = -0.1\nposition = [0, 0, 1]', "sphere: got -0.1; expected a positive"),
    ],
)
def test_a_scene_file_that_is_wrong_is_bad_input(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    assert message in refused("check", "--scene", str(path), "--q", "home")


def edited(name: str, old: str, new: str) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return edit


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (edited("robot.toml", "name =", "name"), "malformed TOML"),
        (
            edited("planar2.urdf", "<geometry>", '<geometry><mesh filename="../../secret.stl"/></geometry><geometry>'),
            "secret.stl",
        ),
    ],
    ids=["toml", "outside"],
)
def test_a_robot_file_that_is_wrong_is_bad_input(edit: Callable[[Path], None], message: str, tmp_path: Path) -> None:
    folder = tmp_path / "planar2"
    shutil.copytree(data_folder("robots") / "planar2", folder)
    edit(folder)
    assert message in refused("check", "--robot", str(folder / "robot.toml"), "--scene", "empty", "--q", "0,0")


def test_a_file_with_very_many_problems_is_cut_short(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text("".join(f'[[obstacle]]\nname = "o{k}"\n' for k in range(300)))
    result = run("scenes", str(path))
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 22
    assert result.stderr.splitlines()[-1].startswith("  ... and ")


def test_a_place_for_the_result_is_asked_for_before_anything_is_planned() -> None:
    assert "cannot be written" in refused(
        "plan", "--out", "/no/plan.json", "--scene", "?", "--start", "?", "--goal", "?"
    )


def test_check_says_free_and_how_much_room_there_is() -> None:
    result = run("check", "--scene", "table", "--q", "ready")
    assert result.exit_code == 0
    assert result.stdout.startswith("free: wxai in table at ready\n  clearance: at least ")
    assert document("check", "--scene", "table", "--q", "ready")["clearance_at_least"] > 0.0


def test_check_names_what_touches_and_ends_with_1() -> None:
    result = run("check", "--scene", "table", "--q", "0,2.2,0.6,0,0,0")
    assert result.exit_code == 1
    head, first, *_ = result.stdout.splitlines()
    assert head == "colliding: wxai in table at 0,2.2,0.6,0,0,0"
    assert first.startswith("  link_6 x table (at most ")
    found = document("check", "--scene", "table", "--q", "0,2.2,0.6,0,0,0", code=1)
    assert found["free"] is False
    assert (found["contacts"][0]["a"], found["contacts"][0]["b"]) == ("link_6", "table")
    assert found["clearance_at_least"] < 0.0


@pytest.mark.slow
def test_robots_are_listed_and_shown() -> None:
    assert {"planar2", "wxai"} <= {line.split()[0] for line in run("robots").stdout.splitlines()}
    shown = run("robots", "wxai").stdout
    assert "wxai: 6 joints, 29 collision shapes" in shown
    assert "0,0.95,1.15,-1.25,0,0" in shown
    listed, one = document("robots")["robots"], document("robots", "wxai")
    assert one in listed
    assert one["joints"][2]["name"] == "joint_2"
    assert one["poses"]["home"] == [0.0, 0.95, 1.15, -1.25, 0.0, 0.0]


def test_scenes_are_listed_and_shown() -> None:
    assert "bin " in run("scenes").stdout
    shown = run("scenes", "bin").stdout
    assert "demo_post" in shown
    assert "radius 0.025, length 0.35" in shown
    one = document("scenes", "bin")
    assert one in document("scenes")["scenes"]
    assert one["hash"] == load_scene("bin").hash
    assert one["obstacles"][0]["box"] == [1.4, 1.4, 0.1]


def test_pick_and_place_is_printed_motion_by_motion_and_adds_up(picked: tuple[Result, Path]) -> None:
    result, _ = picked
    assert result.exit_code == 0, result.output
    head, *rows = [line for line in result.stdout.splitlines() if not line.startswith(("note", "proof"))]
    assert " ".join(head.split()) == "planned: pick blue_block from bin, place on tray states edges distances ms"
    rows = [row for row in rows if row[:19].strip()]
    names = [row[2:19].strip() for row in rows if row[:4].strip() and row[2] != " "]
    taking = ["gripper closes", "home -> pregrasp", "descend", "gripper closes", "lift"]
    leaving = ["transfer", "lower", "gripper opens", "retreat", "retreat -> home"]
    assert names == [*taking, *leaving, "choosing", "total"]
    *parts, total = [[int(word.replace(",", "")) for word in row.split()[-4:-1]] for row in rows]
    assert [sum(column) for column in zip(*parts, strict=True)] == total


def test_pick_and_place_searches_only_where_a_straight_line_is_blocked(picked: tuple[Result, Path]) -> None:
    task = load_task(picked[1])
    assert [segment.name for segment in task.segments if segment.result.attempts] == ["transfer", "retreat -> home"]


def test_a_motion_that_searched_is_followed_by_its_stages(picked: tuple[Result, Path]) -> None:
    lines = [line[:19].rstrip() for line in picked[0].stdout.splitlines()]
    at = lines.index("  transfer")
    stages = ["    search", "    shortcut", "    polish", "    certify", "    timing"]
    assert lines[at + 1 : at + 7] == [*stages, "  lower"]


def test_pick_and_place_without_a_way_ends_with_1_and_what_was_tried() -> None:
    found = run("pick-place", "--onto", "demo_post")
    assert found.exit_code == 1
    assert "none of 4 ways has a plan: way 1: out of reach" in found.stderr
    assert [s["name"] for s in document("pick-place", "--onto", "demo_post", code=1)["segments"]] == [
        "home -> pregrasp",
        "descend",
        "lift",
    ]


def test_an_object_stands_on_what_is_under_its_middle() -> None:
    scene = load_scene("bin")
    assert standing_on(scene, "blue_block") == "bin_floor"
    assert standing_on(scene.moved("blue_block", Pose((0.33, 0.0, 0.1))), "blue_block") is None
    alone = Scene((Obstacle("card", Box((0.1, 0.1, 0.003)), Pose((0.0, 0.0, 0.5))),))
    assert standing_on(alone, "card") is None
    beside = alone.with_obstacle(Obstacle("board", Box((0.3, 0.3, 0.1)), Pose((0.0, 0.4, 0.4485))))
    assert standing_on(beside, "card") is None
    assert standing_on(beside.moved("board", Pose((0.0, 0.1, 0.4485))), "card") == "board"


def test_an_object_is_placed_with_its_underside_exactly_on_the_support() -> None:
    support = Obstacle("tray", Box((0.2, 0.2, 0.02)), Pose((0.3, 0.1, 0.5)))
    lying = Obstacle("bar", Box((0.02, 0.04, 0.2)), Pose((1.0, 1.0, 1.0), (0.5**0.5, 0.5**0.5, 0.0, 0.0)))
    poses = places_on(lying, support)
    assert len(poses) == 4
    for pose in poses:
        assert pose.position == pytest.approx((0.3, 0.1, 0.5 + 0.01 + 0.02), abs=1e-12)  # rounding of sums near 1
        assert abs(pose.rotation[2, 1]) == pytest.approx(1.0, abs=1e-12)  # its own y axis stays upright


LEFT, RIGHT = "-2.23,1.11,0.7,-0.6,-0.04,2.45", "2.65,1.51,1.06,-0.56,0.3,-1.02"
"""On both sides of the window's wall: the straight line between them is blocked."""


def started(*arguments: str) -> subprocess.Popen[str]:
    """The command in a process of its own."""
    code = "from planner_service.cli import main; main()"
    root = str(Path(__file__).parents[3])
    environment = {**os.environ, "PYTHONPATH": root}
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )


@pytest.mark.slow
def test_a_reader_that_goes_away_is_no_error(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    process = started(*BLOCKED, "--json", "--out", str(path))
    present(process.stdout).close()
    assert present(process.stderr).read() == ""
    assert process.wait() == 0
    assert load_plan(path).result.ok
    present(process.stderr).close()


def test_an_interrupted_search_ends_with_130_quietly(monkeypatch: pytest.MonkeyPatch) -> None:
    interrupt_growing(monkeypatch, PRMstar)
    result = run("plan", "--scene", "window", "--planner", "prmstar", "--start", LEFT, "--goal", RIGHT)
    assert (result.exit_code, result.output) == (130, "")


def test_our_own_errors_keep_their_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(name: str) -> None:
        raise BrokenInvariant("a promise")

    monkeypatch.setattr("planner_service.cli.commands.load_scene", broken)
    monkeypatch.setattr(sys, "argv", ["planner-service", "scenes", "bin"])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == OUR_BUG
    error = capsys.readouterr().err
    assert error.startswith("Traceback")
    assert "BrokenInvariant: a promise" in error


def test_what_was_not_judged_is_said() -> None:
    printed = run("plan", "--scene", "table", "--start", "sleep", "--goal", "ready").stdout
    assert "note: not judged from s = 0.000 to 0.113: link_2 x link_5, link_2 x link_4" in " ".join(printed.split())


def saved_plan(there: Path) -> Path:
    assert run(*BLOCKED, "--out", str(there)).exit_code == 0
    return there


def test_a_saved_plan_is_proven_again(tmp_path: Path) -> None:
    there = saved_plan(tmp_path / "plan.json")
    found = run("certify", str(there))
    assert found.exit_code == 0
    assert found.stdout.startswith("certified:")
    assert json.loads(run("certify", str(there), "--json").stdout)["certified"] is True
    refused = run("certify", str(there), "--padding", "0.09")
    assert refused.exit_code == 1
    assert "is not proven apart" in " ".join(refused.stdout.split())


@pytest.mark.slow
def test_every_motion_of_a_saved_task_is_proven_again_with_what_it_carries(tmp_path: Path) -> None:
    there = str(tmp_path / "task.json")
    assert run("pick-place", "--out", there).exit_code == 0
    found = run("certify", there)
    assert found.exit_code == 0
    lines = " ".join(found.stdout.split())
    assert lines.count(": certified: ") == 7 + 3  # the gripper closes twice and opens once
    assert "gripper closes before lift: certified: " in lines


def test_certify_says_which_constraints_are_kept(tmp_path: Path) -> None:
    ends = ["--start=-0.6747,1.754,1.5522,-1.369,0,-0.6747", "--goal", "pose:0.25,0.2,0.12,0.70711,0,0.70711,0"]
    made = run(
        "plan", "--scene", "post", *ends, "--upright", "0.1", "--seed", "7", "--out", str(tmp_path / "plan.json")
    )
    assert re.search(r"proof: [\d.]+ mm clear, .*; upright kept \(tilt", " ".join(made.stdout.split()))
    found = " ".join(run("certify", str(tmp_path / "plan.json")).stdout.split())
    assert re.search(r"motion: certified: [\d.]+ mm clear; upright kept \(tilt 0\.\d+ of 0\.1 rad\)", found)


def test_a_lean_out_of_range_names_its_option() -> None:
    assert "--upright: got 9.0; expected radians in [0.001, pi]" in " ".join(
        refused("pick-place", "--upright", "9").split()
    )


def test_what_is_picked_upright_is_said_to_be_kept(tmp_path: Path) -> None:
    assert run("pick-place", "--upright", "0.1", "--out", str(tmp_path / "task.json")).exit_code == 0
    found = " ".join(run("certify", str(tmp_path / "task.json")).stdout.split())
    assert found.count("upright kept (tilt") == 3
    refused = run("pick-place", "--upright", "0.1", "--planner", "rrtconnect")
    assert refused.exit_code == 2


def test_a_plan_is_proven_against_the_scene_in_its_file_or_one_that_is_given(tmp_path: Path) -> None:
    there = saved_plan(tmp_path / "plan.json")
    alone = run("certify", str(there))
    assert alone.exit_code == 0
    assert "note: using the scene in this file: discs" in alone.stdout
    asked = run("certify", str(there), "--scene", "empty")
    assert asked.exit_code == 0
    told = " ".join(asked.stdout.split())
    assert "using --scene empty instead of the scene in this file" in told
    assert "made for another scene: discs" in told


def test_a_file_whose_hash_is_not_that_of_its_scene_is_refused(tmp_path: Path) -> None:
    there = saved_plan(tmp_path / "plan.json")
    document = json.loads(there.read_text())
    document["scene"]["hash"] = "0" * 64
    there.write_text(json.dumps(document))
    done = run("certify", str(there))
    assert done.exit_code == 2
    assert "scene.hash: got '0000" in done.stderr


def test_an_exported_motion_that_begins_at_speed_says_so(tmp_path: Path) -> None:
    service = PlannerService("wxai", "empty")
    first = service.plan(PlanRequest(service.robot.home, service.robot.pose("ready"), time_limit=None))
    second = service.replan(first, at_time=0.3)
    for result, noted in ((first, False), (second.result, True)):
        result.save(tmp_path / "plan.json")
        exported = run("export", str(tmp_path / "plan.json"), "--format", "csv")
        assert exported.exit_code == 0
        assert ("it begins at speed" in exported.stderr) == noted


def test_a_plan_for_a_scene_of_ones_own_needs_nothing_but_its_file(tmp_path: Path) -> None:
    cell = tmp_path / "my_cell.toml"
    cell.write_text('[[obstacle]]\nname = "post"\nsphere = 0.05\nposition = [0.4, 0.2, 0.2]\n')
    file = tmp_path / "p.json"
    goal = "0.3,1.2,1.0,-0.5,0,0"
    assert run("plan", "--scene", str(cell), "--start", "home", "--goal", goal, "--out", str(file)).exit_code == 0
    cell.unlink()
    assert run("certify", str(file)).exit_code == 0
    assert run("export", str(file)).exit_code == 0
    _, shown, notes = opened(str(file), None, None)
    assert isinstance(shown, PlanResult)
    assert shown.ok
    assert notes == ["using the scene in this file: unnamed"]


def test_a_robot_whose_package_is_not_installed_is_listed_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> Robot:
        if name == "wxai_mesh":
            raise MissingDependency("trossen-arm-sim", "wxai-meshes")
        return load_robot("planar2")

    monkeypatch.setattr("planner_service.cli.listings.load_robot", absent)
    words = " ".join(run("robots", columns=200).stdout.split())
    assert "wxai_mesh trossen-arm-sim is not installed; pip install 'planner-service[wxai-meshes]'" in words
    assert list(document("robots")["missing"]) == ["wxai_mesh"]


def planar_urdf() -> str:
    return str(data_folder("robots") / "planar2" / "planar2.urdf")


def test_a_robot_is_imported_and_can_be_planned_with(tmp_path: Path) -> None:
    out = tmp_path / "arm"
    result = run("import-robot", planar_urdf(), "--out", str(out))
    assert (result.exit_code, result.stderr) == (0, "")
    words = " ".join(result.stdout.split())
    assert "imported: planar2, written to" in words
    assert "links 4 links with shapes 2 shapes 2 joints 2 pairs allowed, adjacent 1 second reader: " in words
    assert "tool_frame tip is a guess" in words
    assert run("robots", str(out / "robot.toml")).exit_code == 0
    planned = run("plan", "--robot", str(out / "robot.toml"), "--scene", "discs", "--start", "home", "--goal", "0.1,0")
    assert planned.exit_code in (0, 1)


def test_an_import_tells_machines_every_pair(tmp_path: Path) -> None:
    arguments = ("import-robot", planar_urdf(), "--out", str(tmp_path / "arm"), "--lock", "elbow=0.5")
    found = document(*arguments, "--tool-frame", "tip")
    assert [joint["name"] for joint in found["robot"]["joints"]] == ["shoulder"]
    assert (found["pairs"], found["robot_toml"]) == ([], str(tmp_path / "arm" / "robot.toml"))


def test_an_import_may_choose_the_joints_that_move(tmp_path: Path) -> None:
    found = document("import-robot", planar_urdf(), "--out", str(tmp_path / "arm"), "--joint", "elbow")
    assert [joint["name"] for joint in found["robot"]["joints"]] == ["elbow"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("none.urdf",), "no such file"),
        (("URDF", "--lock", "elbo=0"), "unknown joint 'elbo'; did you mean 'elbow'?"),
        (("URDF", "--lock", "elbow"), "--lock: got 'elbow'; expected joint=value"),
        (("URDF", "--lock", "elbow=nan"), "a position in [-3.14159, 3.14159]"),
        (("URDF", "--lock", "elbow=0", "--lock", "elbow=1"), "each joint once"),
        (("URDF", "--tool-frame", "tipp"), "unknown tool frame 'tipp'"),
        (("URDF", "--srdf", "none.srdf"), "no such file"),
        (("URDF", "--joint", "elbo"), "unknown joint 'elbo'; did you mean 'elbow'?"),
    ],
)
def test_an_import_that_cannot_be_says_why_and_writes_nothing(
    tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    given = [planar_urdf() if argument == "URDF" else argument for argument in arguments]
    assert words in refused("import-robot", *given, "--out", str(tmp_path / "arm"))
    assert list(tmp_path.iterdir()) == []


def test_an_import_does_not_replace_what_is_there(tmp_path: Path) -> None:
    arguments = ("import-robot", planar_urdf(), "--out", str(tmp_path / "arm"))
    assert run(*arguments).exit_code == 0
    assert "--force replaces it" in refused(*arguments)
    assert run(*arguments, "--force").exit_code == 0


def test_a_task_keeps_the_padding_that_is_asked_for(tmp_path: Path) -> None:
    file = tmp_path / "task.json"
    assert run("pick-place", "--padding", "0.005", "--out", str(file)).exit_code == 0
    assert max(segment.result.padding for segment in load_task(file).segments) == 0.005


def test_commands_are_listed_in_the_order_a_person_meets_them() -> None:
    commands = run("--help").stdout.partition("Commands:\n")[2].partition("\n\n")[0]
    first, *rest = [line.split()[0] for line in commands.splitlines()]
    assert [first, *rest[:6]] == ["robots", "scenes", "check", "plan", "explain", "pick-place", "view"]
    others = "certify export join run import-robot episodes serve doctor roadmap robot"
    assert {*rest[6:]} == set(others.split())


COMMANDS = [
    "robots",
    "scenes",
    "check",
    "plan",
    "explain",
    "pick-place",
    "view",
    "certify",
    "export",
    "run",
    "import-robot",
]
COMMANDS += ["episodes", "serve", "doctor", "roadmap build", "roadmap query", "roadmap info", "roadmap update"]


def test_every_help_has_an_example_that_the_command_accepts() -> None:
    for command in COMMANDS:
        shown = run(*command.split(), "-h")
        assert shown.exit_code == 0
        (example,) = re.findall(r"Example:\n +planner-service (.*)$", shown.stdout, re.M)
        assert example.startswith(command)
        accepted = run(*shlex.split(example), "--help")  # an unknown option or a missing value would be an error
        assert (accepted.exit_code, accepted.stdout) == (0, shown.stdout)


def test_the_version_is_that_of_the_package() -> None:
    assert run("--version").stdout == f"planner-service {__version__}\n"


@pytest.mark.slow
def test_the_package_is_the_command(tmp_path: Path) -> None:
    ask = [sys.executable, "-m", "planner_service", "--version"]
    done = subprocess.run(ask, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr, done.returncode) == (f"planner-service {__version__}\n", "", 0)


def test_the_shell_completes_commands_and_names() -> None:
    for words, offered in [
        (("pick",), "pick-place"),
        (("plan", "--scene", "b"), "bin"),
        (("plan", "--planner", "rrtc"), "rrtconnect"),
        (("plan", "--timing", "s"), "s-curve"),
    ]:
        typed = " ".join(("planner-service", *words))
        environment = {"_PLANNER_SERVICE_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(words))}
        result = CliRunner(env=environment).invoke(app, [], prog_name="planner-service")
        assert offered in result.stdout.split()


def test_verbose_shows_the_log_and_leaves_the_logger_as_it_was() -> None:
    logger = logging.getLogger("planner_service")
    before = (logger.level, list(logger.handlers))
    assert logger.isEnabledFor(logging.DEBUG) is False

    @app.command("log-once", hidden=True)
    def log_once() -> None:
        logging.getLogger("planner_service.test").debug("a stage")

    try:
        assert run("-v", "log-once").stderr == "a stage\n"
        assert run("log-once").stderr == ""
    finally:
        app.registered_commands.pop()
    assert (logger.level, logger.handlers) == before


# Constraints.

TOOL_DOWN = ("plan", "--scene", "post", "--start=-0.6747,1.754,1.5522,-1.369,0,-0.6747", "--time-limit", "inf")
ACROSS = (*TOOL_DOWN, "--goal", "pose:0.25,0.2,0.12,0.70711,0,0.70711,0", "--seed", "7")


def test_the_axis_that_points_up_at_the_start_is_kept_upright_and_named(tmp_path: Path) -> None:
    result = run(*ACROSS, "--upright", "0.1", "--out", tmp_path / "plan.json")
    assert (result.exit_code, "upright: the tool's -x axis points up, within 0.1 rad" in result.stdout) == (0, True)
    assert "projections" in result.stdout.splitlines()[0]
    (kept,) = load_plan(tmp_path / "plan.json").request.constraints  # type: ignore[union-attr]
    assert isinstance(kept, ToolRegion)
    assert (kept.name, kept.tilt, kept.tool) == ("upright", 0.1, KeepUpright((-1, 0, 0), 0.1).tool)


def test_constraints_of_a_file_and_upright_are_both_kept(tmp_path: Path) -> None:
    file = tmp_path / "region.toml"
    file.write_text("[[constraint]]\nkind = 'joint range'\njoint = 'joint_4'\nlower = -1.5\nupper = 1.5\n")
    found = document(*ACROSS, "--upright", "0.1", "--region", file)
    assert [entry["kind"] for entry in found["request"]["constraints"]] == ["tool region", "joint range"]


def test_a_plan_without_constraints_says_nothing_of_them() -> None:
    result = run(*ACROSS)
    assert (result.exit_code, "upright" in result.stdout, "projections" in result.stdout) == (0, False, False)


def test_constraints_that_cannot_be_kept_are_bad_input() -> None:
    for options, problem in [
        (("--upright", "0"), "--upright: got 0.0; expected radians in [0.001, 3.142]"),
        (("--upright", "nan"), "--upright: got nan; expected radians"),
        (("--upright=-inf",), "--upright: got -inf; expected radians"),
        (("--upright", "1e400"), "--upright: got inf; expected radians"),
        (("--upright", "tall"), "Invalid value for '--upright'"),
        (("--upright", "0.1", "--planner", "rrtconnect"), "planner: got RRTConnect"),
        (("--upright", "0.1", "--polish"), "expected None: an optimum does not keep constraints"),
        (("--region", "nowhere.toml"), "nowhere.toml"),
        (("--region", "/"), "/"),
        (("--region", "/dev/zero"), "/dev/zero"),
        (("--region", ""), "not a file"),
    ]:
        assert problem in " ".join(refused(*ACROSS, *options).split())


def test_a_start_that_is_not_upright_is_no_plan_and_says_by_how_much() -> None:
    result = run("plan", "--scene", "bin", "--start", "home", "--goal", "ready", "--upright", "0.1")
    assert (result.exit_code, "start does not keep upright: tilted by 0.521 rad" in result.stderr) == (1, True)


def test_a_joint_that_the_robot_does_not_have_is_named(tmp_path: Path) -> None:
    file = tmp_path / "region.toml"
    file.write_text("[[constraint]]\nkind = 'joint range'\njoint = 'joint_44'\nlower = 0\nupper = 1\n")
    assert "unknown joint 'joint_44'; did you mean 'joint_4'?" in refused(*ACROSS, "--region", file)


@pytest.mark.parametrize(
    "content",
    [
        b"\x00\xff" * 50,
        b"a = " + b"[" * 5_000,
        b"[[constraint]]\nkind = 'tool region'\ntilt = 0.1\nname = \"\\u001b[2J\"",
        b"[[constraint]]\nkind = 'tool region'\ntilt = 0.1\nlink = '" + b"l" * 90_000 + b"'",
        b"[[constraint]]\nkind = 'tool region'\ntilt = 0.1\n" * 5_000,
    ],
)
def test_a_broken_file_of_constraints_is_bad_input(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "region.toml"
    file.write_bytes(content)
    said = refused(*ACROSS, "--region", file)
    assert "region.toml" in " ".join(said.split())
    assert len(said) < 5_000
    assert "\x1b" not in said
