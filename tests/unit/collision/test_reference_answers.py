"""Verdicts, counts, clearances and depths on the worlds of the collision laws, and how often FCL is asked for them.

The laws say why the answers are right. These numbers, those of release 0.1.0 but for what its kernel asked more often,
notice when a sieve still proves nothing wrong but less, so that FCL has to be asked more often.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import fcl
import numpy as np
import pytest

from planner_service.collision import CollisionChecker
from tests.laws.test_collision_laws import SETUPS, Setup

ROWS: dict[str, tuple[int, int, float, float, int]] = {
    "bin": (29, 3297, 0.133616893, 0.501285703, 0),
    "post": (24, 964, 0.048532378, 0.644484691, 0),
    "round": (21, 2434, -0.037648651, 0.608759233, 0),
    "padded round": (18, 1651, -0.095671079, 0.698701209, 0),
    "rod in shelf": (26, 3038, -0.244295396, 0.655880206, 0),
    "padded rod in window": (22, 1580, -0.274064011, 0.828026998, 1),
    "allowed": (25, 2413, 0.089977095, 0.535808220, 3),
    "cloud and field around a rod": (22, 2492, -0.212004389, 0.727160844, 0),
    "padded stool": (24, 3245, -0.013852758, 0.625115649, 0),
    "fork between stools": (26, 3648, -0.010680217, 0.610326985, 0),
}
"""By world: configurations of 40 that are free, states of 39 edges through these, the sum of 12 clearances and that of
all depths of contact at 12 configurations, then the questions to FCL for the states and edges."""


class Questions:
    """Counts what FCL is asked."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.count, ask = 0, fcl.collide

        def counted(*arguments: Any) -> Any:
            self.count += 1
            return ask(*arguments)

        patch.setattr(fcl, "collide", counted)


def answers(checker: CollisionChecker, patch: pytest.MonkeyPatch) -> tuple[tuple[Any, ...], int]:
    limits = checker.robot.limits
    Q = np.random.default_rng(3).uniform(limits.lower, limits.upper, (40, checker.robot.n))
    Q[20:] = checker.robot.home + 0.3 * (Q[20:] - checker.robot.home)
    with patch.context() as patched:
        questions = Questions(patched)
        free = sum(map(checker.state_is_free, Q))
        before = checker.counts
        for a, b in pairwise(Q):
            checker.edge_is_free(a, b)
        states = (checker.counts - before).states
    clearances = sum(map(checker.clearance, Q[14:26]))
    depths = sum(contact.depth for q in Q[14:26] for contact in checker.contacts(q))
    return (free, states, clearances, depths), questions.count


@pytest.mark.slow
@pytest.mark.parametrize("setup", [setup for setup in SETUPS if setup.name in ROWS], ids=lambda setup: setup.name)
def test_answers_and_questions_are_those_of_the_first_release(setup: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    free, states, clearances, depths, questions = ROWS[setup.name]
    usual = setup.checker()
    checker = CollisionChecker(usual.robot, usual.scene, padding=usual.padding, allowed=usual.allowed)
    found, asked = answers(checker, monkeypatch)
    assert found[:2] == (free, states)
    assert found[2:] == pytest.approx((clearances, depths), abs=2e-8)
    assert asked == questions
