"""The study of complete inverse kinematics keeps its promises on a few poses, and notices what is missing."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.studies import ik
from planner_service import inverse_kinematics
from planner_service.errors import UnknownName
from planner_service.kinematics import InverseSolutions


def test_a_few_poses_are_without_contradiction() -> None:
    report = ik.run(queries=6, robot="SO-101")
    assert all(promise.kept for promise in report.promises[:2])
    assert sum(row["solutions"] for row in report.rows) >= 3


def test_a_missing_solution_is_a_contradiction(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = inverse_kinematics

    def forgetful(*given: Any, **more: Any) -> InverseSolutions:
        found = whole(*given, **more)
        return InverseSolutions(found.q[1:], found.lower[1:], found.upper[1:], found.unresolved, found.boxes)

    monkeypatch.setattr(ik, "inverse_kinematics", forgetful)
    report = ik.run(queries=3, robot="WidowX AI")
    assert not report.promises[0].kept


def test_an_unknown_arm_is_refused() -> None:
    with pytest.raises(UnknownName, match="UR55"):
        ik.run(robot="UR55")
