"""The commands: what they print, for people and for machines, and the code they end with."""

from __future__ import annotations

import json
import os
import re
import shlex
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
from planner_service.constraints import KeepUpright, ToolRegion
from planner_service.datasets import EpisodeWork, write_episodes
from planner_service.datasets.bin_task import BinPickPlace
from planner_service.errors import BrokenInvariant, MissingDependency
from planner_service.files.package_data import data_folder
from planner_service.geometry.shapes import Box, Pose
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import PlanResult
from planner_service.records.cells import save_cell_plan
from planner_service.records.exports.trajectory_export import yaml_text
from planner_service.records.plan_file import load_plan
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import places_on, standing_on
from planner_service.view.recordings.rerun_recording import rerun_bytes
from tests.support.command import document, refused, run
from tests.support.optional import present
from tests.unit.records.cells.cells import crossing, two_discs

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
    found = document(*BLOCKED)
    counts = found["result"]["counts"]
    assert total == [counts[name] for name in ("states", "edges", "distances")]
    service = PlannerService("planar2", "discs")
    assert found["request"]["start"] == service.robot.pose("lesson_start").tolist()
    assert found["request"]["goals"] == [{"joints": service.robot.pose("lesson_goal").tolist()}]


def test_no_line_is_wider_than_the_terminal_nor_than_it_needs_to_be() -> None:
    for columns in [20, 60, 88, 100, 200]:
        lines = run(*BLOCKED, columns=columns).stdout.splitlines()
        assert max(map(len, lines)) <= max(min(columns, 100), 20)


def test_settings_reach_the_request() -> None:
    limits = ("--seed", "7", "--max-checks", "9999", "--padding", "0.002", "--start-overlap", "0.001")
    asked = document(*BLOCKED, *limits, "--planner", "KPIECE1", "--timing", "S-Curve")["request"]
    assert (asked["planner"]["name"], asked["timing"]["name"]) == ("kpiece1", "s-curve")
    assert (asked["seed"], asked["max_checks"], asked["padding"], asked["time_limit"]) == (7, 9999, 0.002, None)
    assert asked["start_overlap"] == 0.001


def test_a_plan_file_is_what_json_prints(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    found = document(*BLOCKED, "--out", str(path))
    assert json.loads(path.read_text()) == found
    assert load_plan(path).result.ok


@pytest.mark.parametrize(
    ("goal", "reason"),
    [
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


HOME = ("plan", "--scene", "table", "--start", "home", "--goal", "ready")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((*HOME, "--start", "0,0,0"), "--start: got 3 values (0,0,0); expected 6: joint_0, joint_1"),
        ((*HOME, "--start", "hom"), "--start: unknown pose 'hom'; did you mean 'home'?"),
        ((*HOME, "--goal", "pose:1,2,3"), "--goal (2 of 2): got 'pose:1,2,3'; expected pose:x,y,z,qw,qx,qy,qz"),
        ((*HOME, "--robot", "wxa1"), "unknown robot 'wxa1'; did you mean 'wxai'?"),
        ((*HOME, "--plannr", "rrt"), "--planner"),
        ((*HOME, "--seed", "-1"), "seed: got -1; expected a whole number"),
        ((*HOME, "--out", "/no/such/folder/plan.json"), "cannot be written: No such file or directory"),
        (("plan", "--scene", "table", "--start", "home"), "Missing option '--goal'"),
        (("plna",), "No such command 'plna'"),
        (("check", "--scene", "table", "--q", "0,9,0,0,0,0"), "got 9.0; expected joint_1 in [0.0000, 3.1416]"),
        (("scenes", "no/such.toml"), "no such file"),
        (("pick-place", "--object", "blue_blok"), "unknown obstacle for --object 'blue_blok'; did you mean 'blue_b"),
        (("pick-place", "--object", "table"), "an object at most 0.080 m wide"),
    ],
)
def test_bad_input_ends_with_2_and_says_what_would_be_right(arguments: tuple[str, ...], message: str) -> None:
    assert message in refused(*arguments)


def test_check_says_free_with_its_clearance_or_names_what_touches_and_ends_with_1() -> None:
    result = run("check", "--scene", "table", "--q", "ready")
    assert result.exit_code == 0
    assert result.stdout.startswith("free: wxai in table at ready\n  clearance: at least ")
    result = run("check", "--scene", "table", "--q", "0,2.2,0.6,0,0,0")
    assert result.exit_code == 1
    assert result.stdout.startswith("colliding: wxai in table at 0,2.2,0.6,0,0,0\n  link_6 x table (at most ")
    found = document("check", "--scene", "table", "--q", "0,2.2,0.6,0,0,0", code=1)
    assert (found["free"], found["contacts"][0]["a"], found["contacts"][0]["b"]) == (False, "link_6", "table")
    assert found["clearance_at_least"] < 0.0


@pytest.mark.slow
def test_robots_and_scenes_are_listed_and_shown() -> None:
    shown = run("robots", "wxai").stdout
    assert "wxai: 6 joints, 29 collision shapes" in shown
    assert "0,0.95,1.15,-1.25,0,0" in shown
    listed, one = document("robots")["robots"], document("robots", "wxai")
    assert one in listed
    assert one["joints"][2]["name"] == "joint_2"
    assert one["poses"]["home"] == [0.0, 0.95, 1.15, -1.25, 0.0, 0.0]
    assert "radius 0.025, length 0.35" in run("scenes", "bin").stdout
    one = document("scenes", "bin")
    assert one in document("scenes")["scenes"]
    assert (one["hash"], one["obstacles"][0]["box"]) == (load_scene("bin").hash, [1.4, 1.4, 0.1])


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


def test_the_plan_of_a_cell_is_proven_over_all_clocks(tmp_path: Path) -> None:
    there = tmp_path / "cell.json"
    save_cell_plan(crossing(two_discs()), there)
    found = run("certify", str(there))
    assert found.exit_code == 0
    assert found.stdout.startswith("certified:")
    assert "all of them: tolerates 0.100 s of delay" in found.stdout
    proven = json.loads(run("certify", str(there), "--json").stdout)
    assert (proven["certified"], proven["arms"], len(proven["motions"])) == (True, ["left", "right"], 2)
    refused = run("certify", str(there), "--scene", "discs")
    assert refused.exit_code == 1
    assert "using --scene discs" in refused.stdout
    assert run("certify", str(there), "--robot", "wxai").exit_code == 2
    shown = tmp_path / "shown.json"
    assert run("certify", str(there), "--evidence", str(shown)).exit_code == 0
    assert "evidence" in json.loads(shown.read_text())["sections"]
    claim = json.loads(there.read_text()) | {"tolerates": 0.5}
    there.write_text(json.dumps(claim))
    late = run("certify", str(there))
    assert late.exit_code == 1
    assert "left x right: not proven apart when each may be 0.5 s late" in " ".join(late.stdout.split())


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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("none.urdf",), "no such file"),
        (("planar2",), "robot.toml'; expected a URDF, xacro or MJCF file: a robot.toml is one already"),
        (("example-robot-data:ur6",), "unknown robot of example-robot-data 'ur6'; did you mean 'ur3"),
        (("URDF", "--lock", "elbo=0"), "unknown joint 'elbo'; did you mean 'elbow'?"),
        (("URDF", "--lock", "elbow"), "--lock: got 'elbow'; expected joint=value"),
        (("URDF", "--tool-frame", "tipp"), "unknown tool frame 'tipp'"),
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


