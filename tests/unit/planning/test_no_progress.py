"""A search without progress is followed by a proof that there is no path, and by one with less padding."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from auditor import verify_no_path
from planner_service import Cylinder, Obstacle, PlannerService, PlanRequest, PlanResult, Pose, Reason, Scene, Stage
from planner_service.planning import pipeline
from planner_service.planning.search_stage import FIRST_TRIES
from planner_service.records.exports.no_path_file import save_no_path
from tests.support.optional import present


def two_discs() -> PlannerService:
    """The upper arm of the planar arm cannot turn past either."""
    discs = [Obstacle(name, Cylinder(0.1, 0.2), Pose((0.5, y, 0.0))) for name, y in (("left", 0.5), ("right", -0.5))]
    return PlannerService("planar2", Scene(tuple(discs)))


def between(**changes: object) -> PlanRequest:
    return PlanRequest([0.0, 0.0], [3.0, 0.0], **{"time_limit": None, "max_checks": 100_000} | changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def proven() -> PlanResult:
    return two_discs().plan(between())


def test_a_plan_that_cannot_exist_is_proven_to(proven: PlanResult) -> None:
    failure = present(proven.failure)
    assert (failure.reason, failure.stage, failure.proven) == (Reason.NO_PATH, Stage.NO_PATH, True)
    assert failure.detail.startswith("no path exists: upper_arm x left")
    assert ("upper_arm", "left") in [pair[:2] for pair in failure.blocked_by]


def test_the_proof_in_a_result_can_be_saved_and_is_valid_to_the_auditor(proven: PlanResult, tmp_path: Path) -> None:
    path = tmp_path / "proof.json"
    request = between()
    save_no_path(present(proven.no_path), two_discs().world, request.start, [[3.0, 0.0]], path)
    assert any(line.startswith("verified") for line in verify_no_path.verify(json.loads(path.read_text())))


def test_it_is_looked_for_after_the_first_tries_and_not_before(proven: PlanResult) -> None:
    assert proven.attempts == FIRST_TRIES
    found = PlannerService("planar2", "discs").plan(PlanRequest([-2.5, 2.0], [2.2, -2.2], time_limit=None))
    assert found.ok
    assert Stage.NO_PATH not in [report.stage for report in found.stages]


def test_of_a_start_that_is_left_by_a_way_out_nothing_is_proven() -> None:
    service = two_discs()
    angles = (0.6 + 1e-3 * k for k in range(100))
    touching = next([angle, 0.0] for angle in angles if not service.checker.state_is_free([angle, 0.0]))
    request = PlanRequest(touching, [3.0, 0.0], time_limit=None, max_checks=20_000)
    assert present(service.plan(request).failure).reason is Reason.CHECK_BUDGET_EXHAUSTED
    assert service.explain(request, plans=1).no_path is None


def test_after_its_last_pause_a_search_goes_on_until_its_budget_is_spent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "PAUSES", (1, 2))
    service = two_discs()
    angles = (0.6 + 1e-3 * k for k in range(100))
    touching = next([angle, 0.0] for angle in angles if not service.checker.state_is_free([angle, 0.0]))
    result = service.plan(PlanRequest(touching, [3.0, 0.0], time_limit=None, max_checks=150_000))
    assert present(result.failure).reason is Reason.CHECK_BUDGET_EXHAUSTED
    assert result.attempts > 2
