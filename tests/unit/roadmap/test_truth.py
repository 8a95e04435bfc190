"""Roadmaps never lie: every verdict that is said to hold is a fresh checker's, whatever happened before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.worlds import queries
from planner_service import (
    PRM,
    CancelToken,
    CollisionChecker,
    JointStep,
    PlannerService,
    PlanRequest,
    PlanResult,
    Roadmap,
    Scene,
)
from planner_service.planning import search_stage
from planner_service.roadmap import Terms, Verdict
from planner_service.roadmap.verdicts import SELF
from tests.support.optional import present
from tests.support.roadmaps import cell, checker_of, lies

FREE, BLOCKED = Verdict.FREE, Verdict.BLOCKED


def false_blames(roadmap: Roadmap, service: PlannerService) -> list[tuple[str, str]]:
    """What is said to be in the way of something without being so."""
    scene, out = service.scene, []
    checkers = {SELF: checker_of(roadmap, service.with_scene(Scene((), scene.attached)))}
    for obstacle in scene.obstacles:
        checkers[obstacle.name] = checker_of(roadmap, service.with_scene(Scene((obstacle,), scene.attached)))
    ends = roadmap.milestones[roadmap.edges]
    things = np.repeat(roadmap.milestones[:, None], 2, axis=1)
    for known, pairs in ((roadmap.milestone_knowledge, things), (roadmap.edge_knowledge, ends)):
        for verdict, blocker, (a, b) in zip(known.verdicts.tolist(), known.blockers.tolist(), pairs, strict=True):
            if verdict == BLOCKED and blocker >= 0 and checkers[known.names[blocker]].edge_is_free(a, b):
                out.append((known.names[blocker], str(a)))
    return out


def ask(service: PlannerService, roadmap: Roadmap, number: int = 0, **settings: Any) -> PlanResult:
    query = queries.load("bin")[number]
    return service.plan(PlanRequest(query.start, query.goal, planner=roadmap, time_limit=None, **settings))


def test_a_path_that_keeps_less_is_not_remembered_as_one_that_keeps_more() -> None:
    service = cell()
    memory = service.path_memory(padding=0.03)
    for number in range(4):
        result = ask(service, memory, number, padding=0.0)
        assert result.ok
        assert result.roadmap is memory


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.4])
def test_parts_of_edges_are_remembered_only_once_judged(step: float, monkeypatch: pytest.MonkeyPatch) -> None:
    for smoothing in ("shortcut", "pulled_in", "without_short_pieces"):  # which judges most of them
        monkeypatch.setattr(search_stage, smoothing, lambda points, *_: points)
    service = PlannerService("wxai", "shelf", edge_step=JointStep(step))
    few = PRM(milestones=100, neighbours=5)
    roadmap = replace(service.build_roadmap(few, seed=1, padding=0.01), remember=True)
    for query in queries.load("shelf")[:25]:
        request = PlanRequest(query.start, query.goal, planner=roadmap, time_limit=None, blend=0.0, padding=0.01)
        result = service.plan(request)
        roadmap = present(result.roadmap)
    assert len(roadmap.milestones) > 120
    assert lies(roadmap, service) == []


class Whim:
    """A rule of a user's own, which nobody can tell from another."""

    def __init__(self, angle: float) -> None:
        self.angle = angle

    def segments(self, dq: Sequence[float], reach: Sequence[float]) -> int:
        return JointStep(self.angle).segments(dq, reach)

    def __repr__(self) -> str:
        return "Whim()"


def test_what_was_judged_at_samples_nobody_can_tell_is_not_known_again() -> None:
    coarse, fine = (PlannerService("wxai", "bin", edge_step=Whim(angle)) for angle in (0.8, 0.02))
    roadmap = coarse.build_roadmap(PRM(milestones=100, neighbours=6), seed=1)
    assert lies(roadmap, coarse) == []
    result = ask(fine, roadmap)
    assert lies(result.roadmap, fine) == []
    assert lies(fine.update_roadmap(roadmap).roadmap, fine) == []


def test_with_less_padding_what_was_blocked_is_not_known_and_what_was_free_is() -> None:
    terms = Terms.of(CollisionChecker(cell().robot, Scene(), padding=0.01))
    edges = {0: (FREE, None), 1: (BLOCKED, "post"), 2: (Verdict.FREE_BEFORE, None)}
    roadmap = replace(Roadmap.of(np.zeros((4, 6)), [(0, 1), (1, 2), (2, 3)]), terms=terms).with_lessons({}, edges)
    unknown = Verdict.UNKNOWN
    nearer = roadmap.under(replace(terms, padding=0.0))
    assert nearer.verdicts.tolist() == [FREE, unknown, Verdict.FREE_BEFORE]
    assert roadmap.under(replace(terms, padding=0.02)).verdicts.tolist() == [unknown] * 3
    hardly = replace(terms, padding=0.01 - 1e-9)
    assert roadmap.under(hardly).verdicts.tolist() == [unknown] * 3


def test_what_stood_in_the_way_of_a_grown_edge_is_what_is_blamed() -> None:
    for scene in ("bin", "shelf"):
        service = cell(scene)
        roadmap = service.build_roadmap(PRM(milestones=150, neighbours=10), seed=2)
        blamed = {roadmap.edge_knowledge.names[k] for k in roadmap.edge_knowledge.blockers.tolist() if k >= 0}
        assert len(blamed) > 2
        assert roadmap.edge_knowledge.count(BLOCKED) > 50
        assert false_blames(roadmap, service) == []


def test_a_query_that_was_cancelled_disturbs_no_other() -> None:
    service, roadmap = PlannerService("wxai", "bin", edge_step=JointStep(0.05)), cell().path_memory()
    token = CancelToken()
    token.cancel()
    query = queries.load("bin")[1]
    request = PlanRequest(query.start, query.goal, planner=roadmap, time_limit=None)
    expected = cell().plan(request)
    cancelled = service.plan(request, cancel=token)
    assert cancelled.failure is not None
    assert cancelled.roadmap is roadmap
    again = service.plan(request)
    assert again.counts == expected.counts
    assert present(again.roadmap).hash == present(expected.roadmap).hash
