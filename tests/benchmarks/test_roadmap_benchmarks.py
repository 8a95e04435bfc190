"""What is measured of roadmaps is measured right, and a promise that is broken is told."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks.harness.report import Row
from benchmarks.studies import many
from benchmarks.studies.roadmaps import PARTS, asked, large, lazy, moved, warm
from benchmarks.studies.roadmaps.moved import moved_scene, ten_obstacles, untrue
from benchmarks.studies.states import plan
from benchmarks.worlds import queries
from planner_service import PRM, PlannerService, Roadmap, Stage
from planner_service.roadmap import Verdict
from planner_service.roadmap.verdicts import Knowledge

SMALL = PRM(milestones=60, neighbours=6)


@pytest.fixture(scope="module")
def service() -> PlannerService:
    return PlannerService(queries.ROBOT, "post")


@pytest.fixture(scope="module")
def small(service: PlannerService) -> Roadmap:
    return service.build_roadmap(SMALL, progress=False)


# --- what is asked


def test_a_query_is_charged_growing_and_searching_and_what_is_before_the_proof_holds_both(
    service: PlannerService, small: Roadmap
) -> None:
    some = queries.load("post")[:2]
    row = asked.asked(service, small, some, turns=1)
    results = [plan(service, query, planner=small) for query in some]
    assert row["states"] == [result.stage(Stage.SEARCH).counts.states for result in results]
    assert (row["asked"], row["solved"]) == (2, 2)
    result, search, before = asked.timed(service, small, some[0])
    seconds = {report.stage: report.seconds for report in result.stages}
    assert search == 1e3 * seconds.pop(Stage.SEARCH) > 0.0
    assert min(seconds.pop(Stage.CERTIFY), seconds.pop(Stage.TIMING)) > 0.0
    assert before == pytest.approx(search + 1e3 * sum(seconds.values()))
    grown = asked.asked(service, SMALL, some[:1], turns=1)["states"][0]
    assert grown > asked.built_states(small) // 2 > 1000


def test_a_search_that_ends_in_the_fallback_is_told(service: PlannerService) -> None:
    query = queries.load("post")[0]
    assert asked.fell_back(plan(service, query, planner=service.path_memory()))
    assert not asked.fell_back(plan(service, query, planner=service.build_roadmap(PRM(), progress=False)))


def test_an_experienced_roadmap_knows_the_paths_of_other_queries(service: PlannerService) -> None:
    known = asked.experienced(service, service.path_memory(), 2)
    ends = [
        q.tolist() for query in queries.draw("post", 2, seed=asked.TRAINING_SEED) for q in (query.start, query.goal)
    ]
    assert [end in known.milestones.tolist() for end in ends] == [True] * 4
    assert not known.remember


# --- promises


def told(what: str, states: int, **changes: Any) -> Row:
    row = {"what": what, "seed": 0, "build": 9, "states": [states] * 3, "search_ms": [0.4] * 3, "before_ms": [1.0] * 3}
    return {**row, "fell_back": 0, "solved": 3, "asked": 3, **changes}


def warm_promises(**changes: Any) -> list[str]:
    """Those that are broken."""
    rows = [
        {"scene": scene, **row}
        for scene in warm.PROMISED
        for row in (told(asked.DEFAULT, 600), told(warm.FRESH, 100) | changes)
    ]
    return [promise.text for promise in warm.promises(rows) if not promise.kept]


@pytest.mark.parametrize(
    ("changes", "broken"),
    [
        ({}, ()),
        ({"states": [151] * 3}, ("at most 150 states", "at most 0.2 of")),
        ({"states": [130] * 3}, ("at most 0.2 of",)),
        ({"search_ms": [0.41] * 3}, ("at most 0.4 ms",)),
        ({"solved": 2}, ("solved no less often",)),
    ],
)
def test_each_promise_of_a_warm_query_may_be_broken_on_its_own(
    changes: dict[str, Any], broken: tuple[str, ...]
) -> None:
    found = warm_promises(**changes)
    assert len(found) == 2 * len(broken)
    assert all(any(words in text for words in broken) for text in found)


def test_a_lazy_roadmap_that_costs_more_than_a_tree_breaks_its_promise() -> None:
    rows = [{"scene": s, **told(w, n)} for s in ("post", "bin") for w, n in (("lazyprm", 500), (asked.DEFAULT, 501))]
    assert [promise.kept for promise in lazy.promises(rows)] == [True, True]
    rows[0]["states"] = [502] * 3
    assert [promise.kept for promise in lazy.promises(rows)] == [False, True]


def test_a_stale_path_a_dear_update_and_an_untrue_verdict_break_their_promises() -> None:
    update: Row = {"share": 0.15, "untrue": 0}
    query: Row = {"what": "told", "ok": True, "verdict": "free", "untrue": 0}

    def kept(share: float = 0.15, **changes: Any) -> list[bool]:
        rows = [query | changes, query | {"what": moved.NOT_TOLD}, query | {"what": asked.DEFAULT}]
        return [promise.kept for promise in moved.promises([update | {"share": share}], rows)]

    assert kept() == [True, True, True, True]
    assert kept(share=0.16) == [False, True, True, True]
    assert kept(verdict="colliding") == [True, False, True, True]
    assert kept(ok=False, verdict="not_asked") == [True, True, False, True]
    assert kept(untrue=1) == [True, True, True, False]


# --- a moved obstacle


def test_one_of_ten_obstacles_moves_as_far_as_is_said_and_the_same_way_each_time() -> None:
    scene = ten_obstacles()
    assert len(scene.obstacles) == 10
    there = moved_scene(scene, 3, 0.25)
    assert there.hash == moved_scene(ten_obstacles(), 3, 0.25).hash
    before, after = (s.obstacle("object_3").pose.position for s in (scene, there))
    assert np.hypot(after[0] - before[0], after[1] - before[1]) == pytest.approx(0.25)
    assert {name for name, told in scene.obstacle_hashes.items() if there.obstacle_hashes[name] != told} == {"object_3"}


def test_a_lie_about_an_edge_is_found(service: PlannerService, small: Roadmap) -> None:
    assert untrue(small, service.checker) == 0
    verdicts = small.verdicts.copy()
    verdicts[[2, 5]] = [Verdict.FREE + Verdict.BLOCKED - verdicts[k] for k in (2, 5)]
    verdicts[7] = Verdict.UNKNOWN
    lying = replace(small, edge_knowledge=Knowledge(verdicts, small.edge_knowledge.blockers.copy(), ()))
    assert untrue(lying, service.checker) == 2
    assert untrue(lying, service.checker, np.array([1, 2, 7])) == 1


# --- a large one


def test_a_large_roadmap_tells_its_size_and_costs_nothing_to_ask_again() -> None:
    size, first, others, again = large.large_rows(("bin",), milestones=300, others=2)
    assert (size["milestones"], first["asked"], others["asked"]) == (300, 2, 20)
    assert 50 < size["traced"] < 10_000
    assert 50 < size["file"] < 10_000
    assert (again["fell_back"], again["solved"]) == (0, 20)
    assert np.median(again["states"]) < 0.2 * np.median(others["states"])


# --- the command


@pytest.mark.parametrize(
    ("measure", "told"),
    [
        ("toy", "toy has none; roadmaps and many and constrained and evidence and serve take it"),
        ("many", "many has same, speed"),
    ],
)
def test_a_part_is_an_argument_of_measures_with_such_a_part(
    measure: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert set(command.PARTS) == {"roadmaps", "many", "constrained", "evidence", "serve"}
    assert (command.PARTS["roadmaps"], command.PARTS["many"]) == (tuple(PARTS), tuple(many.PARTS))
    with pytest.raises(SystemExit, match="2"):
        command.main([measure, "--part", "warm"])
    assert f"--part: {told}" in capsys.readouterr().err
