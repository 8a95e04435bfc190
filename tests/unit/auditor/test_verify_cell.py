"""The verifier of cells accepts what is proven over all clocks, and nothing else."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from auditor.__main__ import judged
from auditor.schema import Invalid
from auditor.trails import digest, unpacked
from auditor.verify_cell import uncovered
from planner_service import Attached, Box, JointPath, PlanRequest, Pose, Trajectory, Trapezoidal, load_robot
from planner_service.cell import Arm, AtTool, Cell
from planner_service.constraints import KeepUpright
from planner_service.records.cells import SavedCellPlan, with_cell_evidence
from planner_service.records.evidence import packed
from tests.unit.records.cells.cells import crossing, two_discs

Document = dict[str, Any]


def document_of(saved: SavedCellPlan) -> Document:
    found: Document = json.loads(saved.file_text())
    return found


@pytest.fixture(scope="module")
def honest() -> Document:
    return document_of(with_cell_evidence(crossing(two_discs())))


def test_an_honest_plan_is_accepted(honest: Document) -> None:
    lines = list(judged(honest))
    assert lines[-1].startswith("verified: ")
    (between,) = [line for line in lines if line.startswith("left x right: ")]
    assert between.endswith("mm when each is late by up to 0.1 s, at any time")
    assert f"robot 0: {digest(honest['robots'][0])}" in lines
    assert any(line.startswith("right: robot 0, ") and "[2.2, 0.0, 0.0]" in line for line in lines)


def test_an_arm_that_stands_is_accepted_and_named() -> None:
    alone = two_discs().plan({"left": PlanRequest([0.3, 0.1], [1.5, 0.1])}, standing={"right": [-0.1, 0.1]})
    lines = list(judged(document_of(with_cell_evidence(alone))))
    assert "right: stands at [-0.1, 0.1]" in lines
    assert "no two arms move on clocks of their own; they may be late for as long as they like" in lines


def test_ways_out_of_folded_poses_and_one_robot_with_two_arms_are_accepted() -> None:
    robot = load_robot("wxai")
    places = {"left": Arm(robot, Pose((0.0, 0.3, 0.0))), "right": Arm(robot, Pose((0.0, -0.3, 0.0)))}
    dual = load_robot("wxai_dual")
    sides = {side: [name for name in dual.joint_names if name.startswith(side)] for side in ("left", "right")}
    for cell in (Cell(places, "empty"), Cell.of(dual, sides, "empty", tools={"right": "right_ee_gripper_link"})):
        requests = {side: PlanRequest(q, q + 0.2) for side in sides for q in [cell.arm(side).robot.home]}
        plan = cell.plan(requests, delay=0.05)
        assert plan.ok
        lines = list(judged(document_of(with_cell_evidence(plan))))
        assert lines[-1].startswith("verified: ")


def test_an_arm_that_waits_on_its_way_is_accepted() -> None:
    plan = crossing(two_discs())
    clock = plan.clocks[0]
    path = JointPath(np.array([[0.0, 0.1], [0.7, 0.15], [1.5, 0.1]]))
    pace = PlanRequest([0.0, 0.1], [1.5, 0.1], velocity_scale=0.2).pace
    law = Trapezoidal().time_path(path, pace.limits(two_discs().arm("left").robot))
    rest = next(k for k, row in enumerate(law.coefficients) if k and abs(row[1]) < 1e-12)
    still = [law.coefficients[rest][0], 0.0, 0.0, 0.0]
    waits = Trajectory(path, np.insert(law.durations, rest, 1.5), np.insert(law.coefficients, rest, still, axis=0))
    motion = clock.plan.motion
    assert motion is not None
    result = replace(clock.plan, path=path, trajectory=waits, motion=replace(motion, duration=waits.duration))
    late = replace(plan, clocks=(replace(clock, plan=result), plan.clocks[1]), tolerates=0.05)
    lines = list(judged(document_of(with_cell_evidence(late))))
    assert any(line.endswith("when each is late by up to 0.05 s, at any time") for line in lines)


def test_what_an_arm_holds_is_judged_and_named() -> None:
    robot = load_robot("wxai")
    places = {"left": Arm(robot, Pose((0.0, 0.3, 0.0))), "right": Arm(robot, Pose((0.0, -0.3, 0.0)))}
    upright = KeepUpright((0.0, 0.0, 1.0), 3.0)
    fingers = ("finger_left", "finger_right")
    box = Attached("box", Box((0.03, 0.03, 0.1)), Pose(), fingers, constraints=(upright,))
    cell = Cell(places, "empty").carrying({"left": [box]})
    ready = robot.pose("ready")
    requests = {name: PlanRequest(ready, ready + 0.1) for name in cell.arms}
    document = document_of(with_cell_evidence(cell.plan(requests, delay=0.05)))
    lines = list(judged(document))
    assert "left: holds box, not judged with ['finger_left', 'finger_right']" in lines
    held = document["arms"][0]["carried"][0]
    held["shape"]["size"] = [0.6, 0.6, 0.6]
    with pytest.raises(Invalid, match="left_box"):
        list(judged(document))
    held["shape"]["size"] = [0.03, 0.03, 0.1]
    held["constraints"][0]["tilt"] = 0.001
    for clock in document["clocks"]:
        clock["request"]["constraints"] = clock["result"]["constraints"] = []
    with pytest.raises(Invalid, match=r"left: .* is not kept"):
        list(judged(document))


def test_a_tool_that_was_to_be_at_another_is_there() -> None:
    robot, across = load_robot("wxai"), Pose((0.15, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    cell = Cell({"left": Arm(robot), "right": Arm(robot, Pose((0.75, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))}, "table")
    stands = [1.2, 1.0, 1.0, -0.5, 0.0, 0.0]
    requests = {"left": PlanRequest(stands, Pose((0.3, 0.0, 0.25))), "right": PlanRequest(stands, stands)}
    plan = cell.plan(requests, goals={"right": AtTool("left", across)}, delay=0.05)
    document = document_of(with_cell_evidence(plan))
    assert any(line.startswith("right: its tool ends at ") for line in judged(document))
    document["arms"][1]["at_tool"]["pose"]["position"][1] = 0.001
    with pytest.raises(Invalid, match="right: its tool does not end"):
        list(judged(document))
    document["arms"][1]["at_tool"]["arm"] = "right"
    with pytest.raises(Invalid, match="no other arm"):
        list(judged(document))


def _rows(document: Document) -> tuple[Document, Any]:
    proof = document["sections"]["evidence"]["between"][0]
    return proof, unpacked(proof["rows"], "<i4", 8).copy()


def _larger_delay(document: Document) -> None:
    document["tolerates"] += 0.05


def _no_limit(document: Document) -> None:
    document["tolerates"] = None


def _earlier(document: Document) -> None:
    document["clocks"][1]["start"] -= 0.2


def _later(document: Document) -> None:
    document["clocks"][1]["start"] += 0.2


def _before(document: Document) -> None:
    document["clocks"][1]["start"] = -1.0


def _swapped_names(document: Document) -> None:
    one, two = document["clocks"]
    one["arms"], two["arms"] = two["arms"], one["arms"]


def _swapped_motions(document: Document) -> None:
    one, two = document["clocks"]
    one["result"], two["result"] = two["result"], one["result"]
    proofs = document["sections"]["evidence"]["proofs"]
    proofs.reverse()


def _swapped_arms(document: Document) -> None:
    document["sections"]["evidence"]["between"][0]["arms"].reverse()


def _left_out(document: Document) -> None:
    proof, rows = _rows(document)
    proof["rows"] = packed(np.delete(rows, len(rows) // 2, axis=0), "<i4")


def _none_left(document: Document) -> None:
    document["sections"]["evidence"]["between"] = []


def _times_moved(document: Document) -> None:
    proof, _ = _rows(document)
    times = unpacked(proof["times"][0], "<f8", 1)[:, 0].copy()
    times[1:-1] = np.sort(times[1:-1] + 0.3 * (times[-1] - times[1:-1]))
    proof["times"][0] = packed(times, "<f8")


def _turned_directions(document: Document) -> None:
    proof, rows = _rows(document)
    rows[:, 5:] *= -1
    proof["rows"] = packed(rows, "<i4")


def _claimed_more(document: Document) -> None:
    _rows(document)[0]["clearance"] += 0.005


def _claimed_nothing(document: Document) -> None:
    _rows(document)[0]["clearance"] = None


def _moved_base(document: Document) -> None:
    document["arms"][1]["base"]["position"][0] -= 0.1


def _grown(document: Document) -> None:
    document["robots"][0]["shapes"][1]["shape"]["radius"] *= 4.0
    document["sections"]["evidence"]["robots"] = [digest(robot) for robot in document["robots"]]


def _shrunk(document: Document) -> None:
    document["robots"][0]["shapes"][1]["shape"]["radius"] *= 0.1


def _faster(document: Document) -> None:
    law = document["clocks"][0]["result"]["trajectory"]
    law["durations"] = [0.5 * h for h in law["durations"]]
    law["coefficients"] = [[c * 2.0**p for p, c in enumerate(row)] for row in law["coefficients"]]
    law["duration"] *= 0.5
    document["clocks"][0]["result"]["motion"]["duration"] = law["duration"]


def _elsewhere(document: Document) -> None:
    document["still"][0] += 0.01


def _one_stands(document: Document) -> None:
    del document["clocks"][1], document["sections"]["evidence"]["proofs"][1]
    document["sections"]["evidence"]["between"] = []
    document["tolerates"] = None


def _nobody_moves(document: Document) -> None:
    document["clocks"] = document["sections"]["evidence"]["proofs"] = document["sections"]["evidence"]["between"] = []


def _unknown_word(document: Document) -> None:
    document["clocks"][0]["waits"] = 0.5


def _twice(document: Document) -> None:
    document["clocks"].append(deepcopy(document["clocks"][0]))
    document["sections"]["evidence"]["proofs"].append(deepcopy(document["sections"]["evidence"]["proofs"][0]))


FORGERIES: dict[Callable[[Document], None], str] = {
    _larger_delay: "is not shown apart",
    _no_limit: "is not shown apart",
    _earlier: "is not shown apart",
    _later: "is not shown apart",
    _before: "starts before the start",
    _swapped_names: "does not begin where its arms stand",
    _swapped_motions: "does not begin where its arms stand",
    _swapped_arms: "proofs of other arms",
    _left_out: "is not shown apart",
    _none_left: "proofs of other arms",
    _times_moved: "is not shown apart",
    _turned_directions: "is not shown apart",
    _claimed_more: "is not shown apart",
    _claimed_nothing: "no clearance is claimed",
    _moved_base: "is not shown apart",
    _grown: "is not shown apart",
    _shrunk: "for other robots",
    _faster: "velocity",
    _elsewhere: "does not begin where its arms stand",
    _one_stands: "does not reach both ends",
    _nobody_moves: "no motion",
    _unknown_word: "unknown",
    _twice: "moves twice",
}


@pytest.mark.parametrize("forge", FORGERIES, ids=lambda forge: forge.__name__)
def test_forgeries_are_refused(forge: Callable[[Document], None], honest: Document) -> None:
    document = deepcopy(honest)
    forge(document)
    with pytest.raises(Invalid, match=FORGERIES[forge]):
        list(judged(document))


def test_no_pair_of_places_that_occurs_is_left_out() -> None:
    """The lemma of lateness, with random clocks: a rectangle is asked for wherever two late arms can be."""
    rng = np.random.default_rng(3)
    none = np.zeros((0, 2), dtype=int)
    found = 0
    for _ in range(3_000):
        ends, starts = rng.uniform(0.1, 3.0, 2), rng.uniform(0.0, 2.0, 2) * rng.integers(0, 2, 2)
        late = float(rng.choice((0.0, rng.uniform(0.0, 1.0))))
        times = [np.sort(np.r_[0.0, rng.uniform(0.0, end, 4), end]) for end in ends]
        lead = starts[1] - starts[0]
        t = rng.uniform(0.0, 6.0)
        x, y = (float(np.clip(t - b - rng.uniform(0.0, late), 0.0, T)) for b, T in zip(starts, ends, strict=True))
        i, j = (min(int(np.searchsorted(row, at, "right")) - 1, 4) for row, at in zip(times, (x, y), strict=True))
        here = np.array([[i, i + 1]]), np.array([[j, j + 1]])
        others = [(p, q) for p in range(5) for q in range(5) if (p, q) != (i, j)]
        first, second = (np.array([[each[k], each[k] + 1] for each in others]) for k in (0, 1))
        left = uncovered(times, first, second, lead - late, lead + late)
        inside = times[0][i] < x < times[0][i + 1] and times[1][j] < y < times[1][j + 1]
        if inside or x in (0.0, ends[0]) or y in (0.0, ends[1]):
            assert left is not None, (x, y)
            found += 1
        all_first, all_second = np.concatenate([here[0], first]), np.concatenate([here[1], second])
        assert uncovered(times, all_first, all_second, -9.0, 9.0) is None
        assert uncovered(times, none, none, lead - late, lead + late) is not None
    assert found > 1_000
    assert uncovered([np.array([0.0, 1.0])] * 2, none, none, -math.inf, math.inf) is not None
