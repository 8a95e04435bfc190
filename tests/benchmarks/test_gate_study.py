"""The study of the gate lets sound verdicts pass, and finds gates that prove less than they should."""

from __future__ import annotations

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from benchmarks.studies import gate
from benchmarks.studies.gate import chunks, refusals, session, times, tubes, violations
from benchmarks.studies.gate.chunks import ChunkWork
from benchmarks.studies.gate.judge import LOOK, Judge
from benchmarks.studies.gate.worlds import world
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray

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
    report = gate.run(part="session", queries=1)
    gated, bare = report.rows
    assert gated["contacts"] == 0
    assert bare["contacts"] > 0
    if gated["lost"] and gated["late"] > session.LATE:
        pytest.skip(f"this process was {gated['late']:.3f} s late on each of {session.DAYS} days; nothing was touched")
    assert all(promise.kept for promise in report.promises)


class _Points:
    """A checker of a point of two joints among four diamonds: gaps shrink as fast as its bound allows."""

    def __init__(self, middles: FloatArray) -> None:
        self.middles, self.joints, self.reach = middles, ["x", "y"], np.ones(2)
        self.pairs = [("point", str(k)) for k in range(len(middles))]

    def pair_reaches(self) -> FloatArray:
        return np.ones((len(self.pairs), 2))

    def gaps(self, Q: FloatArray) -> FloatArray:
        return np.asarray(np.abs(Q[:, None] - self.middles).sum(axis=2) - 0.1)

    def gaps_at(self, Q: FloatArray, numbers: list[list[int]]) -> FloatArray:
        gaps = self.gaps(Q)
        return np.concatenate([row[np.asarray(some, dtype=int)] for row, some in zip(gaps, numbers, strict=True)])

    def moved(self, name: str, position: FloatArray, _: None) -> _Points:
        middles = self.middles.copy()
        middles[int(name)] = position
        return _Points(middles)


def test_the_judge_finds_what_touches_where_its_bound_is_reached() -> None:
    """On a way, on ways beside it and on others that lead away from its corners, in scenes that change: what it keeps
    of one place hides nothing at another."""
    rng, found = np.random.default_rng(1), [0, 0]
    for _ in range(40):
        points = _Points(rng.uniform(-0.5, 0.5, (4, 2)))
        judge = Judge(points)  # type: ignore[arg-type]
        q = np.zeros(2)
        for scale in (0.0, 0.02, 0.1, 0.02, 0.0, 0.02):
            way = q + np.cumsum(rng.normal(0.0, 0.04, (20, 2)), axis=0)
            beside = way + rng.uniform(-scale, scale, way.shape)
            a = np.concatenate([beside[:-1], beside[1:-1]])
            b = np.concatenate([beside[1:], beside[1:-1] + rng.uniform(-scale, scale, (18, 2))])
            near = np.array([(k, k + 1) for k in range(19)] + [(k, k) for k in range(1, 19)])
            hit = judge.walked(way)
            lines = np.stack([way[:-1], way[1:]], axis=1)
            if hit is None:
                hit, lines = judge.touched(a, b, judge.corners(way), near), np.stack([a, b], axis=1)
            shares = np.linspace(0.0, 1.0, 400)[:, None]
            least = min(float(points.gaps(one + shares * (other - one)).min()) for one, other in lines)
            found[hit is None] += 1
            assert (hit is not None) or least > -LOOK
            assert (hit is None) or (least <= LOOK and points.gaps(np.array([hit.at])).min() <= 0.0)
            q = way[-1]
            if rng.random() < 0.3:
                name, position = str(int(rng.integers(4))), rng.uniform(-0.5, 0.5, 2)
                points, judge = points.moved(name, position, None), judge.moved(name, position, ())
    assert min(found) > 20


def test_the_judge_finds_what_dense_looks_find() -> None:
    """Of a robot, with Coal's distances and the auditor's bound."""
    rng, found = np.random.default_rng(1), [0, 0]
    for number in range(8):
        place = world("ur5", 3, number).near_contact(rng).changed(rng)
        judge, checker = (
            place.judge,
            IndependentChecker(data_folder("robots") / "ur5", tables_of(place.service.scene)),
        )
        for _ in range(4):
            way = place.start + np.cumsum(rng.normal(0.0, 0.02, (6, place.n)), axis=0)
            for q in way[[-1, 0]]:
                assert judge.gap(q) == pytest.approx(min(checker.gaps(q).values()), abs=1e-6)
            hit, dense = judge.walked(way), checker.path_touch(way, 0.0005)
            found[hit is None] += 1
            if dense is not None and dense.b != "limit":
                assert hit is not None
            if hit is not None:
                assert min(checker.gaps(hit.at).values()) <= 0.0
    assert min(found) > 3


def test_nothing_in_a_proven_tube_touches() -> None:
    (row,) = tubes.run(2, seed=0, robot="panda").rows
    assert (row["tubes"], row["touching"]) == (2, 0)
    assert 0.0 < row["proven_share"] <= 1.0
