from __future__ import annotations

import gc
import subprocess
import sys
import weakref
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from planner_service.collision.budget import SearchStopped
from planner_service.errors import InvalidRequest
from planner_service.planners import (
    AORRTC,
    BFMT,
    FMT,
    PLANNERS,
    PRM,
    RRT,
    BalancedRRTConnect,
    BITstar,
    InformedRRTstar,
    Planner,
    PRMstar,
    RRTConnect,
    RRTstar,
    SearchProblem,
    SORRTstar,
    planner_by_name,
)
from tests.support.discs import SEALED, WALL, DiscWorld, GlancingWorld, Stop, across
from tests.support.optional import present

QUICK: dict[str, Any] = {
    **{name: planner() for name, planner in PLANNERS.items()},
    "rrtstar": RRTstar(checks=3000),
    "informedrrtstar": InformedRRTstar(checks=3000),
    "sorrtstar": SORRTstar(checks=3000),
    "bitstar": BITstar(checks=2000),
    "aorrtc": AORRTC(checks=3000),
    "fmt": FMT(samples=200),
    "bfmt": BFMT(samples=200),
    "prm": PRM(milestones=200, neighbours=6),
    "prmstar": PRMstar(milestones=150),
}
RANGED = tuple(planner for planner in PLANNERS.values() if "range" in {item.name for item in fields(planner)})
CONNECTING = (BalancedRRTConnect(), RRTConnect())
"""The default, and OMPL's planner of the same kind."""

FEW = ("balancedrrtconnect", "rrtconnect", "bitstar", "kpiece1", "prm")
"""One of each kind of search."""

ANYTIME = ("rrtstar", "informedrrtstar", "sorrtstar", "bitstar", "aorrtc")


def outcome(planner: Planner, n: int = 2, seed: int = 0, **problem: Any) -> tuple[int, list[list[float]]]:
    world = DiscWorld()
    waypoints = planner.search(across(world, n=n, seed=seed, **problem)).waypoints
    return world.states, [] if waypoints is None else waypoints.tolist()


@pytest.mark.parametrize("name", QUICK)
def test_every_planner_finds_a_path_of_free_edges_from_start_to_goal(name: str) -> None:
    world = DiscWorld()
    problem = across(world)
    result = QUICK[name].search(problem)
    assert result.waypoints is not None
    assert result.goal_index == 0
    assert result.waypoints[0].tolist() == problem.start.tolist()
    assert result.waypoints[-1].tolist() == problem.goals[0].tolist()
    assert world.found_free(result.waypoints)
    assert result.stopped is None


@pytest.mark.slow
@pytest.mark.parametrize("name", FEW)
def test_equal_seeds_give_equal_counts_and_paths_whatever_ran_in_between(name: str) -> None:
    first = outcome(QUICK[name])
    for planner in CONNECTING:
        outcome(planner, seed=5)
    assert outcome(QUICK[name]) == first


@pytest.mark.slow
@pytest.mark.parametrize("planner", CONNECTING, ids=lambda planner: planner.name)
def test_a_second_process_finds_the_same_path(planner: Planner) -> None:
    code = f"from tests.unit.search.test_planners import *; print(outcome({planner}, n=6, seed=3))"
    root = Path(__file__).parents[3]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(outcome(planner, n=6, seed=3))
    assert done.stderr == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", FEW)
def test_any_goal_of_a_set_will_do_and_the_result_says_which(name: str) -> None:
    walled_off = ((2.0, 2.0), (2.2, -0.5))
    discs = (*WALL, *((2.0 + 0.5 * np.cos(k), 2.0 + 0.5 * np.sin(k), 0.26) for k in np.arange(0, 6.3, 0.5)))
    world = DiscWorld(discs)
    result = QUICK[name].search(across(world, goals=walled_off))
    assert result.goal_index == 1
    assert tuple(present(result.waypoints)[-1].tolist()) == walled_off[1]
    assert world.found_free(present(result.waypoints))


@pytest.mark.parametrize("name", QUICK)
def test_what_the_oracle_raises_comes_out_unchanged(name: str) -> None:
    for limit in [0, 40]:
        mine = Stop("the limit")
        problem = across(DiscWorld(limit=limit, error=Mock(return_value=mine)))
        with pytest.raises(Stop, match="the limit") as caught:
            QUICK[name].search(problem)
        assert caught.value is mine


@pytest.mark.parametrize("name", FEW)
def test_what_poll_raises_comes_out_unchanged(name: str) -> None:
    calls: list[None] = []

    def poll() -> None:
        calls.append(None)
        if len(calls) > 5:
            raise Stop("time is up")

    with pytest.raises(Stop, match="time is up"):
        QUICK[name].search(across(DiscWorld(SEALED), poll=poll))


