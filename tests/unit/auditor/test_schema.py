"""Files are read strictly: what the verifier does not know, or is not of its kind, proves nothing."""

from __future__ import annotations

import json
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import pytest

from auditor.__main__ import judged
from auditor.schema import SHAPES, Invalid, parsed
from planner_service.files.schema import Record
from planner_service.records import plan_file, request, result, robot, scene, values

Document = dict[str, Any]
Place = tuple[str | int, ...]

ANY = {"made_with", "edge_step", "settings", "polish", "boxes", "sections"}
"""What the verifier takes as it is, for it believes nothing of it."""

RECORDS: dict[str, type[Record]] = {
    "planner-service/plan": plan_file.PlanRecord,
    "planner-service/task": plan_file.TaskRecord,
    "segment": plan_file.SegmentRecord,
    "robot": robot.RobotRecord,
    "gripper": robot.GripperRecord,
    "body": robot.BodyRecord,
    "link_shape": robot.LinkShapeRecord,
    "retreat": robot.RetreatRecord,
    "dynamics": robot.DynamicsRecord,
    "scene": scene.SceneRecord,
    "attached": scene.AttachedRecord,
    "world": scene.WorldRecord,
    "compound": scene.CompoundRecord,
    "cloud": scene.CloudRecord,
    "heights": scene.HeightsRecord,
    "mesh": scene.MeshRecord,
    "capsule": scene.CapsuleRecord,
    "region": values.RegionRecord,
    "range": values.JointRangeRecord,
    "request": request.RequestRecord,
    "result": result.ResultRecord,
    "certificate": result.CertificateRecord,
    "exempt": result.ExemptRecord,
    "fingers": result.GripperMotionRecord,
    "motion": result.MotionRecord,
    "law": result.TrajectoryRecord,
}


@pytest.mark.parametrize("name", RECORDS)
def test_the_verifier_knows_the_keys_that_files_have(name: str) -> None:
    keys = {field.alias or key for key, field in RECORDS[name].model_fields.items()}
    assert {key.rstrip("?") for key in SHAPES[name]} == keys - {"not_kept"}  # of a refused constraint


def places(value: Any, at: Place = ()) -> Iterator[Place]:
    """Every place in a document at which the verifier looks."""
    yield at
    if at and at[-1] in ANY and at != ("sections",):
        return
    items = value.items() if isinstance(value, dict) else enumerate(value[:2]) if isinstance(value, list) else ()
    for key, entry in items:
        yield from places(entry, (*at, key))


def at_place(document: Any, place: Place) -> Any:
    for key in place:
        document = document[key]
    return document


@pytest.mark.slow
def test_an_unknown_key_anywhere_is_refused(task: Document) -> None:
    objects = [place for place in places(task) if isinstance(at_place(task, place), dict)]
    objects = [place for place in objects if not {"boxes", "settings", "made_with", "edge_step"} & set(place)]
    assert len(objects) > 70
    for place in objects:
        if place == ("sections",):
            continue  # for what others add: named, not judged
        at_place(task, place)["more"] = 1
        with pytest.raises(Invalid, match="'more'"):
            list(judged(task))
        del at_place(task, place)["more"]


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [bool, lambda _: float("nan"), lambda _: None])
def test_a_number_of_another_kind_is_refused(plan: Document, wrong: Any) -> None:
    numbers = [place for place in places(plan) if type(at_place(plan, place)) in (int, float)]
    numbers = [place for place in numbers if not {"boxes", "settings", "made_with", "edge_step"} & set(place)]
    assert len(numbers) > 150
    for place in numbers:
        holder, key = at_place(plan, place[:-1]), place[-1]
        right, holder[key] = holder[key], wrong(holder[key])
        if holder[key] is None and key in ("time_limit", "retries", "max_tool_speed", "length", "goal_index", "ratio"):
            pass  # may be null
        elif not (holder[key] is None and key in ("gripper_width", "stop_duration")):
            with pytest.raises(Invalid):
                list(judged(plan))
        holder[key] = right


def test_a_key_that_stands_twice_is_refused(plan: Document) -> None:
    text = json.dumps(plan)
    twice = text.replace('"result":', '"result": {}, "result":', 1).encode()
    assert json.loads(twice) == plan
    with pytest.raises(Invalid, match="a key stands twice"):
        parsed(twice)


@pytest.mark.parametrize("word", ["NaN", "Infinity", "-Infinity"])
def test_words_for_numbers_are_refused(word: str) -> None:
    with pytest.raises(Invalid, match="is no number"):
        parsed(f'{{"format": {word}}}'.encode())


@pytest.mark.parametrize("text", ["", "AAAA", "eAE=", "x", "eJwDAAAAAAE="])
def test_a_table_that_is_none_is_refused(plan: Document, text: str) -> None:
    for key in ("s", "pairs", "rows"):
        proof = plan["sections"]["evidence"]["proofs"][0]
        right, proof[key] = proof[key], text
        with pytest.raises(Invalid):
            list(judged(plan))
        proof[key] = right


def test_a_file_is_a_plan_or_a_task_and_not_both(plan: Document, task: Document) -> None:
    for one, other in ((plan, task), (task, plan)):
        with pytest.raises(Invalid, match="missing or unknown"):
            list(judged({**other, **one}))
        formats: list[Any] = ["planner-service/tasks", "", None, 3, [], other["format"]]
        for other_format in formats:
            with pytest.raises(Invalid, match=r"format|missing or unknown"):
                list(judged({**deepcopy(one), "format": other_format}))


def test_a_joint_that_moves_bodies_only_by_mimics_is_refused(plan: Document) -> None:
    forged = deepcopy(plan)
    forged["robot"]["bodies"][1]["multiplier"] = 0.5
    with pytest.raises(Invalid, match=f"joint {plan['robot']['joint_names'][0]}: expected one body"):
        list(judged(forged))
