"""What leaves the service is blended, proven and timed, or it does not leave."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from benchmarks.worlds import queries
from planner_service import (
    Box,
    CollisionChecker,
    Cylinder,
    InvalidRequest,
    JointPath,
    JointStep,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    Reason,
    Scene,
    SCurve,
    Stage,
    ToppRa,
)
from planner_service.geometry.arrays import FloatArray
from planner_service.planning import AllowedStretch, pipeline
from planner_service.search.problem import SearchProblem, SearchResult
from tests.support.optional import present

START, GOAL = (0.0, 0.0), (math.pi / 2, -math.pi / 2)
ROOT = Path(__file__).parents[3]
COARSE = JointStep(0.6)
"""Samples so far apart that the arm passes a thin post between two of them."""


def thin_post(angle: float) -> Obstacle:
    x, y = 1.2 * math.cos(angle), 1.2 * math.sin(angle)
    return Obstacle("post", Cylinder(0.002, 0.2), Pose((x, y, 0.0)))


def asked(start: object = START, goal: object = GOAL, **settings: object) -> PlanRequest:
    return PlanRequest(**{"start": start, "goal": goal, "time_limit": None, **settings})  # type: ignore[arg-type]


def is_free(service: PlannerService, path: JointPath) -> bool:
    """Of the planar arm's path, at samples that leave less than a tenth of a millimetre of motion between them."""
    checker = CollisionChecker(service.robot, service.scene, edge_step=JointStep(5e-5))
    return all(map(checker.state_is_free, path(np.linspace(0.0, path.length, 1 + math.ceil(path.length / 5e-5)))))


class GivenPaths:
    """A planner that answers with one given path after the other, the last for ever."""

    name = "given"
    patience = None

    def __init__(self, *paths: list[tuple[float, float]]) -> None:
        self._paths = list(paths)
        self.judges: list[CollisionChecker] = []

    @property
    def asked(self) -> int:
        """How often."""
        return len(self.judges)

    def search(self, problem: SearchProblem) -> SearchResult:
        path = self._paths[min(self.asked, len(self._paths) - 1)]
        self.judges.append(problem.oracle._checker)  # type: ignore[attr-defined]
        return SearchResult(np.array(path))


# -- proven ---------------------------------------------------------------------------------------


def test_a_plan_comes_with_its_proof_and_what_that_cost(discs: PlannerService) -> None:
    result = discs.plan(asked())
    assert result.certificate is not None
    assert result.certificate.certified
    assert result.certificate.clearance > 0.0
    assert result.stage(Stage.CERTIFY).counts.distances == result.certificate.distances > 0
    assert result.counts.distances == result.certificate.distances
    assert is_free(discs, result.unwrap()[0])


def test_a_path_that_cannot_be_proven_is_searched_again_and_the_proven_one_leaves() -> None:
    service = PlannerService("planar2", Scene((thin_post(0.75),)), edge_step=COARSE)
    around = [START, (0.0, 2.8), (1.5, 2.8), (1.5, 0.0)]
    planner = GivenPaths([START, (1.5, 0.0)], around)
    result = service.plan(asked(goal=(1.5, 0.0), planner=planner))
    assert planner.asked == 2
    assert is_free(service, result.unwrap()[0])
    assert any("searched again" in note and "post" in note for note in result.notes)


def test_a_path_that_can_never_be_proven_does_not_leave() -> None:
    service = PlannerService("planar2", Scene((thin_post(0.75),)), edge_step=COARSE)
    planner = GivenPaths([START, (1.5, 0.0)])
    failure = present(service.plan(asked(goal=(1.5, 0.0), planner=planner)).failure)
    assert (failure.stage, failure.reason) == (Stage.CERTIFY, Reason.NOT_CERTIFIED)
    assert "x post is not proven apart" in failure.detail
    assert planner.asked == 2
    assert present(service.follow([START, (1.5, 0.0)]).failure).reason is Reason.NOT_CERTIFIED