@pytest.mark.parametrize("name", ANYTIME[::2])
def test_a_limit_leaves_an_anytime_planner_the_path_in_its_hand(name: str) -> None:
    first, _ = outcome(replace(QUICK[name], checks=1))
    world = DiscWorld(limit=first + 500, error=lambda: SearchStopped("enough"))
    result = replace(QUICK[name], checks=100_000).search(across(world))
    assert isinstance(result.stopped, SearchStopped)
    assert world.found_free(present(result.waypoints))


@pytest.mark.parametrize("name", FEW[:4])
def test_without_a_way_through_the_limit_ends_the_search(name: str) -> None:
    problem = across(DiscWorld(SEALED, limit=4000, error=lambda: SearchStopped("enough")))
    with pytest.raises(SearchStopped, match="enough"):
        QUICK[name].search(problem)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["prm", "lazyprm"])
def test_without_a_way_through_a_roadmap_has_no_path(name: str) -> None:
    assert QUICK[name].search(across(DiscWorld(SEALED))).waypoints is None


@pytest.mark.parametrize("planner", CONNECTING, ids=lambda planner: planner.name)
def test_two_trees_that_meet_judge_no_configuration_twice(planner: Any) -> None:
    for seed in range(10):
        world = DiscWorld()
        problem = across(world, n=6, seed=seed)
        assert replace(planner, range=0.3).search(problem).waypoints is not None
        assert len(set(world.judged)) == len(world.judged)
        assert not {tuple(q.tolist()) for q in (problem.start, problem.goals[0])} & set(world.judged)


@pytest.mark.parametrize("name", QUICK)
def test_no_planner_asks_about_an_edge_twice(name: str) -> None:
    world = DiscWorld()
    QUICK[name].search(across(world))
    assert len({frozenset(edge) for edge in world.edges}) == len(world.edges)


@pytest.mark.slow
@pytest.mark.parametrize("name", FEW)
def test_nothing_of_a_query_outlives_it(name: str) -> None:
    for limit in [None, 30]:
        world = DiscWorld(limit=limit)
        gone = weakref.ref(world)
        try:
            QUICK[name].search(across(world))
        except Stop:
            assert limit is not None
        del world
        gc.collect()
        assert gone() is None


def test_every_planner_has_its_name() -> None:
    assert {name: type(planner_by_name(name.upper())) for name in PLANNERS} == dict(PLANNERS)
    assert all(planner.name == name for name, planner in PLANNERS.items())


def test_a_setting_out_of_range_is_refused_by_name() -> None:
    for planner, setting, value in [
        (RRTConnect, "range", 0.0),
        (RRT, "goal_bias", 1.1),
        (BITstar, "samples", 1.5),
        (BFMT, "samples", True),
        (PRMstar, "max_checks", 0),
        *((planner, "range", value) for planner in RANGED for value in (10**400, 1e308, 1e-320, True, None)),
        (RRT, "goal_bias", 10**400),
        (PRM, "milestones", 100_001),
    ]:
        with pytest.raises(InvalidRequest, match=setting):
            planner(**{setting: value})


def test_a_problem_that_makes_no_sense_is_refused_by_field() -> None:
    for field, value in [
        ("start", [0.0]),
        ("start", [4.0, 0.0]),
        ("goals", np.zeros((0, 2))),
        ("goals", [[0.0, float("inf")]]),
        ("upper", [3.0, -3.0]),
        ("seed", -1),
    ]:
        problem = across(DiscWorld())
        fields = {name: getattr(problem, name) for name in ("start", "goals", "lower", "upper", "oracle", "seed")}
        with pytest.raises(InvalidRequest, match=field):
            SearchProblem(**{**fields, field: value})


@pytest.mark.slow
def test_interrupted_searches_do_not_crash_the_process_even_while_their_exceptions_are_kept() -> None:
    """Frames in a kept traceback once held OMPL's states beyond their time: the next search crashed the process."""
    program = (
        "from planner_service.planners import RRTConnect\n"
        "from tests.support.discs import DiscWorld, Stop, across\n"
        "kept = []\n"
        "for k in range(150):\n"
        "    try:\n"
        "        RRTConnect(range=0.2).search(across(DiscWorld(limit=5 + k % 40), n=6, seed=k))\n"
        "    except Stop as stop:\n"
        "        kept.append(stop)\n"
        "    RRTConnect().search(across(DiscWorld(), n=6, seed=k))\n"
        "print(len(kept))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100


@pytest.mark.parametrize("planner", [BalancedRRTConnect(range=1.0), RRTConnect()], ids=lambda planner: planner.name)
def test_a_path_of_edges_only_looked_at_is_judged_and_grown_again_until_every_edge_is_free(planner: Planner) -> None:
    refuted = 0
    for seed in range(5):
        worlds = GlancingWorld(), GlancingWorld()
        first, again = (planner.search(across(world, seed=seed)).waypoints for world in worlds)
        assert first is not None
        assert again is not None
        assert first.tolist() == again.tolist()
        assert worlds[0].found_free(first)
        assert worlds[0].judged == worlds[1].judged
        refuted += len(worlds[0].edges) - len(worlds[0].free_edges)
    assert refuted > 5
