"""``planner-service roadmap``: what is built, asked, shown and updated, and what is refused."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from planner_service.cli.commands import app
from planner_service.collision import MotionStep
from planner_service.geometry.shapes import Pose, Sphere
from planner_service.planners import PLANNERS, PRM
from planner_service.records.plan_file import load_plan
from planner_service.roadmap import Roadmap, RoadmapReference, Verdict
from planner_service.scene.loading import load_scene, save_scene
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from tests.support import command
from tests.support.optional import present

PLANAR = ("--robot", "planar2", "--scene", "discs")
SMALL = ("--milestones", "60", "--neighbours", "5")
ENDS = ("--start", "lesson_start", "--goal", "lesson_goal", "--time-limit", "inf")


run = partial(command.run, "roadmap")
document = partial(command.document, "roadmap")
refused = partial(command.refused, "roadmap")


def done(*arguments: str | Path, columns: int = 100) -> str:
    """What a command that ends well prints, its lines joined."""
    result = run(*arguments, columns=columns)
    assert result.exit_code == 0, result.output
    return " ".join(result.stdout.split())


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("built") / "discs.npz"
    PlannerService("planar2", "discs").build_roadmap(PRM(milestones=60, neighbours=5)).save(path)
    return path.read_bytes()


@pytest.fixture
def there(built: bytes, tmp_path: Path) -> Path:
    """A roadmap of planar2 in discs."""
    path = tmp_path / "discs.npz"
    path.write_bytes(built)
    return path


@pytest.fixture
def moved(tmp_path: Path) -> Path:
    """The scene discs with one of them moved."""
    path = tmp_path / "moved.toml"
    save_scene(load_scene("discs").moved("lesson_disc", Pose((1.0, 0.7, 0.0))), path)
    return path


def test_what_is_built_is_what_the_library_builds(tmp_path: Path) -> None:
    path = tmp_path / "new.npz"
    asked = ("build", *PLANAR, *SMALL, "--seed", "3", "--padding", "0.002", "--max-checks", "900000", "--out", path)
    told = document(*asked)
    grower = PRM(milestones=60, neighbours=5, max_checks=900_000)
    expected = PlannerService("planar2", "discs").build_roadmap(grower, seed=3, padding=0.002)
    assert Roadmap.load(path).hash == expected.hash == told["hash"]
    assert told["built"]["counts"]["states"] == expected.built.counts.states  # type: ignore[union-attr]
    assert told["edges"]["free"] == expected.edge_knowledge.count(Verdict.FREE)
    assert told["bytes"]["file"] == path.stat().st_size


def test_a_build_prints_what_is_in_it_and_what_it_cost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = done("build", *PLANAR, *SMALL, "--out", "new.npz")
    found = Roadmap.load("new.npz")
    assert "built: planar2 in discs, written to new.npz" in words
    assert "milestones 60: 60 free, 0 blocked, 0 unknown" in words
    free, blocked = (found.edge_knowledge.count(v) for v in (Verdict.FREE, Verdict.BLOCKED))
    assert f"edges {len(found.edges)}: {free} free, {blocked} blocked, 0 unknown" in words
    assert f"cost {present(found.built).counts.states:,} states, {len(found.edges)} edges" in words


@pytest.mark.parametrize(("name", "verdict"), [("PRMstar", "free"), ("lazyprm", "unknown")])
def test_roadmaps_are_grown_by_the_planner_that_is_named(name: str, verdict: str, tmp_path: Path) -> None:
    told = document("build", *PLANAR, "--planner", name, "--milestones", "30", "--out", tmp_path / "new.npz")
    assert told["built"]["planner"] == name.lower()
    assert told["milestones"][verdict] == told["milestones"]["count"] == 30


def test_a_build_that_ends_at_its_limit_says_so(tmp_path: Path) -> None:
    words = done("build", *PLANAR, "--milestones", "5000", "--max-checks", "2000", "--out", tmp_path / "new.npz")
    assert "note the build ended at --max-checks with" in words


def test_parts_that_no_edge_joins_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "parts.npz"
    Roadmap.judged([[0.0], [1.0], [2.0], [3.0], [4.0]], [(0, 1), (1, 2), (3, 4)], {(2, 3): None}).save(path)
    assert document("info", path)["components"] == {"count": 2, "largest": 3}
    assert "2 components, the largest of 3" in done("info", path)


def test_a_query_is_printed_as_a_plan_and_adds_up(there: Path) -> None:
    result = run("query", there, *ENDS)
    assert result.exit_code == 0
    head, *rows = result.stdout[: result.stdout.index("motion:")].splitlines()
    assert head.startswith("planned: planar2 in discs, lesson_start -> lesson_goal, over ")
    numbers = [row.split()[-4:-1] for row in rows if row.split()[-1].replace(".", "").isdigit()]
    *parts, total = [[int(word.replace(",", "")) for word in row] for row in numbers]
    assert [sum(column) for column in zip(*parts, strict=True)] == total
    assert "roadmap: 60 milestones" in result.stdout
    assert "proof:" in result.stdout


def test_what_a_query_finds_is_optimised_if_asked(there: Path) -> None:
    assert document("query", there, *ENDS, "--polish", "--clearance", "0.01")["result"]["polish"]["kept"]
    assert "--polish too" in refused("query", there, *ENDS, "--clearance", "0.01")


def test_a_query_leaves_the_file_alone_unless_it_is_asked_to_learn(there: Path) -> None:
    before = there.read_bytes()
    path = there.with_name("lazy.npz")
    done("build", *PLANAR, *SMALL, "--planner", "lazyprm", "--out", path)
    unjudged = path.read_bytes()
    assert "not saved, as --learn was not given" in done("query", path, *ENDS)
    assert path.read_bytes() == unjudged
    done("query", there, *ENDS)
    assert there.read_bytes() == before


@pytest.mark.slow
def test_what_was_learned_is_written_back_and_need_not_be_judged_again(tmp_path: Path) -> None:
    path = tmp_path / "lazy.npz"
    done("build", *PLANAR, *SMALL, "--planner", "lazyprm", "--out", path)
    first = document("query", path, *ENDS, "--learn")
    assert first["roadmap"]["learned"]["free"] > 0
    assert first["roadmap"]["written"] == str(path)
    assert Roadmap.load(path).hash == first["roadmap"]["learned_hash"] != first["roadmap"]["hash"]
    second = document("query", path, *ENDS)

    def searched(found: Any) -> int:
        states: int = next(s["states"] for s in found["result"]["stages"] if s["stage"] == "search")
        return states

    assert searched(second) < searched(first)
    assert "learned: nothing new" in done("query", path, *ENDS)
    copy = tmp_path / "copy.npz"
    assert "nothing new; written to" in done("query", path, *ENDS, "--out", copy)
    assert Roadmap.load(copy).hash == Roadmap.load(path).hash


def test_a_path_that_is_remembered_costs_the_next_search_nothing(there: Path, tmp_path: Path) -> None:
    out = tmp_path / "more.npz"
    before = there.read_bytes()
    told = document("query", there, *ENDS, "--remember", "--out", out)
    assert told["roadmap"]["learned"]["milestones"] > 0
    assert there.read_bytes() == before
    again = document("query", out, *ENDS)
    assert [s["states"] for s in again["result"]["stages"] if s["stage"] == "search"] == [0]
    assert not Roadmap.load(out).remember, "that was asked of one query"


def test_a_query_that_finds_nothing_ends_with_1_and_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "poor.npz"
    Roadmap.of([[3.0, 3.0]]).save(path)
    result = run("query", path, *ENDS, *PLANAR, "--no-fallback")
    assert result.exit_code == 1
    assert result.stderr.startswith("no plan: PLANNING_FAILED (search)")
    assert document("query", path, *ENDS, *PLANAR, "--no-fallback", code=1)["result"]["path"] is None


def test_where_a_roadmap_has_no_path_another_planner_is_asked(tmp_path: Path) -> None:
    path = tmp_path / "poor.npz"
    Roadmap.of([[3.0, 3.0]]).save(path)
    assert "no path there: balancedrrtconnect" in done("query", path, *ENDS, *PLANAR)


def test_a_plan_over_a_roadmap_is_kept_with_its_hash(there: Path, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    told = document("query", there, *ENDS, "--plan", path)
    saved = load_plan(path)
    assert saved.result.ok
    assert present(saved.request).planner == RoadmapReference(Roadmap.load(there).hash)
    assert told["request"] == json.loads(path.read_text())["request"]


def test_settings_reach_the_request(there: Path) -> None:
    told = document("query", there, *ENDS, "--seed", "7", "--max-checks", "9999", "--timing", "s-curve", "--blend", "0")
    asked = told["request"]
    assert (asked["seed"], asked["max_checks"], asked["blend"], asked["time_limit"]) == (7, 9999, 0.0, None)
    assert asked["timing"]["name"] == "s-curve"


def test_a_query_keeps_the_padding_of_the_roadmap_if_no_other_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "wide.npz"
    PlannerService("planar2", "discs").build_roadmap(PRM(milestones=60), padding=0.002).save(path)
    assert document("query", path, *ENDS)["request"]["padding"] == 0.002
    assert document("query", path, *ENDS, "--padding", "0.001")["request"]["padding"] == 0.001


def test_a_place_for_the_roadmap_is_asked_for_before_anything_is_done() -> None:
    assert "cannot be written" in refused("build", "--scene", "?", "--out", "no/such/x.npz")
    assert "cannot be written" in refused("query", "?", *ENDS, "--learn", "--out", "no/such/x.npz")
    assert "cannot be written" in refused("update", "?", "--out", "no/such/x.npz")


def test_a_query_in_a_changed_scene_says_what_changed_and_how_many_edges_fell(there: Path, moved: Path) -> None:
    words = done("query", there, *ENDS, "--scene", moved)
    assert "note: the roadmap was built for another scene: discs" in words
    assert "lesson_disc changed" in words
    told = document("query", there, *ENDS, "--scene", moved)
    assert f"after the change {told['roadmap']['learned']['again']} edges still free, " in words
    assert f"{told['roadmap']['learned']['fell']} now blocked" in words
    assert told["roadmap"]["learned"]["again"] + told["roadmap"]["learned"]["fell"] > 0
    assert told["result"]["certificate"]["clearance"] > 0.0


def test_what_came_and_what_went_is_told_by_name(there: Path, tmp_path: Path) -> None:
    path = tmp_path / "other.toml"
    ball = Obstacle("ball", Sphere(0.05), Pose((-1.2, 0.2, 0.0)))
    save_scene(load_scene("discs").without("far_disc").with_obstacle(ball), path)
    assert "ball added; far_disc removed" in done("query", there, *ENDS, "--scene", path)


def test_less_padding_leaves_known_what_was_free(there: Path) -> None:
    words = done("query", there, *ENDS, "--padding", "0.0005")
    assert "not as the roadmap was built: the padding, 1 mm in the roadmap; free edges stay valid" in words
    words = done("query", there, *ENDS, "--padding", "0.002")
    assert "the padding, 1 mm in the roadmap; edges are checked again where a path needs them" in words


def test_other_sampling_than_the_roadmaps_is_said(tmp_path: Path) -> None:
    path = tmp_path / "coarse.npz"
    service = PlannerService("planar2", "discs", edge_step=MotionStep(0.02))
    service.build_roadmap(PRM(milestones=60, neighbours=5)).save(path)
    assert "not as the roadmap was built: the sampling of edges" in done("query", path, *ENDS)


def test_an_update_judges_again_what_a_change_may_have_touched_and_nothing_else(there: Path, moved: Path) -> None:
    before = Roadmap.load(there)
    words = done("update", there, "--scene", moved)
    after = Roadmap.load(there)
    expected = PlannerService("planar2", load_scene(moved)).update_roadmap(before)
    assert after.hash == expected.roadmap.hash
    assert " ".join(str(expected).split()) in words
    assert expected.fell > 0 < expected.kept
    assert after.pending == ()
    again = done("update", there, "--scene", moved)
    assert "nothing to update, the file is unchanged" in again


def test_an_update_can_go_to_another_file_and_be_read_by_machines(there: Path, moved: Path, tmp_path: Path) -> None:
    out, before = tmp_path / "new.npz", there.read_bytes()
    told = document("update", there, "--scene", moved, "--out", out)
    assert told["update"]["changed"] == ["lesson_disc"]
    assert told["hash"] == Roadmap.load(out).hash
    assert told["edges"]["free_before"] == told["edges"]["blocked_before"] == 0
    assert there.read_bytes() == before


def test_what_is_in_doubt_is_shown(there: Path, moved: Path, tmp_path: Path) -> None:
    out = tmp_path / "lazy.npz"
    done("query", there, *ENDS, "--scene", moved, "--learn", "--out", out)
    words = done("info", out)
    assert "to update lesson_disc changed" in words
    assert "free before" in words
    done("update", out, "--scene", moved)
    assert "free before" not in done("info", out)


def test_info_shows_all_that_the_file_says(there: Path) -> None:
    found, words = Roadmap.load(there), done("info", there)
    assert found.terms is not None
    for text in (
        found.hash,
        f"planar2, {found.terms.robot_hash[:12]}: shoulder, elbow",
        f"discs, {found.terms.scene_hash[:12]}: back_disc, far_disc, lesson_disc, low_disc",
        "1 mm of padding",
        "prm, milestones 60, neighbours 5, max checks 2,000,000, seed 0",
        "bytes per milestone",
        "BalancedRRTConnect searches if the roadmap has no path",
    ):
        assert text in words
    told = document("info", there)
    assert told["terms"]["scene_hash"] == found.terms.scene_hash
    held = sum(array.nbytes for array in found.arrays.values())
    assert told["bytes"]["memory"] == held == told["bytes"]["per_milestone"] * 60


@pytest.mark.parametrize("columns", [40, 120])
def test_no_line_is_wider_than_the_terminal(columns: int, there: Path, moved: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(there.parent)
    for arguments in (
        ("build", *PLANAR, *SMALL, "--out", "new.npz"),
        ("query", "discs.npz", *ENDS, "--scene", "moved.toml", "--learn", "--out", "lazy.npz"),
        ("update", "discs.npz", "--scene", "moved.toml"),
        ("info", "lazy.npz"),
    ):
        lines = run(*arguments, columns=columns).stdout.splitlines()
        assert max(map(len, lines)) <= min(columns, 100)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-200])


def foreign(path: Path) -> None:
    np.savez(path, points=np.zeros((3, 3)), colours=np.ones(3))


def older(path: Path) -> None:
    text = json.dumps({"format": "planner-service/roadmap", "version": 0}).encode()
    np.savez(path, head=np.frombuffer(text, dtype=np.uint8))


def text(path: Path) -> None:
    path.write_text("no archive")


@pytest.mark.parametrize(
    ("command", "spoil", "message"),
    [
        (("query", *ENDS), foreign, "expected an array 'head'"),
        (("query", *ENDS), older, "version 0; this package reads version 1"),
        (("info",), cut, "not an NPZ file"),
        (("info",), Path.unlink, "no such file"),
        (("update",), cut, "not an NPZ file"),
        (("update",), text, "a file of another kind is there"),  # it would write there
    ],
)
def test_a_file_that_is_no_roadmap_is_bad_input(
    command: tuple[str, ...], spoil: Callable[[Path], None], message: str, there: Path
) -> None:
    spoil(there)
    name, *more = command
    assert message in refused(name, there, *more)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("build", "--scene", "tabel", "--out", "x.npz"), "unknown scene 'tabel'; did you mean 'table'?"),
        (("build", *PLANAR, "--planner", "prn", "--out", "x.npz"), "unknown roadmap planner 'prn'; did you mean"),
        (("build", *PLANAR, "--planner", "rrtconnect", "--out", "x.npz"), "available: lazyprm, prm, prmstar"),
        (
            ("build", *PLANAR, "--planner", "prmstar", "--neighbours", "4", "--out", "x.npz"),
            "no such option with prmstar",
        ),
        (("build", *PLANAR, "--planner", "lazyprm", "--max-checks", "4", "--out", "x.npz"), "--max-checks: got 4"),
        (("build", *PLANAR, "--milestones", "1", "--out", "x.npz"), "milestones: got 1"),
        (("build", *PLANAR, "--padding", "nan", "--out", "x.npz"), "padding: got nan"),
        (("build", *PLANAR, "--seed", "-1", "--out", "x.npz"), "seed: got -1"),
        (("build", *PLANAR, "--out", "x.json"), "expected a file whose name ends in .npz"),
        (("build", *PLANAR, "--out", "no/such/x.npz"), "cannot be written"),
        (("build", *PLANAR), "Missing option '--out'"),
        (("query", "discs.npz", *ENDS, "--remember"), "expected --learn or --out too"),
        (("query", "discs.npz", *ENDS, "--learn", "--out", "x.json"), "a file whose name ends in .npz"),
        (("query", "discs.npz", *ENDS, "--plan", "discs.npz"), "a different file from the roadmap"),
        (("query", "discs.npz", *ENDS, "--plan", "no/such.json"), "cannot be written"),
        (("query", "discs.npz", *ENDS, "--robot", "wxai"), "a roadmap of shoulder, elbow'; expected one of"),
        (("query", "discs.npz", "--start", "0,0,0", "--goal", "home"), "--start: got 3 values (0,0,0); expected 2"),
        (("query", "discs.npz", *ENDS, "--padding", "-1"), "padding: got -1.0"),
        (("query", "discs.npz", *ENDS, "--scene", "moved"), "unknown scene 'moved'"),
        (("update", "discs.npz", "--out", "x.json"), "a file whose name ends in .npz"),
        (("forget", "discs.npz"), "No such command 'forget'"),
    ],
)
def test_bad_input_says_what_would_be_right_and_writes_nothing(
    arguments: tuple[str, ...], message: str, there: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(there.parent)
    assert message in refused(*arguments)
    assert os.listdir() == ["discs.npz"]


@pytest.mark.parametrize("spoil", [text, cut], ids=["text", "cut"])
def test_a_file_that_is_no_roadmap_is_not_replaced(spoil: Callable[[Path], None], there: Path) -> None:
    spoil(there)
    before = there.read_bytes()
    refused("query", there, *ENDS, "--learn")
    refused("update", there)
    assert there.read_bytes() == before


def judged_for(robot: str, scene: Scene, path: Path) -> Path:
    PlannerService(robot, scene).build_roadmap(PRM(milestones=5, neighbours=2)).save(path)
    return path


def test_a_name_in_the_file_that_means_another_scene_now_is_refused(tmp_path: Path) -> None:
    mine = load_scene("discs").without("far_disc")
    path = judged_for("planar2", mine, tmp_path / "mine.npz")
    for words in (("query", path, *ENDS), ("update", path)):
        message = refused(*words)
        assert (
            "--scene: got 'discs'; expected the file of the scene that the roadmap was built for: this one differs"
            in (message)
        )
    assert "far_disc added" in done("query", path, *ENDS, "--scene", "discs")


def test_a_name_in_the_file_that_nothing_has_is_refused(tmp_path: Path) -> None:
    path = judged_for("planar2", Scene(name="cell_7"), tmp_path / "mine.npz")
    message = refused("query", path, *ENDS)
    assert "--scene: got 'cell_7'; expected the file of the scene that the roadmap was built for" in message


def test_a_roadmap_that_was_put_together_needs_to_be_told_its_robot_and_scene(tmp_path: Path) -> None:
    path = tmp_path / "plain.npz"
    Roadmap.of([[0.0, 0.0], [1.0, -1.0]], [(0, 1)]).save(path)
    assert "--robot: got None; expected a name: the file does not say" in refused("query", path, *ENDS)
    message = refused("query", path, *ENDS, "--robot", "wxai", "--scene", "bin")
    assert "got 'a roadmap of 2 joints'; expected one of joint_0" in message
    assert "assembled by hand" in done("info", path)
    assert "planned:" in done("query", path, *ENDS, *PLANAR)


def test_an_interrupted_build_ends_with_130_and_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command.interrupt_growing(monkeypatch, PRM)
    many = ("--milestones", "20000", "--max-checks", "2000000000")
    result = run("build", "--scene", "bin", *many, "--out", tmp_path / "x.npz")
    assert (result.exit_code, result.output) == (130, "")
    assert list(tmp_path.iterdir()) == []


def test_plan_offers_no_planner_that_is_a_roadmap() -> None:
    assert "roadmap" not in PLANNERS
    result = CliRunner().invoke(app, ["plan", "--robot", "planar2", "--scene", "discs", *ENDS, "--planner", "roadmap"])
    assert result.exit_code == 2
    assert "unknown planner 'roadmap'" in result.stderr
