"""What is not finite is never free: below the layer that checks what callers give, too."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planner_service.certify import Certifier
from planner_service.certify.certifier import Prover, instruction_sets
from planner_service.certify.motion_bounds import Motion
from planner_service.certify.pairs import ProofPairs
from planner_service.collision import CollisionChecker
from planner_service.collision.backends import BackendName, make_backend
from planner_service.collision.clearance import Clearances
from planner_service.collision.native_kernel import build_kernel
from planner_service.collision.native_kernel import instruction_sets as kernel_instruction_sets
from planner_service.collision.swept_bounds import Sweep
from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene

WXAI, BIN = load_robot("wxai"), load_scene("bin")
CHECKER = CollisionChecker(WXAI, BIN)
BACKENDS: list[BackendName] = ["native", "fcl"]
BAD = [math.nan, math.inf]
bad_values = pytest.mark.parametrize("value", BAD)


def rows(value: float, count: int = 8) -> FloatArray:
    """Free configurations, in one of which one entry is that value: the others are swept together with it."""
    Q = np.tile(WXAI.home, (count, 1))
    Q[count // 2, 2] = value
    return Q


@bad_values
@pytest.mark.parametrize("backend", BACKENDS)
def test_no_backend_answers(backend: BackendName, value: float) -> None:
    made = make_backend(backend, WXAI, CHECKER.parts)
    Q = rows(value)
    assert made.first_collision(rows(0.5), 0, 0) is None
    with pytest.raises((BrokenInvariant, ValueError), match="finite"):
        made.first_collision(Q, 0, len(Q))
    with pytest.raises((BrokenInvariant, ValueError), match="finite"):
        list(made.colliding(Q))
    with pytest.raises((BrokenInvariant, ValueError), match="finite"):
        made.touching(Q[len(Q) // 2])


@bad_values
def test_no_clearance_is_told(value: float) -> None:
    clearances = Clearances(WXAI, CHECKER.parts)
    with pytest.raises(BrokenInvariant, match="finite"):
        clearances.smallest_gap(rows(value)[4])
    with pytest.raises(BrokenInvariant, match="finite"):
        clearances.overlaps(rows(value)[4], np.zeros(1, dtype=np.intp))


@bad_values
@pytest.mark.parametrize("variant", kernel_instruction_sets())
def test_no_kernel_answers(variant: str, value: float) -> None:
    kernel = build_kernel(WXAI, CHECKER.parts, variant)
    Q = rows(value)
    good, bad = WXAI.home.tolist(), Q[len(Q) // 2].tolist()
    for ask in (
        lambda: kernel.candidates(Q),
        lambda: kernel.check_rows(Q, 0, len(Q)),
        lambda: kernel.near(Q, 0.01),
        lambda: kernel.check_edge_rows(good, bad, 3, 8, 0, 9),
        lambda: kernel.check_edge_rows(bad, good, 3, 8, 0, 9),
    ):
        with pytest.raises(ValueError, match="finite"):
            ask()
    with pytest.raises(ValueError, match="finite"):
        build_kernel(WXAI, CHECKER.parts, variant, margin=value)


def provers() -> list[Prover]:
    motion = Motion(WXAI, ProofPairs(WXAI, BIN, ()))
    return [Prover(motion, variant) for variant in instruction_sets()]


@bad_values
def test_nothing_is_proven_clear(value: float) -> None:
    usual, *others = provers()
    expected = usual.clearances(rows(0.5))
    for prover in (usual, *others):
        found = prover.clearances(rows(value))
        assert found[4] == -math.inf
        assert np.array_equal(np.delete(found, 4), np.full(7, usual.clearances(WXAI.home[None])[0]))
        assert np.array_equal(prover.clearances(rows(0.5)), expected)
    with pytest.raises(InvalidRequest):
        Certifier(WXAI, BIN).clearances(rows(value))


@pytest.mark.parametrize("value", [1e300, -1e300, 1e308])
def test_what_overflows_is_not_proven_clear(value: float) -> None:
    """A turn by so much is a turn; what slides so far would be nowhere."""
    for prover in provers():
        assert not np.isnan(prover.clearances(rows(value))).any()


@bad_values
def test_no_edge_is_still_free(value: float) -> None:
    sweep = Sweep(CHECKER, [BIN.obstacles[-1].name])
    nothing = Sweep(CHECKER, [])
    good, bad = np.tile(WXAI.home, (8, 1)), rows(value)
    assert nothing.still_free(good, good).all()
    for A, B in ((good, bad), (bad, good), (bad, bad)):
        for asked in (sweep, nothing):
            expected = asked.still_free(good, good)
            expected[4] = False
            assert np.array_equal(asked.still_free(A, B), expected)
