"""Roadmaps as a service grows, asks and updates them: what they cost, what they learn, and that they never lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

import planner_service as ps
from auditor.checker import IndependentChecker
from benchmarks.worlds import queries
from planner_service.errors import InvalidRequest
from planner_service.planning.result import PlanResult
from planner_service.roadmap import Verdict
from planner_service.roadmap.graph import Graph
from tests.support.optional import present
from tests.support.roadmaps import cell, lies

WXAI = Path(__file__).parents[3] / "robots" / "wxai"

FEW = ps.PRM(milestones=150, neighbours=8)
FREE, BLOCKED = Verdict.FREE, Verdict.BLOCKED


@lru_cache
def grown(scene: str = "bin") -> ps.Roadmap:
    return cell(scene).build_roadmap(FEW, seed=1)


def ask(service: ps.PlannerService, roadmap: ps.Roadmap, number: int = 0, scene: str = "bin") -> PlanResult:
    query = queries.load(scene)[number]
    return service.plan(ps.PlanRequest(query.start, query.goal, planner=roadmap, time_limit=None))


def in_the_way(result: PlanResult, service: ps.PlannerService, size: float = 0.04) -> ps.Scene:
    """The scene with a box where the tool is halfway along a path."""
    path, _ = result.unwrap()
    x, y, z = service.robot.tool_pose(path(path.length / 2))[:3, 3].tolist()
    return service.scene.with_obstacle(ps.Obstacle("intruder", ps.Box((size, size, size)), ps.Pose((x, y, z))))


def test_a_plan_changes_no_roadmap_and_brings_back_what_it_learned() -> None:
    service, roadmap = cell(), cell().build_roadmap(ps.LazyPRM(milestones=500), seed=0)
    before = roadmap.hash
    first = ask(service, roadmap)
    assert first.ok
    learned = present(first.roadmap)
    assert "other terms" not in first.stage(ps.Stage.SEARCH).note
    assert replace(roadmap).hash == before
    assert learned.hash != before
    assert roadmap.edge_knowledge.count(Verdict.UNKNOWN) == len(roadmap.edges)
    assert lies(learned, service) == []
    again, once_more = ask(service, learned), ask(service, roadmap)
    assert again.stage(ps.Stage.SEARCH).counts.states < first.stage(ps.Stage.SEARCH).counts.states
    assert once_more.counts == first.counts, "nothing is remembered behind the user's back"
    assert present(once_more.roadmap).hash == learned.hash


def test_the_tables_of_a_roadmap_are_built_once_for_all_that_are_made_from_it() -> None:
    service, roadmap = cell(), cell().build_roadmap(ps.LazyPRM(milestones=50), seed=0)
    fresh = replace(roadmap, graph=Graph.of(roadmap.milestones, roadmap.edges, roadmap.graph.reach))
    assert not fresh.prepared
    learned = present(ask(service, fresh).roadmap)
    assert fresh.prepared
    assert learned.prepared
    assert learned.with_path([service.robot.home, roadmap.milestones[0]]).prepared


def test_an_obstacle_on_a_known_path_is_never_driven_through(tmp_path: Path) -> None:
    service, roadmap = cell(), replace(grown(), remember=True)
    first = ask(service, roadmap)
    scene = in_the_way(first, service)
    ps.save_scene(scene, tmp_path / "scene.toml")
    changed, judge = service.with_scene(scene), IndependentChecker(WXAI, tmp_path / "scene.toml")
    result = ask(changed, present(first.roadmap))
    assert result.ok
    path, _ = result.unwrap()
    assert judge.curve_touch(path, path.length) is None
    old, _ = first.unwrap()
    assert judge.curve_touch(old, old.length) is not None
    assert lies(present(result.roadmap), changed) == []
    assert "intruder changed" in result.stage(ps.Stage.SEARCH).note
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


@pytest.mark.parametrize("what", ["gripper", "allowed"])
def test_under_other_terms_nothing_is_taken_for_known(what: str) -> None:
    roadmap, service = grown(), cell().changed(gripper=0.02)
    if what == "allowed":
        service = ps.PlannerService("wxai", "bin", edge_step=ps.JointStep(0.05), allowed=[("finger_left", "tray")])
    result = ask(service, roadmap)
    assert result.ok
    assert lies(present(result.roadmap), service) == []
    assert 0 < present(result.roadmap).edge_knowledge.count(FREE) < len(roadmap.edges) / 4
    update = service.update_roadmap(roadmap)
    assert update.kept == 0
    assert lies(update.roadmap, service) == []
    assert update.roadmap.edge_knowledge.count(Verdict.UNKNOWN) == 0


def test_a_roadmap_of_another_arm_or_beyond_the_limits_and_a_planner_that_grows_none_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="beyond the joint limits"):
        ask(cell(), ps.Roadmap.of([[9.0] * 6, [0.0] * 6], [(0, 1)]))
    with pytest.raises(InvalidRequest, match="planner: got"):
        cell().build_roadmap(ps.RRTConnect())  # type: ignore[arg-type]
    other = ps.PlannerService("planar2", ps.Scene())
    with pytest.raises(InvalidRequest, match="a roadmap of"):
        other.plan(ps.PlanRequest(other.robot.home, other.robot.home + 0.1, planner=grown()))
    with pytest.raises(InvalidRequest, match="a roadmap of"):
        other.update_roadmap(grown())


def test_a_roadmap_grown_for_one_plan_comes_back_with_it() -> None:
    query = queries.load("bin")[0]
    result = cell().plan(ps.PlanRequest(query.start, query.goal, planner=FEW, seed=1, time_limit=None))
    assert result.ok
    built = present(grown().built)
    assert result.stage(ps.Stage.ROADMAP).counts == built.counts
    assert present(result.roadmap).milestones.tolist() == grown().milestones.tolist()


@dataclass(frozen=True)
class OwnStep:
    """A rule of a user, whose ``repr`` does not tell how fine it is."""

    distance: float = field(default=0.01, repr=False)

    def segments(self, dq: Sequence[float], reach: Sequence[float]) -> int:
        return ps.MotionStep(self.distance).segments(dq, reach)


def test_no_verdict_is_taken_over_under_an_edge_step_of_the_user() -> None:
    scene = ps.load_scene("shelf")
    coarse, fine = (ps.PlannerService("wxai", scene, edge_step=OwnStep(distance)) for distance in (2.0, 0.01))
    roadmap = coarse.build_roadmap(ps.PRM(milestones=40, max_checks=20_000), seed=0)
    updated = fine.update_roadmap(roadmap).roadmap
    checker = ps.CollisionChecker(fine.robot, scene, edge_step=OwnStep(0.01), padding=0.001)
    free = np.flatnonzero(updated.verdicts == Verdict.FREE)
    assert all(checker.edge_is_free(*roadmap.milestones[roadmap.edges[edge]]) for edge in free)
