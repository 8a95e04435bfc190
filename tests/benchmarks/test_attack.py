"""The attack campaign finds what is wrong and runs it again; what it once found stays mended."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from benchmarks.attack import cells, kill, running
from benchmarks.attack.domain import described
from benchmarks.attack.harness import Case, Part, Wrong, read_finding
from benchmarks.attack.running import main, replayed, run_part
from benchmarks.attack.words import require_told
from planner_service import InvalidRequest, RRTConnect, Scene, load_robot
from planner_service.scene.loading import scene_text
from planner_service.view.cell.folder import CellFolder

ROOT = Path(__file__).parents[2]
STORED = sorted((ROOT / "tests" / "attack").glob("*.json"))


class Broken(Part):
    """An attack on something that fails in every way, by what is in its case."""

    name = "api"
    what = "nothing"
    limit = 0.3

    def draw(self, rng: np.random.Generator) -> Case:
        return {"items": rng.choice(["fine", "refused", self.bad], 20).tolist()}

    bad = "untyped"

    def run(self, case: Case) -> None:
        for item in case["items"]:
            self.harm(item)

    def harm(self, item: str) -> None:
        if item == "untyped":
            raise KeyError(item)
        if item == "crash":
            os.kill(os.getpid(), signal.SIGKILL)
        if item == "sleep":
            time.sleep(60)
        if item == "root" and os.access("/", os.W_OK):
            raise Wrong("an attacker has no rights")


def of(bad: str) -> Callable[[], Part]:
    return type("Broken", (Broken,), {"bad": bad})


@pytest.mark.parametrize("bad", ["untyped", "crash", "sleep"])
def test_whatever_harm_an_input_does_is_found_and_done_again(bad: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "maker", lambda name: of(bad))
    kind = {"sleep": "hang"}.get(bad, bad)
    summary, (finding, *others) = run_part("api", 3, 5.0, 3)
    assert (finding.kind, others) == (kind, [])
    assert summary.found[kind] >= 1
    assert summary.inputs >= 1
    assert replayed(finding)[0] == kind


def test_a_reader_that_drops_a_word_in_silence_is_found(tmp_path: Path) -> None:
    text = '<robot name="r"><link name="l0"><inertial/></link></robot>'
    robot = load_robot("planar2")
    case = {"words": "urdf", "at": 1, "what": "attribute", "word": "colour", "value": "0"}
    with pytest.raises(Wrong, match="a word that no table lists is reported: urdf: attribute 'colour' in <link>"):
        require_told(case, text, tmp_path / "f.urdf", lambda path: robot)
    other = iter((robot, load_robot("wxai")))
    with pytest.raises(Wrong, match="a word without an effect has none: urdf: attribute 'type' in <link>"):
        require_told({**case, "word": "type"}, text, tmp_path / "f.urdf", lambda path: next(other))


def test_a_scene_that_is_written_elsewhere_or_read_again_as_another_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    part, edit = cells.Attack(), ["add", "box", [0.3, 0.0]]
    assert part.run({"edits": [edit, ["save", "mine", True], ["save", "../mine", True], ["save", "link", True]]}) == 4
    assert part.counted == {"done": 2, "refused": 2}
    monkeypatch.setattr(CellFolder, "target", lambda self, name: self.path / name)
    monkeypatch.setattr(CellFolder, "save", lambda self, scene, name, replace: _saved(scene, self.target(name)))
    with pytest.raises(Wrong, match="nothing is written outside of the folder"):
        part.run({"edits": [edit, ["save", "link.toml", True]]})
    monkeypatch.setattr(CellFolder, "save", lambda self, scene, name, replace: _saved(Scene(), self.path / "a.toml"))
    with pytest.raises(Wrong, match="what is saved is the scene, in the folder"):
        part.run({"edits": [edit, ["save", "mine", True]]})


def _saved(scene: Scene, path: Path) -> Path:
    path.write_text(scene_text(scene))
    return path


def test_a_process_that_ctrl_c_crashes_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kill, "_planners", lambda: {"RRTConnect": RRTConnect()})
    part = kill.Attack()
    case = {"what": "planner", "planner": "RRTConnect", "when": 0.5, "number": 0}
    part.run(case)
    assert part.counted["RRTConnect interrupted"] == 1
    monkeypatch.setattr(kill, "digest", lambda result: object())
    with pytest.raises(Wrong, match="after Ctrl-C a plan is the same: RRTConnect"):
        part.run(case)
    monkeypatch.setattr(kill, "gc", SimpleNamespace(collect=lambda: os.kill(os.getpid(), signal.SIGKILL)))
    with pytest.raises(Wrong, match="Ctrl-C ends no process with a crash: RRTConnect: signal 9"):
        part.run(case)


def test_findings_are_stored_and_replayed_by_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(running, "maker", lambda name: of("untyped"))
    arguments = ["api", "--minutes", "0.05", "--inputs", "3", "--out", str(tmp_path)]
    assert main(arguments, Console(width=200)) == 1
    file = tmp_path / "finding-api-0.json"
    assert "untyped" in read_finding(file).case["items"]
    assert main(["replay", str(file)], Console(width=200)) == 1
    assert main(["table", str(tmp_path)], Console(width=200)) == 0
    assert "api" in capsys.readouterr().out
    with pytest.raises(InvalidRequest, match="no stored finding"):
        main(["replay", str(ROOT / "README.md")], Console(width=200))


def test_what_was_found_once_does_no_harm_any_more() -> None:
    told = {file.name: replayed(read_finding(file)) for file in STORED}
    assert {name: how for name, how in told.items() if how[0] not in ("passed", "refused")} == {}


def test_the_limitations_state_the_domain_that_is_drawn_from() -> None:
    text = (ROOT / "docs/explanation/limitations.md").read_text("utf-8")
    inside = text.split("<!-- domain: begin -->")[1].split("<!-- domain: end -->")[0]
    assert inside.strip() == described().strip()
