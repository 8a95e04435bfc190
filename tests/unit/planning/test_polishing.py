"""An optimum leaves the service only if the honest checker finds it free, and it is proven; else what was before."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.worlds import queries
from planner_service import (
    Box,
    InvalidRequest,
    Obstacle,
    Optimise,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Reason,
    Scene,
    Stage,
)
from planner_service.certify import Certifier
from planner_service.geometry.arrays import FloatArray
from planner_service.optimize import Chomp, Figures, MethodResult, Optimum, TrajOpt
from planner_service.optimize.problem import CurveProblem
from planner_service.planning.polishing import judged
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedPlan, load_plan
from tests.support.optional import present

START, GOAL = (-2.5, 2.0), (2.2, -2.2)
"""The lesson's own query, among its discs."""


def asked(**changes: Any) -> PlanRequest:
    return PlanRequest(**{"start": START, "goal": GOAL, "seed": 7, "time_limit": None, **changes})


def query(scene: str, number: int, **changes: Any) -> PlanRequest:
    found = queries.load(scene)[number]
    return PlanRequest(**{"start": found.start, "goal": found.goal, "seed": number, "time_limit": None, **changes})


def bits(result: PlanResult) -> tuple[bytes, bytes]:
    path, trajectory = result.unwrap()
    return path.waypoints.tobytes() + path.blends.tobytes(), trajectory.coefficients.tobytes()


def clearance(service: PlannerService, result: PlanResult) -> float:
    path, _ = result.unwrap()
    limits = service.robot.limits
    Q = np.clip(path(np.linspace(0.0, path.length, 800)), limits.lower, limits.upper)
    return float(Certifier(service.robot, service.scene).clearances(Q).min())


@dataclass(frozen=True)
class Planted:
    """A method that answers with what was planted: every free corner moved by so much."""

    by: tuple[float, ...] = (0.0, 0.0)
    straight: bool = False
    name: str = "planted"

    def minimise(self, problem: CurveProblem, corners: FloatArray, held: tuple[int, int]) -> MethodResult:
        moved = corners.copy()
        if self.straight:
            moved = corners[0] + (corners[-1] - corners[0]) * np.linspace(0.0, 1.0, len(corners))[:, None]
            moved[-1] = corners[-1]
        moved[1:-1] += np.array(self.by)
        return MethodResult(moved, 1)


def planted(**settings: Any) -> Optimise:
    return Optimise(method=Planted(**settings))


# as a polish


def test_an_optimum_is_free_proven_shorter_faster_and_keeps_its_distance() -> None:
    service = PlannerService("wxai", "post")
    plain, polished = (service.plan(query("post", 6, polish=polish)) for polish in (None, Optimise()))
    assert polished.polish is not None
    assert polished.polish.kept
    assert present(polished.certificate).certified
    assert clearance(service, plain) < 0.004
    assert clearance(service, polished) >= 0.02
    assert present(polished.motion).duration < 0.85 * present(plain.motion).duration
    assert polished.polish.after.cost < polished.polish.before.cost
    assert polished.polish.after.length < polished.polish.before.length
    assert polished.polish.after.clearance == pytest.approx(clearance(service, polished), abs=2e-3)
    assert service.checker.path_is_free(polished.unwrap()[0])


def test_equal_requests_have_equal_plans_whatever_was_planned_before(bin_: PlannerService) -> None:
    request = query("bin", 2, polish=Optimise())
    first = bin_.plan(request)
    bin_.plan(query("bin", 5, polish=Optimise(method=Chomp(iterations=5))))
    again = bin_.plan(request)
    assert bits(first) == bits(again)
    assert (first.counts, first.polish) == (again.counts, again.polish)
    assert first.deterministic


def test_what_collides_is_not_kept_and_the_plan_is_the_one_without(discs: PlannerService) -> None:
    plain, polished = discs.plan(asked()), discs.plan(asked(polish=planted(straight=True)))
    assert bits(plain) == bits(polished)
    assert polished.polish is not None
    assert not polished.polish.kept
    assert "forearm x " in polished.polish.note
    assert "of the way" in polished.polish.note
    assert polished.notes == (f"not optimised: {polished.polish.note}",)


def test_what_leaves_the_limits_is_not_kept_and_it_is_said_which_joint(discs: PlannerService) -> None:
    polished = discs.plan(asked(polish=planted(by=(0.0, 5.0))))
    assert bits(discs.plan(asked())) == bits(polished)
    assert "elbow" in present(polished.polish).note
    assert "outside [-3.1416, 3.1416]" in present(polished.polish).note


FIGURES = Figures(cost=1.0, length=2.0, roughness=0.1, clearance=0.01, shortfall=0.5)


@pytest.mark.parametrize(
    ("changes", "kept"),
    [
        ({"cost": 0.9}, True),
        ({"cost": 1.1}, False),
        ({"cost": 1.1, "shortfall": 0.4}, True),  # room is worth a longer way
        ({"cost": 0.9, "shortfall": 0.6}, False),
    ],
)
def test_what_is_worse_is_not_kept(changes: dict[str, float], kept: bool) -> None:
    optimum = Optimum(np.zeros((3, 2)), FIGURES, replace(FIGURES, **changes), 1, 0)
    report = judged(Optimise(), optimum, None)
    assert (report.kept, not report.note) == (kept, kept)


