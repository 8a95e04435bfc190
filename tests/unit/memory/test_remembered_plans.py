"""Plans with a memory: fewer checks, the same proof, and nothing that is believed."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from benchmarks.worlds import queries
from planner_service import (
    Attached,
    Box,
    Obstacle,
    Optimise,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Scene,
    Stage,
    save_scene,
)
from planner_service.constraints import JointRange
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray
from planner_service.memory import Memory
from planner_service.planning import AllowedStretch

WXAI = Path(__file__).parents[3] / "robots" / "wxai"

REMEMBERED = "along a motion that was remembered"


@lru_cache
def cell() -> PlannerService:
    return PlannerService("wxai", "bin")


@lru_cache
def asked() -> PlanRequest:
    """A request for which something is searched."""
    for query in queries.load("bin"):
        request = PlanRequest(query.start, query.goal, time_limit=None)
        if cell().plan(request).attempts:
            return request
    raise AssertionError("every query is a straight line")


@lru_cache
def searched() -> PlanResult:
    result = cell().plan(asked())
    assert result.ok
    return result


def waypoints(result: PlanResult) -> FloatArray:
    return result.unwrap()[0].waypoints


def same_plan(a: PlanResult, b: PlanResult) -> bool:
    one, two = a.unwrap()[0], b.unwrap()[0]
    return one.waypoints.tobytes() == two.waypoints.tobytes() and one.blends.tobytes() == two.blends.tobytes()


def in_the_way(result: PlanResult, size: float = 0.04) -> Scene:
    """The scene with a box where the tool is halfway along a path."""
    path, _ = result.unwrap()
    x, y, z = cell().robot.tool_pose(path(path.length / 2))[:3, 3].tolist()
    return cell().scene.with_obstacle(Obstacle("intruder", Box((size, size, size)), Pose((x, y, z))))


def test_a_remembered_motion_is_proven_instead_of_searched() -> None:
    again = cell().plan(asked(), memory=searched().memory)
    assert REMEMBERED in again.notes
    assert again.attempts == 0
    assert again.certificate is not None
    assert again.certificate.certified
    assert again.certificate.padding == asked().padding
    assert np.array_equal(waypoints(again), waypoints(searched()))
    sampled = sum(again.stage(stage).counts.states for stage in (Stage.SEARCH, Stage.SHORTCUT, Stage.POLISH))
    assert sampled == 0
    assert 3 * again.counts.states < searched().counts.states


def test_the_ends_of_the_request_are_kept_exactly_and_the_way_back_is_known_too() -> None:
    rng = np.random.default_rng(1)
    start, goal = (np.asarray(q) + rng.uniform(-0.01, 0.01, 6) for q in (asked().start, asked().goal))
    for request in (replace(asked(), start=start, goal=goal), replace(asked(), start=goal, goal=start)):
        result = cell().plan(request, memory=searched().memory)
        assert REMEMBERED in result.notes
        assert waypoints(result)[[0, -1]].tolist() == [
            np.asarray(request.start).tolist(),
            np.asarray(request.goal).tolist(),
        ]


def test_a_straight_line_that_was_planned_is_proven_without_a_sample() -> None:
    request = PlanRequest(cell().robot.home, cell().robot.home + np.array([0.4, 0.3, 0.1, 0.0, 0.0, 0.0]))
    first = cell().plan(request)
    again = cell().plan(request, memory=first.memory)
    assert first.stage(Stage.STRAIGHT_LINE).counts.states > 0
    assert again.stage(Stage.STRAIGHT_LINE).counts.states == 0
    assert same_plan(first, again)


def test_a_line_that_is_free_now_comes_before_a_detour_that_is_remembered() -> None:
    start, goal = np.asarray(asked().start), np.asarray(asked().goal)
    empty = PlannerService("wxai", "empty")
    result = empty.plan(asked(), memory=searched().memory)
    assert result.ok
    assert waypoints(result).tolist() == [start.tolist(), goal.tolist()]


def test_the_same_memory_and_request_give_the_same_plan_in_any_process(tmp_path: Path) -> None:
    memory, file = searched().memory, tmp_path / "cell.memory.json"
    memory.save(file)
    before = memory.hash
    request = replace(asked(), start=np.asarray(asked().start) + 0.005)
    one, two = (
        cell().plan(request, memory=memory),
        PlannerService("wxai", "bin").plan(request, memory=Memory.load(file)),
    )
    assert memory.hash == before
    assert same_plan(one, two)
    assert one.counts == two.counts
    assert one.memory.hash == two.memory.hash
    program = (
        "import sys, json; from planner_service import PlannerService, PlanRequest\n"
        "from planner_service.memory import Memory\n"
        "file, start, goal = sys.argv[1], *map(json.loads, sys.argv[2:])\n"
        "request = PlanRequest(start, goal, time_limit=None)\n"
        "result = PlannerService('wxai', 'bin').plan(request, memory=Memory.load(file))\n"
        "print(json.dumps([str(result.counts), result.memory.hash]))"
    )
    ends = [json.dumps(np.asarray(q).tolist()) for q in (request.start, request.goal)]
    run = subprocess.run([sys.executable, "-c", program, str(file), *ends], capture_output=True, text=True, check=True)
    assert json.loads(run.stdout) == [str(one.counts), one.memory.hash]


def test_without_a_memory_a_plan_costs_what_it_costs_with_an_empty_one() -> None:
    result = cell().plan(asked(), memory=Memory())
    assert same_plan(result, searched())
    assert result.counts == searched().counts


def test_an_obstacle_in_a_remembered_motion_is_never_driven_through(tmp_path: Path) -> None:
    scene = in_the_way(searched())
    save_scene(scene, tmp_path / "scene.toml")
    changed, judge = cell().with_scene(scene), IndependentChecker(WXAI, tmp_path / "scene.toml")
    result, fresh = changed.plan(asked(), memory=searched().memory), changed.plan(asked())
    path, _ = result.unwrap()
    assert judge.curve_touch(path, path.length) is None
    old, _ = searched().unwrap()
    assert judge.curve_touch(old, old.length) is not None
    assert REMEMBERED not in result.notes
    assert same_plan(result, fresh), "a hint that is refused changes nothing but the cost"
    assert result.counts.states == fresh.counts.states
    assert result.counts.distances > fresh.counts.distances


@pytest.mark.parametrize(("length", "remembered"), [(0.03, True), (0.40, False)])
def test_what_is_carried_is_proven_along_a_remembered_motion(length: float, remembered: bool) -> None:
    rod = Attached(
        "rod", Box((0.02, 0.02, length)), Pose((0.01, 0.0, 0.0)), touch_links=("finger_left", "finger_right")
    )
    service = cell().changed(scene=cell().scene.with_attached(rod), gripper=0.03)
    result = service.plan(asked(), memory=searched().memory)
    assert (REMEMBERED in result.notes) == remembered
    if remembered:
        assert PlannerService(service.robot, service.scene).certify(result.unwrap()[0]).certified
    else:
        fresh = service.plan(asked())
        assert result.ok == fresh.ok
        assert result.counts.states == fresh.counts.states


def forged(*inner: FloatArray) -> Memory:
    names = cell().robot.joint_names
    return Memory(names, tuple(np.array([asked().start, *middle, asked().goal]) for middle in inner))


def test_a_forged_memory_costs_proofs_and_changes_no_plan() -> None:
    lower, upper = cell().robot.bounds
    into_the_table = np.array([[0.0, np.pi / 2, 0.0, np.pi / 2, 0.0, 0.0]])
    outside = np.array([upper + 1.0])
    huge = np.array([lower * 1e300])
    at_the_edge = 0.5 * (waypoints(searched())[1] + 0.5 * (np.asarray(asked().start) + np.asarray(asked().goal)))[None]
    result = cell().plan(asked(), memory=forged(into_the_table, outside, huge, at_the_edge))
    assert result.notes == searched().notes
    assert same_plan(result, searched())
    assert result.counts.states == searched().counts.states


def test_a_memory_of_another_robot_is_refused() -> None:
    with pytest.raises(InvalidRequest, match=r"memory: got 'motions of joint_0, .*expected of panda_joint1"):
        PlannerService("panda", "empty").plan(PlanRequest([0.0] * 7, [0.1] * 7), memory=searched().memory)
    with pytest.raises(InvalidRequest, match=r"memory: got 3; expected a Memory, or None"):
        cell().plan(asked(), memory=3)  # type: ignore[arg-type]


@pytest.mark.parametrize("wish", [{"polish": Optimise()}, {"improve": 1}, {"planner": Optimise()}])
def test_a_request_that_improves_its_path_does_without_a_memory(wish: dict[str, object]) -> None:
    request = replace(asked(), **wish)  # type: ignore[arg-type]
    with_memory, without = cell().plan(request, memory=searched().memory), cell().plan(request)
    assert with_memory.counts == without.counts
    assert REMEMBERED not in with_memory.notes


@pytest.mark.parametrize("kept", [True, False])
def test_a_remembered_motion_keeps_the_constraints_of_the_request(kept: bool) -> None:
    rows = waypoints(searched())
    ends, inner = rows[[0, -1]].max(axis=0), rows[1:-1].max(axis=0)
    joint = int((inner - ends).argmax())
    highest = inner[joint] + 0.1 if kept else 0.5 * (inner[joint] + ends[joint])
    lower = float(cell().robot.limits.lower[joint])
    request = replace(asked(), constraints=[JointRange(cell().robot.joint_names[joint], lower, float(highest))])
    result, fresh = (cell().plan(request, memory=memory) for memory in (searched().memory, None))
    assert (REMEMBERED in result.notes) == kept
    if kept:
        assert result.certificate is not None
        assert len(result.certificate.kept) == 1
    else:
        assert result.ok == fresh.ok
        assert result.counts.states == fresh.counts.states


def test_a_plan_that_leaves_a_pose_by_a_fixed_way_is_remembered_without_it() -> None:
    home = cell().robot.home
    request = PlanRequest(home, asked().goal, time_limit=None)
    first = cell().plan(request)
    again = cell().plan(request, memory=first.memory)
    assert same_plan(first, again)
    assert again.exempt == first.exempt


def test_a_plan_that_only_leaves_what_the_start_touches_remembers_nothing() -> None:
    start = cell().robot.home + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    x, y, z = cell().robot.tool_pose(start)[:3, 3].tolist()
    touching = Obstacle("bar", Box((0.02, 0.2, 0.02)), Pose((x, y, z - 0.018)))
    service = PlannerService("wxai", Scene((touching,)))
    way = service.way_out(start)
    assert way is not None
    end = way.path.waypoints[-1]
    assert end.tolist() != start.tolist()
    result = service.plan(PlanRequest(start, end, start_overlap=0.1))
    assert result.ok
    assert result.memory.motions == ()


@lru_cache
def line() -> FloatArray:
    """A polyline that is free, with a corner to blend."""
    start = cell().robot.home + np.array([0.2, 0.1, 0.1, 0.0, 0.0, 0.0])
    return np.asarray(start + np.array([[0.0] * 6, [0.1, 0.05, 0.0, 0.0, 0.0, 0.0], [0.2, 0.05, 0.1, 0.0, 0.0, 0.0]]))


def test_a_line_between_remembered_ends_is_proven_without_a_sample_and_is_the_same_line() -> None:
    blends = np.full(3, 0.05)
    first = cell().follow(line(), blends=blends)
    again = cell().follow(line(), blends=blends, memory=first.memory)
    back = cell().follow(line()[::-1], blends=blends, memory=first.memory)
    assert first.counts.states > 0
    assert again.counts.states == back.counts.states == 0
    assert same_plan(first, again)
    assert first.unwrap()[0].blends[1] > 0.0
    assert again.certificate is not None
    assert again.certificate.certified
    assert again.memory.hash == first.memory.hash


def test_a_remembered_line_that_is_blocked_now_is_refused_as_without_a_memory() -> None:
    first = cell().follow(line())
    changed = cell().with_scene(in_the_way(first))
    result, fresh = changed.follow(line(), memory=first.memory), changed.follow(line())
    assert str(result.failure) == str(fresh.failure)
    assert "intruder" in str(result.failure)
    assert result.counts.states == fresh.counts.states
    assert result.memory.hash == first.memory.hash


def test_contact_that_is_meant_on_a_remembered_line_is_still_the_only_one() -> None:
    first = cell().follow(line())
    changed = cell().with_scene(in_the_way(first))
    pairs = tuple((contact.a, contact.b) for q in line() for contact in changed.checker.contacts(q))
    pairs += tuple((contact.a, contact.b) for contact in changed.checker.contacts(first.unwrap()[0](0.1)))
    meant = AllowedStretch(0, 2, tuple(dict.fromkeys(pairs)), "meant")
    touched = changed.follow(line(), contacts=[meant], memory=first.memory)
    fresh = changed.follow(line(), contacts=[meant])
    assert pairs
    assert touched.ok == fresh.ok
    assert touched.exempt == fresh.exempt
    with pytest.raises(UnknownName):
        cell().follow(line(), contacts=[AllowedStretch(0, 1, (("nobody", "nothing"),), "")], memory=first.memory)


def test_a_remembered_line_is_tried_before_a_nearer_detour() -> None:
    start = cell().robot.home + np.array([0.2, 0.1, 0.1, 0.0, 0.0, 0.0])
    goal, aside = start + np.array([0.4, 0.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.03, 0.0, 0.0, 0.0, 0.0])
    names = cell().robot.joint_names
    memory = Memory().with_motion([start + aside, goal + aside], names)
    memory = memory.with_motion([start, start + aside, goal], names)
    result = cell().plan(PlanRequest(start, goal), memory=memory)
    assert waypoints(result).tolist() == [start.tolist(), goal.tolist()]
    assert result.stage(Stage.STRAIGHT_LINE).counts.states == 0
