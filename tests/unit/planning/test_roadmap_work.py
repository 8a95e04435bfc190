"""Roadmaps as a service grows, asks and updates them: what they cost, what they learn, and that they never lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from benchmarks.worlds import queries
from planner_service import (
    PRM,
    BalancedRRTConnect,
    Box,
    CheckCounts,
    CollisionChecker,
    JointStep,
    LazyPRM,
    MotionStep,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    Reason,
    Roadmap,
    RRTConnect,
    Scene,
    Stage,
    load_scene,
    save_scene,
)
from planner_service.errors import InvalidRequest
from planner_service.planning.result import PlanResult
from planner_service.roadmap import Verdict
from tests.support.optional import present
from tests.support.roadmaps import cell, lies

WXAI = Path(__file__).parents[3] / "robots" / "wxai"

FEW = PRM(milestones=150, neighbours=8)
FREE, BLOCKED = Verdict.FREE, Verdict.BLOCKED


@lru_cache
def grown(scene: str = "bin") -> Roadmap:
    return cell(scene).build_roadmap(FEW, seed=1)


def ask(service: PlannerService, roadmap: Roadmap, number: int = 0, scene: str = "bin") -> PlanResult:
    query = queries.load(scene)[number]
    return service.plan(PlanRequest(query.start, query.goal, planner=roadmap, time_limit=None))


def in_the_way(result: PlanResult, service: PlannerService, size: float = 0.04) -> Scene:
    """The scene with a box where the tool is halfway along a path."""
    path, _ = result.unwrap()
    x, y, z = service.robot.tool_pose(path(path.length / 2))[:3, 3].tolist()
    return service.scene.with_obstacle(Obstacle("intruder", Box((size, size, size)), Pose((x, y, z))))


def test_a_roadmap_says_what_it_cost_and_for_what_it_holds() -> None:
    roadmap, service = grown(), cell()
    assert roadmap.built is not None
    assert roadmap.built.planner == "prm"
    assert roadmap.built.settings == {"milestones": 150, "neighbours": 8, "max_checks": 2_000_000}
    assert roadmap.built.seed == 1
    assert roadmap.built.counts.states > 10_000
    assert roadmap.built.counts.edges >= len(roadmap.edges)
    assert roadmap.terms is not None
    assert roadmap.terms.robot_hash == service.robot.hash
    assert roadmap.terms.scene_hash == service.scene.hash
    assert roadmap.terms.padding == 0.001
    assert lies(roadmap, service) == []


@pytest.mark.slow
def test_a_judged_roadmap_answers_for_a_fraction_of_a_search() -> None:
    service, roadmap = cell(), cell().build_roadmap(PRM(milestones=400), seed=0)
    shares = []
    for number in range(8):
        query = queries.load("bin")[number]
        found = ask(service, roadmap, number)
        alone = service.plan(PlanRequest(query.start, query.goal, time_limit=None))
        assert found.ok
        assert found.stage(Stage.ROADMAP).counts == CheckCounts()
        shares.append(found.stage(Stage.SEARCH).counts.states / alone.stage(Stage.SEARCH).counts.states)
    assert sorted(shares)[4] < 0.5


def test_a_plan_changes_no_roadmap_and_brings_back_what_it_learned() -> None:
    service, roadmap = cell(), cell().build_roadmap(LazyPRM(milestones=500), seed=0)
    before = roadmap.hash
    first = ask(service, roadmap)
    assert first.ok
    learned = present(first.roadmap)
    assert "other terms" not in first.stage(Stage.SEARCH).note
    assert replace(roadmap).hash == before
    assert learned.hash != before
    assert roadmap.edge_knowledge.count(Verdict.UNKNOWN) == len(roadmap.edges)
    assert lies(learned, service) == []
    again, once_more = ask(service, learned), ask(service, roadmap)
    assert again.stage(Stage.SEARCH).counts.states < first.stage(Stage.SEARCH).counts.states
    assert once_more.counts == first.counts, "nothing is remembered behind the user's back"
    assert present(once_more.roadmap).hash == learned.hash


def test_what_the_roadmap_does_not_connect_is_searched_by_the_default_planner_unless_it_must_not() -> None:
    service, nothing = cell(), Roadmap.of(np.zeros((0, 6)))
    query = queries.load("bin")[1]
    alone = service.plan(PlanRequest(query.start, query.goal, time_limit=None))
    found = ask(service, nothing, 1)
    assert found.ok
    assert found.counts == alone.counts
    assert f"no path there: {BalancedRRTConnect.name}" in found.stage(Stage.SEARCH).note
    refused = ask(service, replace(nothing, fallback=False), 1)
    assert present(refused.failure).reason is Reason.PLANNING_FAILED


@pytest.mark.parametrize("milestones", [3, 300])
def test_the_roadmap_that_a_planner_grew_is_in_the_result(milestones: int) -> None:
    query = queries.load("bin")[0]
    grown_for = PRM(milestones=milestones, neighbours=8)
    result = cell().plan(PlanRequest(query.start, query.goal, planner=grown_for, retries=0, time_limit=None))
    assert result.ok
    assert len(present(result.roadmap).milestones) >= milestones
    assert lies(present(result.roadmap), cell()) == []


def test_a_memory_of_paths_begins_with_nothing_and_answers_the_same_question_without_a_check() -> None:
    service, memory = cell(), cell().path_memory()
    first = ask(service, memory, 1)
    assert first.roadmap is not None
    assert len(first.roadmap.milestones) >= 2
    assert lies(first.roadmap, service) == []
    again = ask(service, first.roadmap, 1)
    assert again.ok
    assert again.stage(Stage.SEARCH).counts.states == 0
    assert present(again.certificate).certified, "certified again"
    assert len(memory.milestones) == 0


def test_a_path_that_was_found_over_a_judged_roadmap_is_remembered_if_asked() -> None:
    service, roadmap = cell(), replace(grown(), remember=True)
    for number in range(6):
        result = ask(service, roadmap, number)
        assert result.ok
        assert len(present(result.roadmap).milestones) > len(roadmap.milestones)
        roadmap = present(result.roadmap)
    assert lies(roadmap, service) == []
    assert len(grown().milestones) < len(roadmap.milestones)


def test_an_obstacle_on_a_known_path_is_never_driven_through(tmp_path: Path) -> None:
    service, roadmap = cell(), replace(grown(), remember=True)
    first = ask(service, roadmap)
    scene = in_the_way(first, service)
    save_scene(scene, tmp_path / "scene.toml")
    changed, judge = service.with_scene(scene), IndependentChecker(WXAI, tmp_path / "scene.toml")
    result = ask(changed, present(first.roadmap))
    assert result.ok
    path, _ = result.unwrap()
    assert judge.curve_touch(path, path.length) is None
    old, _ = first.unwrap()
    assert judge.curve_touch(old, old.length) is not None
    assert lies(present(result.roadmap), changed) == []
    assert "intruder changed" in result.stage(Stage.SEARCH).note
    assert present(result.roadmap).pending == ("intruder",)


def test_a_roadmap_told_of_an_obstacle_judges_only_what_that_may_touch() -> None:
    service, roadmap = cell(), grown()
    scene = in_the_way(ask(service, roadmap), service)
    changed = service.with_scene(scene)
    update = changed.update_roadmap(roadmap)
    assert update.changed == ("intruder",)
    assert update.kept + update.judged + update.fell >= roadmap.edge_knowledge.count(FREE)
    assert update.kept > len(roadmap.edges) / 2
    assert update.fell > 0
    assert update.counts.states < 0.35 * present(roadmap.built).counts.states
    assert lies(update.roadmap, changed) == []
    assert set(update.roadmap.verdicts.tolist()) <= {FREE, BLOCKED}


def test_an_obstacle_that_goes_again_gives_back_what_it_took() -> None:
    service, roadmap = cell(), grown()
    changed = service.with_scene(in_the_way(ask(service, roadmap), service))
    there = changed.update_roadmap(roadmap).roadmap
    back = service.update_roadmap(there)
    assert back.changed == ("intruder",)
    assert back.fell == 0
    assert back.rose > 0
    assert back.roadmap.verdicts.tolist() == roadmap.verdicts.tolist()
    assert lies(back.roadmap, service) == []


def test_an_obstacle_that_came_and_went_before_anyone_looked_costs_nothing() -> None:
    service, roadmap = cell(), grown()
    changed = service.with_scene(in_the_way(ask(service, roadmap), service))
    assert changed.scene.hash != service.scene.hash
    seen = present(ask(changed, roadmap).roadmap)
    back = service.update_roadmap(seen)
    assert lies(back.roadmap, service) == []
    assert back.counts.states < 0.1 * (roadmap.built.counts.states if roadmap.built else 0)


def test_moving_what_is_far_away_costs_no_state() -> None:
    service, roadmap = cell(), grown()
    far = Obstacle("pillar", Box((0.1, 0.1, 0.1)), Pose((3.0, 3.0, 0.0)))
    with_pillar = service.with_scene(service.scene.with_obstacle(far))
    first = with_pillar.update_roadmap(roadmap)
    assert first.counts.states == 0
    assert first.counts.distances > 0
    assert first.kept == roadmap.edge_knowledge.count(FREE)
    moved = with_pillar.with_scene(with_pillar.scene.moved("pillar", Pose((-3.0, 3.0, 0.0))))
    assert moved.update_roadmap(first.roadmap).counts.states == 0


@pytest.mark.parametrize("what", ["gripper", "padding", "step", "allowed"])
def test_under_other_terms_nothing_is_taken_for_known(what: str) -> None:
    roadmap = grown()
    service = cell()
    if what == "gripper":
        service = service.changed(gripper=0.02)
    if what == "step":
        service = PlannerService("wxai", "bin", edge_step=JointStep(0.04))
    if what == "allowed":
        service = PlannerService("wxai", "bin", edge_step=JointStep(0.05), allowed=[("finger_left", "tray")])
    query = queries.load("bin")[0]
    padding = 0.002 if what == "padding" else 0.001
    result = service.plan(PlanRequest(query.start, query.goal, planner=roadmap, padding=padding, time_limit=None))
    assert result.ok
    if what == "padding":
        assert result.roadmap is roadmap, "what holds for another padding is not mixed in"
        return
    assert lies(present(result.roadmap), service) == []
    assert 0 < present(result.roadmap).edge_knowledge.count(FREE) < len(roadmap.edges) / 4
    update = service.update_roadmap(roadmap)
    assert update.kept == 0
    assert lies(update.roadmap, service) == []
    assert update.roadmap.edge_knowledge.count(Verdict.UNKNOWN) == 0


def test_with_less_padding_what_was_free_is() -> None:
    query = queries.load("bin")[0]
    service, roadmap = cell(), grown()
    near = service.plan(PlanRequest(query.start, query.goal, planner=roadmap, padding=0.0, time_limit=None))
    assert near.ok
    assert near.stage(Stage.SEARCH).counts.states <= ask(service, roadmap).stage(Stage.SEARCH).counts.states + 50
    assert near.roadmap is roadmap


def test_a_roadmap_of_another_arm_is_refused() -> None:
    other = PlannerService("planar2", Scene())
    with pytest.raises(InvalidRequest, match="a roadmap of"):
        other.plan(PlanRequest(other.robot.home, other.robot.home + 0.1, planner=grown()))
    with pytest.raises(InvalidRequest, match="a roadmap of"):
        other.update_roadmap(grown())


def test_milestones_beyond_the_joint_limits_are_refused() -> None:
    wild = Roadmap.of([[9.0] * 6, [0.0] * 6], [(0, 1)])
    with pytest.raises(InvalidRequest, match="beyond the joint limits"):
        ask(cell(), wild)


@pytest.mark.parametrize("planner", [RRTConnect(), "prm", None])
def test_what_grows_no_roadmap_is_refused(planner: object) -> None:
    with pytest.raises(InvalidRequest, match="planner: got"):
        cell().build_roadmap(planner)  # type: ignore[arg-type]


def test_a_roadmap_grown_for_one_plan_comes_back_with_it() -> None:
    query = queries.load("bin")[0]
    result = cell().plan(PlanRequest(query.start, query.goal, planner=FEW, seed=1, time_limit=None))
    assert result.ok
    built = present(grown().built)
    assert result.stage(Stage.ROADMAP).counts == built.counts
    assert present(result.roadmap).milestones.tolist() == grown().milestones.tolist()


def test_progress_is_told_where_it_is_wanted(capsys: pytest.CaptureFixture[str]) -> None:
    cell().build_roadmap(PRM(milestones=20), progress=True)
    assert "roadmap" in capsys.readouterr().err
    cell().build_roadmap(PRM(milestones=20), progress=False)
    cell().build_roadmap(PRM(milestones=20))
    assert capsys.readouterr().err == ""


def test_a_remembered_path_is_made_of_edges_that_were_judged_free() -> None:
    service, memory = cell("shelf"), cell("shelf").path_memory()
    checker = CollisionChecker(service.robot, service.scene, edge_step=JointStep(0.05), padding=0.001)
    for number in range(5):
        result = ask(service, memory, number, "shelf")
        memory = present(result.roadmap)
        for a, b in pairwise(result.unwrap()[0].waypoints[1:-1]):
            assert checker.edge_is_free(a, b)
    assert lies(memory, service) == []


@dataclass(frozen=True)
class OwnStep:
    """A rule of a user, whose ``repr`` does not tell how fine it is."""

    distance: float = field(default=0.01, repr=False)

    def segments(self, dq: Sequence[float], reach: Sequence[float]) -> int:
        return MotionStep(self.distance).segments(dq, reach)


def test_no_verdict_is_taken_over_under_an_edge_step_of_the_user() -> None:
    scene = load_scene("shelf")
    coarse, fine = (PlannerService("wxai", scene, edge_step=OwnStep(distance)) for distance in (2.0, 0.01))
    roadmap = coarse.build_roadmap(PRM(milestones=40, max_checks=20_000), seed=0)
    updated = fine.update_roadmap(roadmap).roadmap
    checker = CollisionChecker(fine.robot, scene, edge_step=OwnStep(0.01), padding=0.001)
    free = np.flatnonzero(updated.verdicts == Verdict.FREE)
    assert all(checker.edge_is_free(*roadmap.milestones[roadmap.edges[edge]]) for edge in free)


def test_a_roadmap_of_something_else_is_refused() -> None:
    for name in ["graph", "milestone_knowledge", "edge_knowledge", "terms", "built"]:
        roadmap = PlannerService("planar2", "discs").path_memory()
        with pytest.raises(InvalidRequest, match=f"{name}: got 5"):
            replace(roadmap, **{name: 5})  # type: ignore[arg-type]
