"""Peers: their input, their answers, and what is reported where they cannot run."""

from __future__ import annotations

import ast
import json
import os
import re
import sys
import time
import xml.etree.ElementTree as ElementTree
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from benchmarks.baselines.peers import running
from benchmarks.baselines.peers.adapter_protocol import matrix_of
from benchmarks.baselines.peers.catalogue import PEERS, peer_named
from benchmarks.baselines.peers.child import Child, Reply
from benchmarks.baselines.peers.environments import Environment
from benchmarks.baselines.peers.jobs import Task, job_of, placed_robot
from benchmarks.baselines.peers.running import Run, row_of, tasks_of
from benchmarks.harness.sources import Motion
from planner_service import Box, Capsule, Cylinder, Mesh, Obstacle, Pose, Robot, Scene, Sphere, load_robot
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.shapes import Shape

ROOT = Path(__file__).parents[2]
ADAPTERS = sorted((ROOT / "benchmarks" / "baselines" / "peers").glob("*_adapter.py"))

FAKE = """
import os, signal, sys, time
from benchmarks.baselines.peers.adapter_protocol import serve

class Fake:
    def __init__(self, job):
        print("noise while loading")
        if job["settings"].get("broken"):
            raise RuntimeError("no such robot")
        self.job = job

    def solve(self, problem, seed, answer):
        name, begun = problem["problem"], time.monotonic()
        if name == "noisy":
            print("noise on the answers' channel")
            os.write(1, b"and below Python\\n")
        if name == "raises":
            raise ValueError("cannot do cones")
        if name == "crashes":
            print("about to fall", flush=True)
            os.kill(os.getpid(), signal.SIGSEGV)
        if name == "hangs":
            with open("hanging.pid", "w") as file:
                file.write(str(os.getpid()))
            time.sleep(600)
        with answer.stage("search"):
            answer.raw = [problem["start"], problem["start"], problem["goals"][0]]
        answer.checks["search"] = 7
        answer.seconds["setup"] = begun
        answer.waypoints = [problem["start"], problem["goals"][0]]

serve(("numpy",), Fake)
"""


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_robot("panda_mbm")


def motion(name: str = "near/0", obstacles: tuple[Obstacle, ...] = ()) -> Motion:
    """From home a little to the side."""
    home = load_robot("panda_mbm").home
    return Motion(name, "near", "panda_mbm", Scene(obstacles=obstacles), home, (home + 0.1,))


def fake(tmp_path: Path, script: str = FAKE, seconds: float = 60.0) -> Child:
    (tmp_path / "fake.py").write_text(script, "utf-8")
    return Child((sys.executable, str(tmp_path / "fake.py")), dict(os.environ), tmp_path, problem_seconds=seconds)


def job(*names: str, **settings: Any) -> dict[str, Any]:
    problems = [{"problem": name, "seed": 0, "start": [0.0], "goals": [[1.0]], "obstacles": []} for name in names]
    return {"version": 1, "robot": {}, "settings": settings, "time_limit": 1.0, "problems": problems}


# --- whatever a peer does, each problem has a reply


def test_what_a_peer_prints_does_not_get_among_its_answers(tmp_path: Path) -> None:
    replies = list(fake(tmp_path).replies(job("good", "noisy")))
    assert [reply.failure for reply in replies] == [None, None]
    assert replies[1].answer is not None
    assert replies[1].answer["waypoints"] == [[0.0], [1.0]]
    assert replies[1].versions == {"numpy": np.__version__}
    assert "noise" in (tmp_path / "stderr.txt").read_text("utf-8")


def test_a_problem_is_begun_when_its_reply_is_asked_for(tmp_path: Path) -> None:
    replies = fake(tmp_path).replies(job("good", "good"))
    next(replies)
    time.sleep(0.2)
    asked, second = time.monotonic(), next(replies).answer
    assert second is not None
    assert second["seconds"]["setup"] > asked


def test_an_exception_is_the_answer_to_its_problem_alone(tmp_path: Path) -> None:
    first, second = fake(tmp_path).replies(job("raises", "good"))
    assert first.answer is not None
    assert second.answer is not None
    assert first.answer["error"] == "ValueError: cannot do cones"
    assert first.answer["waypoints"] is None
    assert second.answer["error"] == ""