# -- blended --------------------------------------------------------------------------------------


def test_corners_are_blended_and_blends_cost_states_of_their_own(discs: PlannerService) -> None:
    sharp, smooth = discs.plan(asked(blend=0.0)), discs.plan(asked())
    assert len(sharp.unwrap()[0].corners) > 0
    assert smooth.unwrap()[0].corners == ()
    assert sharp.stage(Stage.POLISH).counts.states < smooth.stage(Stage.POLISH).counts.states
    assert sharp.stage(Stage.SHORTCUT).counts == smooth.stage(Stage.SHORTCUT).counts
    assert present(smooth.motion).duration < present(smooth.motion).stop_duration


def test_blends_that_samples_wrongly_call_free_are_narrowed_until_they_are_proven(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    service, query = PlannerService("wxai", "post"), queries.load("post")[3]
    second = IndependentChecker(ROOT / "robots" / "wxai", ROOT / "scenes" / "post.toml")

    def hopeful(path: JointPath, oracle: Any, sizes: FloatArray) -> JointPath:
        pieces = np.diff(path.knots)
        inner = np.minimum(sizes[1:-1], 0.499 * np.minimum(pieces[:-1], pieces[1:]))
        return path.with_blends([0.0, *(inner * [k in path.corners for k in range(1, len(sizes) - 1)]), 0.0])

    monkeypatch.setattr(pipeline, "blended", hopeful)
    result = service.plan(asked(query.start, query.goal, seed=query.number))
    path = result.unwrap()[0]
    assert result.stage(Stage.CERTIFY).counts.distances > present(result.certificate).distances, (
        "or nothing was refused"
    )
    lengths = np.diff(path.knots)
    widest = np.minimum(0.5, 0.499 * np.minimum(lengths[:-1], lengths[1:]))
    assert np.any(path.blends[1:-1] < 0.9 * widest)
    assert all(map(second.free, path(np.linspace(0.0, path.length, 3000))))


def test_a_search_that_gives_up_says_what_was_most_in_the_way(discs: PlannerService) -> None:
    failure = present(discs.plan(asked(max_checks=100)).failure)
    assert "; whether a path exists is unknown (no proof that there is none in " in failure.detail
    assert failure.detail.endswith("; most in the way: forearm x lesson_disc (100%)")


# -- timed ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("timing", [ToppRa(), SCurve()], ids=lambda law: law.name)
def test_the_tool_is_no_faster_than_it_may_be(discs: PlannerService, timing: Any) -> None:
    free = discs.plan(asked(timing=timing))
    slow = discs.plan(asked(timing=timing, max_tool_speed=0.25))
    assert present(free.motion).tool_speed > 0.3
    trajectory = slow.unwrap()[1]
    t = np.linspace(0.0, trajectory.duration, 4_001)
    tips = np.array([discs.robot.tool_pose(q)[:3, 3] for q in trajectory(t)])
    speeds = np.sqrt((np.diff(tips, axis=0) ** 2).sum(axis=1)) / np.diff(t)
    assert speeds.max() <= 0.25 * (1 + 1e-9)
    assert speeds.max() == pytest.approx(present(slow.motion).tool_speed, rel=1e-4)
    assert present(slow.motion).tool_speed > 0.24, "as fast as it may be somewhere"
    assert trajectory.duration > present(free.motion).duration


def test_peaks_are_measured_against_the_jerk_that_the_law_holds(discs: PlannerService) -> None:
    for jerk, scale in ((5.0, 1.0), (5000.0, 0.5)):
        motion = present(discs.plan(asked(timing=SCurve(jerk=jerk), acceleration_scale=scale)).motion)
        assert 0.5 < motion.peaks.jerk.ratio <= 1 + 1e-9


@pytest.mark.parametrize(
    ("field", "value"), [("contacts", None), ("pace", ToppRa()), ("min_blend", 0.0), ("blends", [0.0, math.nan, 0.0])]
)
def test_a_given_polyline_with_settings_that_make_no_sense_is_refused(
    discs: PlannerService, field: str, value: Any
) -> None:
    with pytest.raises(InvalidRequest, match=f"{field}: got"):
        discs.follow(BEND, **{field: value})


def test_an_impossible_stretch_of_contact_is_refused() -> None:
    values: Any
    for values in [(0.5, 1, ()), (0, 1, None), (0, 1, (("a",),))]:
        with pytest.raises(InvalidRequest, match=r"^(first|pairs): got"):
            AllowedStretch(values[0], values[1], values[2], "because")


# -- given polylines -------------------------------------------------------------------------------


BEND = [(0.0, 0.0), (-0.5, 0.0), (-0.5, -0.5)]


def test_a_given_polyline_is_blended_where_that_is_asked_and_free(discs: PlannerService) -> None:
    plain, smooth = discs.follow(BEND), discs.follow(BEND, blends=[0.0, 0.2, 0.0])
    assert plain.unwrap()[0].corners == (1,)
    assert smooth.unwrap()[0].blends.tolist() == [0.0, 0.2, 0.0]
    assert smooth.stage(Stage.POLISH).counts.states > 0
    assert smooth.unwrap()[1].duration < plain.unwrap()[1].duration


def test_waypoints_that_coincide_leave_corners_as_stops(discs: PlannerService) -> None:
    path, _ = discs.follow([BEND[0], BEND[0], *BEND[1:]], blends=[0.0, 0.2, 0.2, 0.0]).unwrap()
    assert path.corners == (1,)
    assert not path.blends.any()


def test_contact_that_is_meant_on_one_side_of_a_corner_is_not_meant_on_its_blend(discs: PlannerService) -> None:
    tip = discs.robot.tool_pose(np.array([-0.6, -0.2]))[:3, 3].tolist()
    pin = Obstacle("pin", Cylinder(0.02, 0.2), Pose((tip[0], tip[1], tip[2])))
    service = PlannerService("planar2", Scene((pin,)))
    line = [(-0.2, -0.2), (-0.55, -0.2), (-0.7, -0.05)]
    contact = AllowedStretch(1, 2, (("forearm", "pin"),), "it is pushed")
    result = service.follow(line, contacts=[contact], blends=[0.0, 0.1, 0.0])
    first, second = (service.follow(part).failure for part in (line[:2], line[1:]))
    assert first is None
    assert second is not None
    blend = JointPath(np.array(line), np.array([0.0, 0.1, 0.0]))
    assert not service.checker.blend_is_free(blend, 1), "or this tests nothing"
    assert result.unwrap()[0].blends[1] < 0.1
    assert result.exempt[0].s_start == pytest.approx(0.35)


def test_a_corner_that_would_need_a_narrower_blend_than_the_least_is_a_stop(discs: PlannerService) -> None:
    assert discs.follow(BEND, blends=[0.0, 0.005, 0.0]).unwrap()[0].blends[1] == 0.0
    assert discs.follow(BEND, blends=[0.0, 0.005, 0.0], min_blend=0.001).unwrap()[0].blends[1] == 0.005


# -- bad paths ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("gap", "reason"), [(1.5e-6, Reason.NOT_CERTIFIED), (2.5e-6, None)])
def test_an_end_nearer_than_can_be_proven_is_refused_before_any_search(gap: float, reason: Reason | None) -> None:
    width = 0.01
    wall = Obstacle("wall", Box((0.2, 0.02, 0.2)), Pose((1.2, width + 0.01 + gap, 0.0)))
    service = PlannerService("planar2", Scene((wall,)))
    result = service.plan(asked(goal=(0.0, 0.0), start=(-1.0, 0.0)))
    assert CollisionChecker(service.robot, service.scene).state_is_free((0.0, 0.0))
    assert (result.failure and result.failure.reason) == reason
    if result.failure is not None:
        assert result.failure.stage is Stage.ENDPOINTS
        assert "no gap of more than 0.002 mm is proven" in result.failure.detail
