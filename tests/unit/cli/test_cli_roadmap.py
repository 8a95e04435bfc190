"""``planner-service roadmap``: what is built, asked, shown and updated, and what is refused."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service.geometry.shapes import Pose
from planner_service.planners import PRM
from planner_service.roadmap import Roadmap, Verdict
from planner_service.scene.loading import load_scene, save_scene
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService
from tests.support import command

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


def test_a_query_that_finds_nothing_ends_with_1_and_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "poor.npz"
    Roadmap.of([[3.0, 3.0]]).save(path)
    result = run("query", path, *ENDS, *PLANAR, "--no-fallback")
    assert result.exit_code == 1
    assert result.stderr.startswith("no plan: PLANNING_FAILED (search)")
    assert document("query", path, *ENDS, *PLANAR, "--no-fallback", code=1)["result"]["path"] is None


def test_a_query_keeps_the_padding_of_the_roadmap_if_no_other_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "wide.npz"
    PlannerService("planar2", "discs").build_roadmap(PRM(milestones=60), padding=0.002).save(path)
    assert document("query", path, *ENDS)["request"]["padding"] == 0.002
    assert document("query", path, *ENDS, "--padding", "0.001")["request"]["padding"] == 0.001


def test_a_query_in_a_changed_scene_says_what_changed_and_how_many_edges_fell(there: Path, moved: Path) -> None:
    words = done("query", there, *ENDS, "--scene", moved)
    assert "note: the roadmap was built for another scene: discs" in words
    assert "lesson_disc changed" in words
    told = document("query", there, *ENDS, "--scene", moved)
    assert f"after the change {told['roadmap']['learned']['again']} edges still free, " in words
    assert f"{told['roadmap']['learned']['fell']} now blocked" in words
    assert told["roadmap"]["learned"]["again"] + told["roadmap"]["learned"]["fell"] > 0
    assert told["result"]["certificate"]["clearance"] > 0.0


def test_less_padding_leaves_known_what_was_free(there: Path) -> None:
    words = done("query", there, *ENDS, "--padding", "0.0005")
    assert "not as the roadmap was built: the padding, 1 mm in the roadmap; free edges stay valid" in words
    words = done("query", there, *ENDS, "--padding", "0.002")
    assert "the padding, 1 mm in the roadmap; edges are checked again where a path needs them" in words


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


def test_info_shows_all_that_the_file_says(there: Path) -> None:
    found, words = Roadmap.load(there), done("info", there)
    assert found.terms is not None
    for text in (
        found.hash,
        f"planar2, {found.terms.robot_hash[:12]}: shoulder, elbow",
        "prm, milestones 60, neighbours 5, max checks 2,000,000, seed 0",
    ):
        assert text in words
    told = document("info", there)
    assert told["terms"]["scene_hash"] == found.terms.scene_hash
    held = sum(array.nbytes for array in found.arrays.values())
    assert told["bytes"]["memory"] == held == told["bytes"]["per_milestone"] * 60


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-200])


def foreign(path: Path) -> None:
    np.savez(path, points=np.zeros((3, 3)), colours=np.ones(3))


def text(path: Path) -> None:
    path.write_text("no archive")


@pytest.mark.parametrize(
    ("command", "spoil", "message"),
    [
        (("query", *ENDS), foreign, "expected an array 'head'"),
        (("info",), cut, "not an NPZ file"),
        (("update",), text, "a file of another kind is there"),  # it would write there
    ],
)
def test_a_file_that_is_no_roadmap_is_bad_input(
    command: tuple[str, ...], spoil: Callable[[Path], None], message: str, there: Path
) -> None:
    spoil(there)
    before = there.read_bytes()
    name, *more = command
    assert message in refused(name, there, *more)
    assert there.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("build", *PLANAR, "--planner", "prn", "--out", "x.npz"), "unknown roadmap planner 'prn'; did you mean"),
        (("build", *PLANAR, "--planner", "prmstar", "--neighbours", "4", "--out", "x.npz"), "no such option with"),
        (("build", *PLANAR, "--milestones", "1", "--out", "x.npz"), "milestones: got 1"),
        (("build", *PLANAR, "--out", "x.json"), "expected a file whose name ends in .npz"),
        (("build", *PLANAR, "--out", "no/such/x.npz"), "cannot be written"),
        (("query", "discs.npz", *ENDS, "--remember"), "expected --learn or --out too"),
        (("query", "discs.npz", *ENDS, "--clearance", "0.01"), "--polish too"),
        (("query", "discs.npz", *ENDS, "--plan", "discs.npz"), "a different file from the roadmap"),
        (("query", "discs.npz", *ENDS, "--robot", "wxai"), "a roadmap of shoulder, elbow'; expected one of"),
        (("update", "discs.npz", "--out", "x.json"), "a file whose name ends in .npz"),
    ],
)
def test_bad_input_says_what_would_be_right_and_writes_nothing(
    arguments: tuple[str, ...], message: str, there: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(there.parent)
    assert message in refused(*arguments)
    assert os.listdir() == ["discs.npz"]


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