def test_a_crash_is_told_with_what_was_printed_last_and_the_rest_goes_on(tmp_path: Path) -> None:
    replies = list(fake(tmp_path).replies(job("good", "crashes", "good")))
    assert [reply.failure for reply in replies] == [None, "crashed", None]
    assert replies[1].detail == "ended by SIGSEGV; last printed: about to fall"


def test_who_hangs_is_ended_and_the_rest_goes_on(tmp_path: Path) -> None:
    replies = list(fake(tmp_path, seconds=2.0).replies(job("hangs", "good")))
    assert [reply.failure for reply in replies] == ["hung", None]
    assert replies[0].detail.startswith("silent for 2 s, ended")
    assert replies[0].waited >= 2.0
    pid = int((tmp_path / "hanging.pid").read_text("utf-8"))
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("gibberish", "said b'gibberish\\n', which is no answer"),
        ("[1, 2]", "said b'[1, 2]\\n'"),
        ('{"problem": "other", "seed": 0}', "instead of p"),
        ('{"problem": "p", "seed": 0, "cpu_seconds": NaN}', "which is no answer"),
    ],
)
def test_what_is_no_answer_is_told(tmp_path: Path, said: str, why: str) -> None:
    script = f"print('{{\"ready\": {{}}}}')\nprint({said!r}, flush=True)\nimport time\ntime.sleep(600)\n"
    (reply,) = fake(tmp_path, script).replies(job("p"))
    assert reply.failure == "garbled"
    assert why in reply.detail


# --- rows


def run_of(*motions: Motion) -> Run:
    peer = PEERS["ompl-coal"]
    return Run(peer, "rrtconnect", "near", load_robot("panda_mbm"), tuple(Task(each, 0) for each in motions))


def replied(problem: Motion, **answer: Any) -> Reply:
    said = {"cpu_seconds": 0.5, "seconds": {"setup": 9.0, "search": 0.25, "shortcut": 0.5}, "checks": {"search": 7}}
    path = [problem.start.tolist(), problem.goals[0].tolist()]
    told = {"problem": problem.id, "seed": 0, "waypoints": path, "raw": path, **said, **answer}
    return Reply({"problem": problem.id, "seed": 0}, told, {"ompl": "2.0.1"})


def test_a_free_path_is_a_row() -> None:
    problem = motion()
    row = row_of(run_of(problem), replied(problem), problem)
    assert (row["ok"], row["failure"], row["total_seconds"], row["cpu_seconds"]) == (True, None, 0.75, 0.5)
    assert row["checks"] == {"search": {"states": 7, "edges": 0, "distances": 0}}
    assert row["length"] == row["raw_length"] == pytest.approx(0.1 * 7**0.5)
    assert row["audit"] == {"step": 0.005, "verdict": "free", "depth": None, "pair": None}


def test_a_path_into_something_is_refused_with_who_and_how_deep() -> None:
    problem = motion(obstacles=(Obstacle("cloud", Box((4.0, 4.0, 0.2)), Pose((0.0, 0.0, 0.6))),))
    row = row_of(run_of(problem), replied(problem), problem)
    assert row["ok"]
    assert row["audit"]["verdict"] == "colliding"
    assert "cloud" in row["audit"]["pair"]
    assert row["audit"]["depth"] > 0.01


def test_a_motion_that_leaves_its_free_path_is_refused() -> None:
    problem = motion()
    away = problem.start + np.array([0.0, 0.0, 0.0, 2.6, 0.0, 0.0, 0.0])  # the elbow past its end
    samples = [problem.start.tolist(), away.tolist(), problem.goals[0].tolist()]
    answer = {"times": [0.0, 1.0, 2.0], "samples": samples, "velocities": [[0.0] * 7, [4.35] * 7, [0.0] * 7]}
    row = row_of(run_of(problem), replied(problem, **answer), problem)
    assert row["audits"]["path"]["verdict"] == "free"
    assert row["audits"]["motion"]["verdict"] == row["audit"]["verdict"] == "outside_limits"
    assert row["audit"]["pair"] == ["panda_joint4", "limit"]
    assert row["duration"] == 2.0
    assert row["peaks"] == {"velocity": 2.0, "acceleration": None, "jerk": None}


