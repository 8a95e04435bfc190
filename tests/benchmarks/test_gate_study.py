"""The study of the gate lets sound verdicts pass, and finds gates that prove less than they should."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from benchmarks.studies import gate
from benchmarks.studies.gate import chunks, refusals, times, tubes, violations
from benchmarks.studies.gate.chunks import ChunkWork
from benchmarks.studies.gate.worlds import world
from planner_service.files.package_data import data_folder

ATTACK = (1, 5, 9, 13)
"""Sessions that attack; see ``chunks.SOURCES``."""


def _touched(fault: str, sessions: int) -> int:
    work = ChunkWork("", 0, ("wxai",), seed=0, fault=fault)
    return sum(len(work(item)[2].touched) for item in range(sessions))


def test_no_target_that_passes_touches() -> None:
    for item in ATTACK:
        _, _, tally = ChunkWork("", 0, ("wxai",), seed=0)(item)
        assert tally.passed > 0
        assert not tally.touched


@pytest.mark.parametrize("fault", chunks.FAULTY[:2])
def test_a_gate_that_proves_less_is_found(fault: str) -> None:
    assert _touched(fault, 6) > 0


def test_a_driver_that_strays_is_noticed() -> None:
    report = violations.run(violations.CHECKS, seed=0, robot=None)
    assert all(promise.kept for promise in report.promises)
    assert [row["sessions"] for row in report.rows] == [1] * len(report.rows)


def test_times_and_refusals_are_counted() -> None:
    taken = times.run(5, seed=0, robot="wxai")
    assert [row["checks"] for row in taken.rows] == [5] * 4
    (row,) = refusals.run(2, seed=0, robot="wxai").rows
    assert row["clear"] == 2
    assert row["refused"] == sum(row["kinds"].values())


@pytest.mark.slow
def test_an_arm_whose_policy_is_killed_comes_to_rest() -> None:
    report = gate.run(part="kill", queries=1, robot="wxai")
    assert all(promise.kept for promise in report.promises)


@pytest.mark.sim
@pytest.mark.slow
def test_a_session_in_simulation_touches_nothing_behind_the_gate_alone() -> None:
    assert all(promise.kept for promise in gate.run(part="session", queries=1).promises)


@pytest.mark.parametrize("name", ["wxai", "panda"])
def test_the_judge_finds_what_dense_looks_find_and_its_gaps_hold(name: str) -> None:
    """On random ways, one after the other, near each other or not: what it keeps of the one before hides nothing."""
    rng, found = np.random.default_rng(1), [0, 0]
    for number in range(6):
        place = world(name, 3, number)
        judge, checker = place.judge, IndependentChecker(data_folder("robots") / name, tables_of(place.service.scene))
        q = place.start
        for _ in range(8):
            way = np.concatenate([q[None], q + np.cumsum(rng.normal(0.0, 0.08, (4, place.n)), axis=0)])
            walked, dense = judge.walked(way), checker.path_touch(way, 0.0005)
            found[walked.touch is None] += 1
            if dense is not None and dense.b != "limit":
                assert walked.touch is not None
            if walked.touch is not None:
                assert min(checker.gaps(walked.at).values()) <= 0.0
                continue
            for k, share in itertools.product(range(4), (0.0, 0.3, 0.7, 1.0)):
                checker.place(way[k] + share * (way[k + 1] - way[k]))
                gaps = np.array([checker.gap_of(pair) for pair in range(len(checker.pairs))])
                assert np.all(gaps >= walked.gaps[k] - 1e-6)
            q = way[-1] if rng.random() < 0.7 else place.goal
    assert min(found) > 3


@pytest.mark.parametrize("name", ["wxai", "ur5"])
def test_beside_a_way_that_is_known_the_judge_finds_what_dense_looks_find(name: str) -> None:
    """On ways beside it, and on others that lead away from their corners."""
    rng, found = np.random.default_rng(2), [0, 0]
    for number in range(10):
        place = world(name, 3, number).near_contact(rng)
        judge, checker = place.judge, IndependentChecker(data_folder("robots") / name, tables_of(place.service.scene))
        way = np.concatenate([place.start[None], place.start + np.cumsum(rng.normal(0.0, 0.02, (5, place.n)), axis=0)])
        walked = judge.walked(way)
        if walked.touch is not None:
            continue
        for scale in (0.01, 0.1, 0.3):
            points = way + rng.uniform(-scale, scale, way.shape)
            ends = points[1:-1] + rng.uniform(-scale, scale, (4, place.n))
            off, away = np.abs(points - way), np.abs(ends - way[1:-1])
            rooms = np.maximum(off[:-1], off[1:]), np.maximum(off[1:-1], away)
            touch, at = judge.beside(points, rooms[0], ends, rooms[1], walked.gaps)
            ways = [points, *np.stack([points[1:-1], ends], axis=1)]
            dense = [checker.path_touch(each, 0.0005) for each in ways]
            found[touch is None] += 1
            if any(each is not None and each.b != "limit" for each in dense):
                assert touch is not None
            if touch is not None:
                assert min(checker.gaps(at).values()) <= 0.0
    assert min(found) > 3


def test_nothing_in_a_proven_tube_touches() -> None:
    (row,) = tubes.run(2, seed=0, robot="panda").rows
    assert (row["tubes"], row["touching"]) == (2, 0)
    assert 0.0 < row["proven_share"] <= 1.0
