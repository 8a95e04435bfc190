"""The study of complete inverse kinematics keeps its promises on a few poses, and notices what is missing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from benchmarks.studies import ik
from benchmarks.studies.ik import forgeries, poses
from planner_service import inverse_kinematics
from planner_service.errors import UnknownName
from planner_service.kinematics import InverseSolutions


def test_a_few_poses_are_without_contradiction() -> None:
    report = ik.run("poses", queries=6, robot="SO-101")
    assert all(promise.kept for promise in report.promises[:2])
    assert sum(row["solutions"] for row in report.rows) >= 3


def test_a_missing_solution_is_a_contradiction(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = inverse_kinematics

    def forgetful(*given: Any, **more: Any) -> InverseSolutions:
        found: InverseSolutions = whole(*given, **more)
        return replace(found, q=found.q[1:], lower=found.lower[1:], upper=found.upper[1:])

    monkeypatch.setattr(poses, "inverse_kinematics", forgetful)
    report = ik.run("poses", queries=3, robot="WidowX AI")
    assert not report.promises[0].kept


def test_an_unknown_arm_is_refused() -> None:
    with pytest.raises(UnknownName, match="UR55"):
        ik.run("poses", robot="UR55")


def test_no_forgery_of_a_few_is_accepted_and_honest_proofs_are() -> None:
    report = ik.run("forgeries", queries=42)
    assert all(promise.kept for promise in report.promises)
    assert sum(bool(row["why"]) for row in report.rows) >= 25


def test_a_verifier_that_believes_everything_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forgeries, "judged", lambda document: iter(document))
    report = forgeries.run(len(forgeries.FALSE), 0)
    assert not report.promises[0].kept