@pytest.mark.parametrize(("end", "failure"), [(0, "wrong_start"), (-1, "wrong_goal")])
def test_a_path_from_or_to_elsewhere_is_a_failure(end: int, failure: str) -> None:
    problem = motion()
    path = [problem.start.tolist(), problem.goals[0].tolist()]
    path[end][3] += 0.01
    row = row_of(run_of(problem), replied(problem, waypoints=path), problem)
    assert (row["ok"], row["failure"]) == (False, failure)
    assert "0.01 rad" in row["detail"]


def test_no_path_is_a_row_with_its_reason() -> None:
    problem = motion()
    row = row_of(run_of(problem), replied(problem, waypoints=None, error="Timeout"), problem)
    assert (row["ok"], row["failure"], row["detail"]) == (False, "no_path", "Timeout")
    assert row["audit"]["verdict"] == "not_asked"


def test_what_is_no_path_of_this_robot_is_none() -> None:
    for path in [[[0.0]], "x", [], [[float("inf")] * 7], [[0.0] * 7, [0.0]]]:
        problem = motion()
        assert row_of(run_of(problem), replied(problem, waypoints=path), problem)["failure"] == "no_path"


def installed(environment: Environment, **changes: Any) -> None:
    """Write down that an environment is there."""
    environment.folder.mkdir(exist_ok=True)
    state = {"state": "installed", "requirements": list(environment.peer.requirements)} | changes
    (environment.folder / "state.json").write_text(json.dumps(state), "utf-8")


# --- jobs


def test_a_job_has_the_robots_files_with_its_own_limits_and_pairs(panda: Robot, tmp_path: Path) -> None:
    placed = placed_robot(panda, tmp_path)
    limit = ElementTree.parse(placed["urdf"]).find("./joint[@name='panda_joint1']/limit")
    assert limit is not None
    assert float(limit.get("velocity", "0")) == panda.limits.velocity[0] == placed["velocity"][0]
    disabled = ElementTree.parse(placed["srdf"]).findall("disable_collisions")
    pairs = {frozenset((each.get("link1"), each.get("link2"))) for each in disabled}
    assert pairs == {frozenset(contact.links) for contact in panda.allowed_contacts}
    assert pairs == {frozenset(pair) for pair in placed["disabled_pairs"]}
    meshes = {mesh.get("filename") for mesh in ElementTree.parse(placed["urdf"]).iter("mesh")}
    assert all((tmp_path / str(mesh)).is_file() for mesh in meshes)


def test_a_job_is_json_with_every_shape_a_peer_may_know(tmp_path: Path) -> None:
    shapes: tuple[Shape, ...] = (Box((1.0, 2.0, 3.0)), Sphere(0.1), Cylinder(0.1, 0.5), Capsule(0.2, 0.6))
    turned = Pose((1.0, 2.0, 3.0), (0.5, 0.5, 0.5, 0.5))
    problem = motion(obstacles=tuple(Obstacle(f"o{k}", shape, turned) for k, shape in enumerate(shapes)))
    made = job_of(PEERS["ompl-coal"], "rrtconnect", {}, [Task(problem, 3)], 5.0)
    (told,) = json.loads(json.dumps(made))["problems"]
    assert [body["kind"] for body in told["obstacles"]] == ["box", "sphere", "cylinder", "capsule"]
    pose = {"position": [1.0, 2.0, 3.0], "quaternion_wxyz": [0.5, 0.5, 0.5, 0.5]}
    assert told["obstacles"][2] == {"name": "o2", "kind": "cylinder", "radius": 0.1, "length": 0.5} | pose
    assert (told["problem"], told["seed"], made["settings"]) == ("near/0", 3, {"range": 0.5, "step": 0.05})
    assert np.allclose(matrix_of(told["obstacles"][2]), turned.matrix)


def test_what_no_job_can_hold_is_refused_by_name() -> None:
    hull = Mesh(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    problem = motion(obstacles=(Obstacle("hull", hull),))
    with pytest.raises(InvalidRequest, match="obstacle hull"):
        job_of(PEERS["ompl-coal"], "rrtconnect", {}, [Task(problem, 0)], 5.0)


def test_robots_with_joints_that_stand_still_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="all of whose joints are planned with"):
        placed_robot(load_robot("wxai"), tmp_path)
    with pytest.raises(InvalidRequest, match="in its own folder"):
        placed_robot(load_robot("ur5"), tmp_path)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(UnknownName, match="did you mean 'ompl-coal'"):
        peer_named("ompl_coal")
    with pytest.raises(InvalidRequest, match="one of rrtconnect of ompl-coal"):
        job_of(PEERS["ompl-coal"], "prm", {}, [], 1.0)
    with pytest.raises(InvalidRequest, match="motions of one robot"):
        tasks_of("smoke", range(1))


