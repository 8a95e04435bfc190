"""The study of the gate lets sound verdicts pass, and finds gates that prove less than they should."""

from __future__ import annotations

import pytest

from benchmarks.studies import gate
from benchmarks.studies.gate import chunks, refusals, times, tubes, violations
from benchmarks.studies.gate.chunks import ChunkWork

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


def test_nothing_in_a_proven_tube_touches() -> None:
    (row,) = tubes.run(2, seed=0, robot="panda").rows
    assert (row["tubes"], row["touching"]) == (2, 0)
    assert 0.0 < row["proven_share"] <= 1.0