def test_what_is_free_at_samples_but_not_proven_is_not_kept(
    discs: PlannerService, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The edge check is made blind: only the certificate is left between the curve and the caller."""
    from planner_service.collision import CollisionChecker

    plain = discs.plan(asked())
    monkeypatch.setattr(CollisionChecker, "path_is_free", lambda *_, **__: True)
    monkeypatch.setattr("planner_service.planning.polishing._worse", lambda *_: False)
    polished = discs.plan(asked(polish=planted(straight=True)))
    assert bits(plain) == bits(polished)
    assert present(polished.polish).note.startswith("the optimum is not proven: ")


def test_checks_that_are_spent_end_optimising_and_nothing_else(bin_: PlannerService) -> None:
    plain = bin_.plan(query("bin", 3))
    found = sum(plain.stage(stage).counts.states for stage in (Stage.ENDPOINTS, Stage.STRAIGHT_LINE, Stage.SEARCH))
    short = bin_.plan(query("bin", 3)).stage(Stage.SHORTCUT).counts.states
    result = bin_.plan(query("bin", 3, polish=Optimise(), max_checks=found + short + 400, retries=0))
    assert result.ok
    assert result.deterministic
    assert result.polish is None
    assert result.notes == ("not optimised: the check budget is spent",)


def test_a_free_line_with_room_stays_a_line_and_one_without_room_bends(discs: PlannerService) -> None:
    near = discs.with_scene(Scene(obstacles=(Obstacle("post", Box((0.02, 0.02, 0.2)), Pose((1.2, 0.6, 0.0))),)))
    roomy = discs.plan(PlanRequest((0.0, 0.0), (0.3, 0.2), time_limit=None, polish=Optimise()))
    assert roomy.polish is None
    assert len(roomy.unwrap()[0].waypoints) == 2
    request = PlanRequest((-0.2, 0.0), (0.9, 0.9), time_limit=None, polish=Optimise())
    plain, bent = near.plan(replace(request, polish=None)), near.plan(request)
    assert plain.ok
    assert present(bent.polish).kept
    assert clearance(near, bent) >= 0.02


# as a planner


def test_the_lessons_warning_the_straight_line_converges_into_collision_and_is_reported(discs: PlannerService) -> None:
    result = discs.plan(asked(planner=Optimise()))
    assert result.failure is not None
    assert (result.failure.reason, result.failure.stage) == (Reason.OPTIMUM_IN_COLLISION, Stage.SEARCH)
    assert "converged is not collision-free" in result.failure.detail
    assert "of the way: forearm x " in result.failure.detail
    assert [c.b for c in result.failure.contacts] == ["low_disc"]
    assert not present(result.polish).kept
    assert present(result.polish).after.clearance < 0.0
    assert result.path is None


def test_and_the_hybrid_solves_it(discs: PlannerService) -> None:
    result = discs.plan(asked(polish=Optimise()))
    assert present(result.polish).kept
    assert clearance(discs, result) >= 0.02


def test_an_optimum_that_is_not_proven_is_no_plan(discs: PlannerService, monkeypatch: pytest.MonkeyPatch) -> None:
    from planner_service.collision import CollisionChecker

    monkeypatch.setattr(CollisionChecker, "path_is_free", lambda *_, **__: True)
    result = discs.plan(asked(planner=Optimise()))
    assert present(result.failure).reason is Reason.OPTIMUM_IN_COLLISION
    assert "is not proven apart" in present(result.failure).detail


# requests, files, the command line


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"polish": TrajOpt()}, "polish"),
        ({"polish": Optimise(), "planner": Optimise()}, "polish"),
        ({"polish": Optimise(), "blend": 0.0}, "blend"),
        ({"planner": TrajOpt()}, "planner"),
    ],
)
def test_requests_that_make_no_sense_are_refused_by_name(given: dict[str, Any], named: str) -> None:
    with pytest.raises(InvalidRequest, match=f"^{named}: "):
        asked(**given)


def test_a_file_brings_back_the_settings_and_names_what_is_wrong_in_them(discs: PlannerService, tmp_path: Path) -> None:
    file, settings = tmp_path / "plan.json", Optimise(waypoints=30, smoothness=2.5, corners=4, method=Chomp(20, 0.01))
    result = discs.plan(asked(polish=Optimise()))
    save_plan(SavedPlan(discs.world, asked(polish=settings), result), file)
    read = load_plan(file)
    assert present(read.request).polish == settings
    assert (read.result.polish, bits(read.result)) == (result.polish, bits(result))
    document = json.loads(file.read_text())
    for change, told in [
        ({"method": {"name": "gradient", "settings": {}}}, "unknown method 'gradient'"),
        ({"corners": -1}, "corners"),
        ({"speed": 1}, "no other keys"),
    ]:
        broken = json.loads(json.dumps(document))
        broken["request"]["polish"]["settings"].update(change)
        file.write_text(json.dumps(broken))
        with pytest.raises(InvalidRequest, match=told):
            load_plan(file)


# the measure


# the picture
