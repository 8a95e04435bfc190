"""Tasks in files: every step comes back as it was, and what is no task is refused with all that is wrong."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import InvalidFile, InvalidRequest, Pose, PoseGoal
from planner_service.constraints import JointRange, ToolRegion
from planner_service.geometry.shapes import Box
from planner_service.grasping import GraspKind, GraspKinds
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle
from planner_service.tasks import (
    Alternatives,
    Approach,
    Connect,
    Follow,
    Grasp,
    MoveCircular,
    MoveLinear,
    MoveTo,
    Release,
    Repeat,
    Retreat,
    Task,
    Wait,
)

THERE = Pose((0.3, 0.1, 0.2), (0.0, 1.0, 0.0, 0.0))
KEPT = (ToolRegion(name="above", upper=(np.inf, np.inf, 0.4)), JointRange("elbow", -1.0, 1.0))

STEPS: dict[str, tuple[Any, ...]] = {
    "to where it began": (MoveTo(),),
    "to goals": (MoveTo(([0.1, 0.2], "home", THERE, PoseGoal(THERE, free_axis=(0.0, 0.0, 1.0))), name="out"),),
    "in a frame": (MoveTo(THERE, frame="tray", constraints=KEPT),),
    "lines": (
        MoveLinear([(0.0, 0.0, 0.1), THERE], zone=0.01),
        MoveLinear((0.1, 0.0, 0.0), frame="tray", free_axis=(0, 0, 1)),
    ),
    "an arc": (MoveCircular((0.1, 0.0, 0.0), THERE, constraints=KEPT[:1], free_axis=(0.6, 0.0, 0.8)),),
    "a polyline": (Connect(constraints=KEPT[1:]), Follow([[0.0, 0.1], [0.2, 0.3]], blend=0.1)),
    "a pick": (Connect("to it"), Approach(), Grasp("block", support="table", upright=0.2), Retreat("lift")),
    "chosen grasps": (Connect(), Approach("down", (0.05,)), Grasp("block", [THERE], open_width=0.06), Retreat()),
    "kinds of grasps": (
        *(Connect(), Approach(), Grasp("block", GraspKinds()), Retreat()),
        *(Connect(), Approach(), Grasp("mug", GraspKinds([GraspKind.SIDE, GraspKind.TOP], 0.3, 2**63 - 1, 20))),
    ),
    "shorter": (Connect(), Approach(lengths=(0.05,), shorter=(0.02, 0.01)), Grasp("block", frame="block")),
    "no shorter": (Connect(), Approach(shorter=()), Grasp("block")),
    "a shelf": (
        *(Connect(), Approach("in", direction=(1.0, 0.0, 0.0)), Approach("down", (0.01,), direction=(0.0, 0.0, -1.0))),
        *(Release("block", [THERE], support="board", support_gap=0.002), Retreat("up", (0.01,), (0.0, 0.0, 1.0))),
    ),
    "where it is": (Grasp("handle"), MoveLinear((-0.2, 0.0, 0.0)), Release("handle"), Retreat()),
    "waiting": (Wait(2.5), MoveTo("home")),
    "alternatives": (Alternatives([MoveTo("a"), [MoveTo("b"), Wait(1.0)], []]), MoveTo()),
    "repeated": (Repeat([MoveTo("a"), Repeat([MoveTo("b")], 2), MoveTo()], 3),),
}


@pytest.mark.parametrize("name", STEPS)
def test_a_task_comes_back_from_its_file_as_it_was(name: str, tmp_path: Path) -> None:
    task, file = Task(STEPS[name], name), tmp_path / "steps.json"
    task.save(file)
    assert Task.load(file) == task
    assert repr(Task.load(file)) == repr(task)


def test_only_what_is_not_as_usual_is_in_the_file(tmp_path: Path) -> None:
    file = tmp_path / "steps.json"
    Task((Connect(), Approach(), Grasp("block"), Retreat())).save(file)
    assert json.loads(file.read_text())["steps"] == [
        {"kind": "Connect"},
        {"kind": "Approach"},
        {"kind": "Grasp", "object": "block"},
        {"kind": "Retreat"},
    ]


def written(folder: Path, steps: Any, **head: Any) -> Path:
    file = folder / "steps.json"
    head = {"format": "planner-service/steps", "version": 1, **head}
    file.write_text(json.dumps({**head, "steps": steps}))
    return file


def test_what_a_file_does_not_say_is_as_the_library_has_it(tmp_path: Path) -> None:
    minimal: tuple[tuple[Any, dict[str, Any]], ...] = (
        (MoveTo(), {"kind": "MoveTo"}),
        (MoveLinear((0.0, 0.0, 0.1)), {"kind": "MoveLinear", "goal": [[0.0, 0.0, 0.1]]}),
        (
            MoveCircular((0.1, 0, 0), (0, 0, 0.1)),
            {"kind": "MoveCircular", "via": [0.1, 0.0, 0.0], "goal": [0.0, 0.0, 0.1]},
        ),
        (Connect(), {"kind": "Connect"}),
        (Follow([[0.0], [0.1]]), {"kind": "Follow", "waypoints": [[0.0], [0.1]]}),
        (Connect(), {"kind": "Connect"}),
        (Approach(), {"kind": "Approach"}),
        (Grasp("block"), {"kind": "Grasp", "object": "block"}),
        (Retreat(), {"kind": "Retreat"}),
        (Release("block"), {"kind": "Release", "object": "block"}),
    )
    task = Task.load(written(tmp_path, [step for _, step in minimal]))
    assert task.steps == tuple(step for step, _ in minimal)


def grasped(grasps: Any) -> list[dict[str, Any]]:
    return [{"kind": "Connect"}, {"kind": "Approach"}, {"kind": "Grasp", "object": "block", "grasps": grasps}]


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ([], r"steps"),
        (None, r"steps: got None"),
        (0.5, r"steps: got 0.5"),
        ("Grasp", r"steps: got 'Grasp'; expected .*what is to be done|steps"),
        ([{"kind": "Graps", "object": "block"}], r"steps\[0\].kind: got 'Graps'; expected one of 'MoveTo', "),
        ([{"object": "block"}], r"steps\[0\].kind: missing"),
        ([{"kind": "Grasp"}], r"steps\[0\].object: missing"),
        ([{"kind": "Wait", "seconds": "long"}], r"steps\[0\].seconds: got 'long'"),
        ([{"kind": "Wait", "seconds": 1e9}], r"steps\[0\].*1e\+?09|steps\[0\].*1000000000"),
        ([{"kind": "Wait", "secnods": 1.0, "seconds": 1.0}], r"steps\[0\]: unknown key 'secnods'; did you mean 'secon"),
        ([{"kind": "MoveTo", "goal": [{"joints": [0.0, None]}]}], r"steps\[0\].goal\[0\].joints"),
        ([{"kind": "MoveTo", "goal": [{"where": "home"}]}], r"steps\[0\].goal\[0\]: .*an object with joints"),
        ([{"kind": "MoveLinear", "goal": [[0.0, 0.1]]}], r"steps\[0\].goal\[0\].*3 finite numbers"),
        ([{"kind": "Repeat", "steps": [{"kind": "MoveTo", "name": ""}], "times": 2}], r"steps\[0\].steps\[0\]"),
        (
            grasped({"kinds": ["side", "front"]}),
            r"steps\[2\].grasps.kinds\[1\]: got 'front'; expected 'top', 'side'",
        ),
        (grasped({"kinds": []}), r"steps\[2\].grasps.kinds: got .*; expected at least one GraspKind, each once"),
        (grasped({"kinds": ["top", "top"]}), r"steps\[2\].grasps.kinds: got .*; expected at least one GraspKind, each"),
        (grasped({"kinds": "top"}), r"steps\[2\].grasps.kinds: got 'top'"),
        (grasped({"kinds": ["top"] * 5}), r"steps\[2\].grasps.kinds.*at most 4 entries; there are 5"),
        (grasped({"kind": ["top"]}), r"steps\[2\].grasps: unknown key 'kind'; did you mean 'kinds'"),
        (grasped({"friction": 0.0}), r"steps\[2\].grasps.friction: got 0.0"),
        (grasped({"friction": None}), r"steps\[2\].grasps.friction: got None"),
        (grasped({"seed": 2**63}), r"steps\[2\].grasps.seed"),
        (grasped({"seed": -1}), r"steps\[2\].grasps.seed"),
        (grasped({"most": 1_001}), r"steps\[2\].grasps.most: got 1001"),
        (grasped("top"), r"steps\[2\].grasps: got 'top'"),
        (grasped([]), r"steps\[2\]\.?.*grasps: got .*; expected a list of at least one Pose"),
        ([{"kind": "Retreat"}], r"steps: 1 Retreat retreat: expected a Grasp or a Release before it"),
    ],
)
def test_what_is_no_task_is_refused_with_its_place(steps: Any, said: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match=said):
        Task.load(written(tmp_path, steps))


def test_all_that_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    steps = [{"kind": "Wait", "seconds": -1.0}, {"kind": "Grasp", "object": 7}, {"kind": "Follow", "waypoints": []}]
    with pytest.raises(InvalidFile) as refused:
        Task.load(written(tmp_path, steps))
    assert len(refused.value.problems) == 3


def test_files_of_other_kinds_and_versions_are_refused(tmp_path: Path) -> None:
    steps = [{"kind": "MoveTo"}]
    with pytest.raises(InvalidFile, match="format: got 'planner-service/plan'; expected 'planner-service/steps'"):
        Task.load(written(tmp_path, steps, format="planner-service/plan"))
    with pytest.raises(InvalidFile, match="version: got 2; expected 1"):
        Task.load(written(tmp_path, steps, version=2))
    with pytest.raises(InvalidFile, match="no such file"):
        Task.load(tmp_path / "none.json")


def test_a_file_of_another_kind_is_not_overwritten(tmp_path: Path) -> None:
    file = tmp_path / "notes.json"
    file.write_text('{"notes": []}')
    with pytest.raises(InvalidFile, match="notes"):
        Task((MoveTo(),)).save(file)
    assert file.read_text() == '{"notes": []}'


def test_a_source_of_grasps_of_ones_own_has_no_place_in_a_file(tmp_path: Path) -> None:
    class Mine:
        def poses(self, robot: Robot, obstacle: Obstacle) -> tuple[Pose, ...]:
            return (obstacle.pose,)

    assert Mine().poses(None, Obstacle("block", Box((1.0, 1.0, 1.0)), THERE)) == (THERE,)  # type: ignore[arg-type]
    task = Task((Connect(), Approach(), Grasp("block", Mine())))
    with pytest.raises(InvalidRequest, match=r"grasps: .*a list of Pose, GraspKinds, or None: a source of your own"):
        task.save(tmp_path / "steps.json")
    assert not (tmp_path / "steps.json").exists()


def test_steps_too_deep_within_each_other_are_refused_at_once(tmp_path: Path) -> None:
    for key, more in (("branches", lambda step: [[step]]), ("steps", lambda step: [step])):
        step: Any = {"kind": "MoveTo"}
        for _ in range(300):
            kind = "Alternatives" if key == "branches" else "Repeat"
            step = {"kind": kind, key: more(step)} | ({} if key == "branches" else {"times": 1})
        with pytest.raises(InvalidFile, match="at most 32 lists and objects within each other"):
            Task.load(written(tmp_path, [step]))


def test_a_damaged_file_is_read_or_refused_and_nothing_else_happens(tmp_path: Path) -> None:
    rng, file = random.Random(7), tmp_path / "steps.json"
    texts = []
    for name, steps in STEPS.items():
        Task(steps, name).save(file)
        texts.append(file.read_bytes())
    words = [
        b"",
        b"null",
        b"[]",
        b"{}",
        b"-1",
        b"1e999",
        b'"',
        b"\xff",
        b"[[[",
        b'"kind"',
        b"true",
        b'"MoveTo"',
        b"1e6",
    ]
    read = 0
    for _ in range(1500):
        data = bytearray(rng.choice(texts))
        for _ in range(rng.randint(1, 3)):
            at = rng.randrange(len(data))
            data[at : at + rng.randint(0, 6)] = rng.choice(words)
        file.write_bytes(data)
        try:
            read += isinstance(Task.load(file), Task)
        except InvalidFile:
            continue
    assert read > 0