# --- adapters


def imported(source: Path) -> set[str]:
    """The modules that a file imports."""
    nodes = list(ast.walk(ast.parse(source.read_text("utf-8"))))
    names = {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    return names | {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}


def test_adapters_import_the_peer_and_nothing_of_ours_but_how_to_talk() -> None:
    for source in ADAPTERS:
        names = imported(source) - {source.stem.removesuffix("_adapter")}
        ours = {name for name in names if name.partition(".")[0] in ("planner_service", "benchmarks", "tests")}
        assert ours == {"benchmarks.baselines.peers.adapter_protocol"}


def test_how_to_talk_needs_the_standard_library_alone() -> None:
    names = imported(ROOT / "benchmarks" / "baselines" / "peers" / "adapter_protocol.py")
    assert {name.partition(".")[0] for name in names} <= sys.stdlib_module_names


def test_every_peer_is_pinned_and_has_an_adapter() -> None:
    for peer in PEERS.values():
        assert all(re.fullmatch(r"[\w-]+==[\d.]+", each) for each in peer.requirements)
        assert (ROOT / (peer.adapter.replace(".", "/") + ".py")) in ADAPTERS
        assert peer.planners


# --- environments


def script(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n", "utf-8")
    path.chmod(0o755)
    return path


def test_an_installation_that_fails_says_why_from_then_on(tmp_path: Path) -> None:
    broken = script(tmp_path / "python", "echo 'Collecting things'; echo 'error: no compiler' >&2; exit 1")
    environment = Environment.of(PEERS["ompl-coal"], tmp_path / "peers")
    assert environment.state == "not installed"
    assert environment.install(broken) == "venv failed: error: no compiler"
    assert environment.state == "venv failed: error: no compiler"
    assert not environment.ready


def test_what_is_no_environment_is_never_removed(tmp_path: Path) -> None:
    environment = Environment.of(PEERS["ompl-coal"], tmp_path)
    environment.folder.mkdir()
    (environment.folder / "thesis.txt").write_text("years of work", "utf-8")
    with pytest.raises(InvalidRequest, match="an environment of a peer"):
        environment.install(Path(sys.executable))
    assert (environment.folder / "thesis.txt").is_file()


def test_an_environment_of_other_versions_is_not_ready(tmp_path: Path) -> None:
    environment = Environment.of(PEERS["ompl-coal"], tmp_path)
    installed(environment)
    assert environment.ready
    installed(environment, requirements=["ompl==1"])
    assert environment.state == "installed for other versions; install it again"


def test_a_folder_that_cannot_be_made_and_a_note_that_is_none_are_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", "utf-8")
    with pytest.raises(InvalidRequest, match=r"\$PLANNER_SERVICE_PEERS names the folder"):
        Environment.of(PEERS["ompl-coal"], tmp_path / "file").install(Path(sys.executable))
    environment = Environment.of(PEERS["ompl-coal"], tmp_path)
    environment.folder.mkdir()
    (environment.folder / "state.json").write_text("[]", "utf-8")
    assert environment.state == "not installed"


def test_nothing_of_ours_is_seen_in_a_peers_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/ours")
    environment = Environment.of(PEERS["ompl-coal"], tmp_path)
    assert "PYTHONPATH" not in environment.surroundings()


@pytest.fixture
def peers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Environments are made in the test's folder."""
    monkeypatch.setenv("PLANNER_SERVICE_PEERS", str(tmp_path / "peers"))


@pytest.mark.usefixtures("peers")
def test_the_command_lists_what_there_is() -> None:
    said = StringIO()
    assert running.main(["list"], Console(file=said, width=200)) == 0
    assert all(name in said.getvalue() for name in PEERS)
    assert said.getvalue().count("not installed") == len(PEERS)


@pytest.mark.usefixtures("peers")
def test_the_command_fails_where_an_installation_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken, said = script(tmp_path / "python", "echo 'error: nothing works' >&2; exit 1"), StringIO()
    monkeypatch.setattr(sys, "executable", str(broken))
    assert running.main(["install", "ompl-coal"], Console(file=said, width=200)) == 1
    assert "error: nothing works" in said.getvalue()