COMMANDS = "robots,scenes,check,plan,explain,pick-place,view,certify,export,run,import-robot,episodes,serve,doctor"
COMMANDS += (
    ",roadmap build,roadmap query,roadmap info,roadmap update,reachability build,reachability show,reachability place"
)


def test_every_help_has_an_example_that_the_command_accepts() -> None:
    for command in COMMANDS.split(","):
        shown = run(*command.split(), "-h")
        assert shown.exit_code == 0
        (example,) = re.findall(r"Example:\n +planner-service (.*)$", shown.stdout, re.M)
        assert example.startswith(command)
        accepted = run(*shlex.split(example), "--help")  # an unknown option or a missing value would be an error
        assert (accepted.exit_code, accepted.stdout) == (0, shown.stdout)


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


def test_constraints_that_cannot_be_kept_are_bad_input() -> None:
    for options, problem in [
        (("--upright", "0"), "--upright: got 0.0; expected radians in [0.001, 3.142]"),
        (("--upright", "tall"), "Invalid value for '--upright'"),
        (("--upright", "0.1", "--planner", "rrtconnect"), "planner: got RRTConnect"),
        (("--upright", "0.1", "--polish"), "expected None: an optimum does not keep constraints"),
        (("--region", "nowhere.toml"), "nowhere.toml"),
        (("--region", "/dev/zero"), "/dev/zero"),
    ]:
        assert problem in " ".join(refused(*ACROSS, *options).split())


def test_a_broken_file_of_constraints_is_bad_input(tmp_path: Path) -> None:
    file = tmp_path / "region.toml"
    for content in (
        b"\x00\xff" * 50,
        b"a = " + b"[" * 5_000,
        b"[[constraint]]\nkind = 'tool region'\ntilt = 0.1\nname = \"\\u001b[2J\"",
        b"[[constraint]]\nkind = 'tool region'\ntilt = 0.1\n" * 5_000,
    ):
        file.write_bytes(content)
        said = refused(*ACROSS, "--region", file)
        assert "region.toml" in " ".join(said.split())
        assert len(said) < 5_000
        assert "\x1b" not in said


@pytest.mark.parametrize(
    ("module", "extra", "call"),
    [
        ("viser", "view", lambda plan: plan.show(port=0)),
        ("rerun", "rerun", lambda plan: rerun_bytes(PlannerService("planar2", "empty"), plan)),
        ("yaml", "yaml", lambda plan: yaml_text({})),
        ("pyarrow", "episodes", lambda plan: write_episodes("out", EpisodeWork(load_robot("wxai"), BinPickPlace()), 1)),
    ],
)
def test_without_an_optional_package_its_extra_is_named(
    module: str, extra: str, call: Callable[[PlanResult], object], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, "planner_service.view.serving.server", raising=False)
    plan = PlannerService("planar2", "empty").plan(PlanRequest((0.0, 0.0), (0.1, 0.1)))
    with pytest.raises(MissingDependency, match=rf"planner-service\[{extra}\]"):
        call(plan)
    assert list(tmp_path.iterdir()) == []
