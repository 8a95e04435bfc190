"""A search without progress is followed by a proof that there is no path, and by one with less padding."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from auditor import verify_no_path
from planner_service import (
    Box,
    Cylinder,
    Obstacle,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Reason,
    Scene,
    Stage,
)
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


def test_the_proof_is_counted_and_the_same_each_time(proven: PlanResult) -> None:
    again = two_discs().plan(between())
    assert proven.counts == again.counts
    assert proven.stage(Stage.NO_PATH).counts.distances == present(proven.no_path).distances > 0
    assert proven.stage(Stage.NO_PATH).counts.states == 0
    assert proven.deterministic
    assert present(again.no_path).wall_cells.tolist() == present(proven.no_path).wall_cells.tolist()


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


@pytest.mark.slow
def test_a_path_that_cannot_keep_the_padding_is_found_with_less_and_says_so_first() -> None:
    board = Obstacle(
        "board", Box((0.2744, 0.3082, 0.0645)), Pose((0.1769, -0.2671, 0.3956), (0.6914, -0.5715, -0.2179, 0.3845))
    )
    drum = Obstacle(
        "drum", Cylinder(0.0898, 0.3822), Pose((0.2562, -0.0192, 0.1465), (-0.1819, -0.7661, 0.4758, 0.3920))
    )
    start, goal = [-2.003, 2.892, 2.312, -0.167, 1.161, 0.614], [-1.583, 0.934, 1.142, 0.352, -1.019, -2.619]
    service = PlannerService("wxai", Scene((board, drum)))
    result = service.plan(PlanRequest(start, goal, time_limit=None, max_checks=200_000))
    certificate = present(result.certificate)
    assert certificate.certified
    assert 0.0 < result.padding < 0.001
    assert "less than the padding of 1 mm" in result.notes[0]
    assert any("with 0.5 mm of padding" in note for note in result.notes)
    assert result.deterministic


def test_a_failure_that_stays_open_says_what_was_tried() -> None:
    slit = [Obstacle(name, Box((0.4, 0.02, 0.2)), Pose((-1.3, y, 0.0))) for name, y in (("l", 0.03), ("r", -0.03))]
    service = PlannerService(
        "planar2", Scene((*slit, Obstacle("stop", Box((0.02, 0.2, 0.2)), Pose((-1.53, 0.0, 0.0)))))
    )
    failure = present(service.plan(PlanRequest([0.0, 0.0], [3.14159, 0.0], max_checks=6_000, time_limit=None)).failure)
    assert failure.reason is Reason.CHECK_BUDGET_EXHAUSTED
    assert "whether a path exists is unknown (no proof that there is none in " in failure.detail
