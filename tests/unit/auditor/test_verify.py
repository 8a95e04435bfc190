"""The world of each motion is worked out from the one before: what a file says beside that is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.__main__ import judged, main
from auditor.schema import Invalid
from auditor.trails import World
from planner_service import PlannerService, PlanRequest, Scene
from planner_service.records.evidence import with_evidence
from planner_service.records.plan_file import SavedPlan

Document = dict[str, Any]
Change = Callable[[Document], None]


def scenes(task: Document) -> list[Any]:
    """The places where the file says what the scene has become."""
    return [segment for segment in task["segments"] if segment["scene"] is not None]


def nothing_around(task: Document) -> None:
    scenes(task)[0]["scene"]["obstacles"] = []


def left_elsewhere(task: Document) -> None:
    (left,) = [it for it in scenes(task)[-1]["scene"]["obstacles"] if isinstance(it, dict)]
    left["pose"]["position"][0] += 0.001


def held_elsewhere(task: Document) -> None:
    for segment in scenes(task):
        for held in segment["scene"]["attached"]:
            held["pose"]["position"][2] += 30.0


def held_against_all(task: Document) -> None:
    for segment in scenes(task):
        for held in segment["scene"]["attached"]:
            held["touch_links"].append("link_5")


def never_taken(task: Document) -> None:
    for segment in task["segments"]:
        segment["scene"] = None


def taken_open(task: Document) -> None:
    for segment in task["segments"]:
        segment["gripper_width"], segment["gripper"] = task["robot"]["gripper_width"], None


def elsewhere_between(task: Document) -> None:
    task["segments"][3]["result"]["path"]["waypoints"][0][0] += 1e-3


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (nothing_around, "other obstacles than follow"),
        (left_elsewhere, "other obstacles than follow"),
        (held_elsewhere, "holds blue_block, which does not stand there like that"),
        (held_against_all, "more than fingers may touch blue_block"),
        (never_taken, "is not judged|evidence is for another|claims something else"),
        (taken_open, "taken by a gripper that does not close"),
        (elsewhere_between, "begins elsewhere"),
    ],
)
def test_what_does_not_follow_from_the_motion_before_is_refused(task: Document, change: Change, why: str) -> None:
    change(task)
    with pytest.raises(Invalid, match=why):
        list(judged(task))


def test_names_write_no_lines_of_their_own(
    plan: Document, tmp_path: Path, capsys: pytest.CaptureFixture[str], resealed: Callable[[Document], Document]
) -> None:
    plan["scene"]["obstacles"][0]["name"] = "a\nVALID: all"
    plan["scene"]["obstacles"][0]["pose"]["position"][0] -= 0.2
    (tmp_path / "plan.json").write_text(json.dumps(resealed(plan)))
    assert main([str(tmp_path / "plan.json")]) == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("INVALID: motion:")


@pytest.mark.parametrize("place", [("result", "certificate", "certified"), ("result", "path", "length")])
def test_what_says_that_it_is_no_plan_is_none(plan: Document, place: tuple[str, ...]) -> None:
    *above, key = place
    holder = reduce(getitem, above, plan)
    holder[key] = False if isinstance(holder[key], bool) else holder[key] + 0.05
    with pytest.raises(Invalid):
        list(judged(plan))


def test_an_arm_that_stays_where_it_is_is_shown_apart_there() -> None:
    service = PlannerService("wxai", "table")
    found = service.plan(PlanRequest(service.robot.home, service.robot.home, time_limit=None))
    document = json.loads(with_evidence(SavedPlan.of(found)).file_text())
    lines = list(judged(document))
    assert "  s(t): it stays where it is" in lines
    document["result"]["path"]["waypoints"][0][1] += 0.3
    with pytest.raises(Invalid):
        list(judged(document))


def test_a_robot_that_nothing_can_touch_needs_no_trail() -> None:
    service = PlannerService("planar2", Scene())
    found = service.plan(PlanRequest((0.0, 0.0), (1.0, 0.5), time_limit=None))
    document = json.loads(with_evidence(SavedPlan.of(found)).file_text())
    assert any(line == "motion: nothing can collide" for line in judged(document))
    document["result"]["certificate"]["clearance"] = document["sections"]["evidence"]["proofs"][0]["clearance"] = 0.1
    with pytest.raises(Invalid, match="a clearance of nothing"):
        list(judged(document))


@pytest.mark.parametrize("kind", ["vacuum", "revolute"])
def test_fingers_that_slide_are_those_of_a_parallel_gripper(
    plan: Document, resealed: Callable[[Document], Document], kind: str
) -> None:
    plan["robot"]["gripper"]["kind"] = kind
    with pytest.raises(Invalid, match=f"otherwise than those of a {kind} gripper"):
        list(judged(resealed(plan)))


def test_a_start_that_touches_nothing_may_not_overlap_later(plan: Document) -> None:
    deep = {"s_start": 0.0, "s_end": 0.1, "pairs": [["link_5", "wall"]], "reason": "a start", "depth": 0.002}
    for claim in (plan["result"]["certificate"], plan["sections"]["evidence"]["proofs"][0]):
        claim["exempt"] = [deep]
    with pytest.raises(Invalid, match=r"may be 2.0000 mm deep, at the start 0.0000"):
        list(judged(plan))
    deep["depth"] = 0.01
    with pytest.raises(Invalid, match=r"may be 10.0000 mm deep, 3 mm were asked for"):
        list(judged(plan))


def test_a_plan_that_ends_elsewhere_than_its_request_asks_is_refused(plan: Document) -> None:
    plan["request"]["goals"][0]["joints"][0] += 0.02
    with pytest.raises(Invalid, match="does not end at goal 0"):
        list(judged(plan))


def test_a_motion_that_stops_on_its_way_reaches_no_goal(plan: Document) -> None:
    points, law = np.array(plan["result"]["path"]["waypoints"]), plan["result"]["trajectory"]
    middle, h = 0.4 * float(np.linalg.norm(points[1] - points[0])), 20.0
    a = middle / h**2
    law |= {"durations": [h, h], "duration": 2 * h, "part": [0.0, middle]}
    law["coefficients"] = [[0.0, 0.0, a / 2, 0.0], [middle / 2, a * h, -a / 2, 0.0]]
    plan["result"]["motion"]["duration"] = 2 * h
    with pytest.raises(Invalid, match="ends before goal 0"):
        list(judged(plan))
    plan["result"]["goal_index"] = None
    assert "it begins on its way; it ends at no goal" in list(judged(plan))


def test_pairs_that_a_file_allows_have_to_be_named(plan: Document) -> None:
    plan["allowed"] = [["link_5", "wall"]]
    with pytest.raises(Invalid, match="link_5 x wall: the file lets them touch everywhere"):
        list(judged(plan))
    assert any("link_5" in line and "allowed" in line for line in judged(plan, [("wall", "link_5")]))


def test_what_a_robot_says_of_its_links_says_nothing_of_an_obstacle(
    plan: Document, resealed: Callable[[Document], Document]
) -> None:
    links = [*dict.fromkeys(shape["link"] for shape in plan["robot"]["shapes"])]
    plan["robot"]["allowed_contacts"] += [{"links": [link, "wall"], "reason": "adjacent"} for link in links]
    plan["scene"]["obstacles"][0]["pose"]["position"] = [0.2, 0.0, 0.2]
    with pytest.raises(Invalid, match="x wall from s"):
        list(judged(resealed(plan)))


def test_what_is_held_may_touch_links_and_no_obstacle_of_another_name(plan: Document) -> None:
    (wall,) = plan["scene"]["obstacles"]
    plan["robot"]["gripper"]["links"].append("wall")
    held = {**wall, "name": "block", "touch_links": ["wall"]}
    world = World(plan["robot"], [wall], [held], (), {}, 0.0)
    assert {"block", "wall"} in [{one.name, two.name} for one, two in world.wanted()]


def test_a_proof_of_a_part_is_no_proof_of_the_motion(plan: Document) -> None:
    length = plan["result"]["path"]["length"]
    for claim in (plan["result"]["certificate"], *plan["sections"]["evidence"]["proofs"]):
        claim["part"] = [0.0, length / 2]
    with pytest.raises(Invalid, match=r"it moves, from 0 to .* is proven"):
        list(judged(plan))


@pytest.mark.parametrize("exempt", [("finger_left", "tray"), ("link_5", "blue_block"), ("blue_block", "post")])
def test_a_contact_that_no_rule_allows_is_refused(task: Document, exempt: tuple[str, str]) -> None:
    pair = list(exempt) if exempt[1] != "post" else ["blue_block", task["scene"]["obstacles"][-1]["name"]]
    proofs = [proof for proof in task["sections"]["evidence"]["proofs"] if proof["gripper"][0] == proof["gripper"][1]]
    for segment, proof in zip(task["segments"], proofs, strict=True):
        more = {"s_start": 0.0, "s_end": 0.01, "pairs": [pair], "reason": "fingers may touch what they take"}
        for claim in (segment["result"]["certificate"], proof):
            claim["exempt"] = [*claim["exempt"], more]
    with pytest.raises(Invalid, match=r"is not judged|no such pair"):
        list(judged(task))
