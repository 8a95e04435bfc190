"""An optimum leaves the service only if the honest checker finds it free, and it is proven; else what was before."""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.studies.optimise import hybrid_rows, promises
from benchmarks.worlds import queries
from planner_service import (
    PRM,
    Box,
    CheckCounts,
    Failure,
    InvalidRequest,
    JointPath,
    Obstacle,
    Optimise,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Reason,
    Scene,
    SCurve,
    Stage,
    ToppRa,
    load_robot,
    load_scene,
)
from planner_service.certify import Certifier
from planner_service.cli.commands import app
from planner_service.geometry.arrays import FloatArray
from planner_service.optimize import Chomp, Figures, MethodResult, Optimum, TrajOpt
from planner_service.optimize.problem import CurveProblem
from planner_service.planning.accounting import NoPlan, timed
from planner_service.planning.polishing import BENT, judged, lines
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedPlan, load_plan
from planner_service.view.still.motion_plot import plot_svg
from tests.integration.test_pins import OTHER_CPU
from tests.support.optional import present

ROOT = Path(__file__).parents[3]
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


def test_the_search_is_the_same_with_and_without(bin_: PlannerService) -> None:
    plain, polished = (bin_.plan(query("bin", 3, polish=polish)) for polish in (None, Optimise()))
    for stage in (Stage.ENDPOINTS, Stage.STRAIGHT_LINE, Stage.SEARCH, Stage.SHORTCUT):
        assert plain.stage(stage).counts == polished.stage(stage).counts
    assert plain.polish is None


@pytest.mark.parametrize(("scene", "number"), [("bin", 4), ("post", 0), ("clutter", 0)])
def test_an_optimum_is_free_proven_shorter_faster_and_keeps_its_distance(scene: str, number: int) -> None:
    service = PlannerService("wxai", scene)
    plain, polished = (service.plan(query(scene, number, polish=polish)) for polish in (None, Optimise()))
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


@pytest.mark.parametrize(
    ("scene", "number", "expected"),
    [
        ("bin", 3, CheckCounts(542, 26, 3_935)),
        ("post", 0, CheckCounts(1_331, 42, 7_666)),
        ("shelf", 5, CheckCounts(462, 23, 8_154)),
    ],
)
def test_what_optimising_asks_is_counted_in_its_stage(scene: str, number: int, expected: CheckCounts) -> None:
    result = PlannerService("wxai", scene).plan(query(scene, number, polish=Optimise()))
    assert result.stage(Stage.POLISH).counts == expected
    assert 0 < present(result.polish).gradients < expected.distances


def test_gradients_are_no_states(bin_: PlannerService) -> None:
    result = bin_.plan(query("bin", 0, polish=Optimise()))
    plain = bin_.plan(query("bin", 0))
    assert result.counts.states < plain.counts.states + 0.2 * present(result.polish).gradients


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
        ({"cost": 1.0 + 1e-9}, True),
        ({"cost": 1.1}, False),
        ({"cost": 1.1, "shortfall": 0.4}, True),  # room is worth a longer way
        ({"cost": 0.9, "shortfall": 0.6}, False),
        ({"cost": 0.9, "shortfall": 0.5005}, True),
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


def test_an_optimum_keeps_the_padding_except_near_an_end_that_is_closer() -> None:
    service = PlannerService("wxai", "post")
    request = query("post", 1, padding=0.01)
    plain, polished = service.plan(request), service.plan(replace(request, polish=Optimise()))
    assert plain.padding == polished.padding == 0.01
    assert present(polished.polish).kept
    path, (near,) = polished.unwrap()[0], polished.near_ends
    s = np.linspace(0.0, path.length, 500)
    rows = path(s[(s < near.s_start) | (s > near.s_end)])
    assert service.checker.near(rows, 0.05).distances.min() >= 0.01


def test_an_optimum_that_no_law_can_drive_is_not_kept(discs: PlannerService, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, law = discs.plan(asked()), timed

    def failing(path: JointPath, *rest: Any) -> Any:
        if path.blends.tolist() != plain.unwrap()[0].blends.tolist():
            raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, "planted"))
        return law(path, *rest)

    monkeypatch.setattr("planner_service.planning.pipeline.timed", failing)
    polished = discs.plan(asked(polish=Optimise()))
    assert bits(plain) == bits(polished)
    assert not present(polished.polish).kept
    assert present(polished.polish).note == "no motion along the optimum: TIMING_FAILED (timing): planted"


@pytest.mark.slow
def test_optima_and_what_replaces_them_have_the_same_bits_in_a_process_for_an_older_cpu() -> None:
    environment = {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "12345", **OTHER_CPU}
    code = "from tests.unit.planning.test_polishing import told; print(told())"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == told().split()


def told() -> str:
    """Hashes of plans and of their replanned motions."""
    service, found = PlannerService("wxai", "bin"), []
    for number, method in ((1, TrajOpt()), (1, Chomp(iterations=30))):
        request = query("bin", number, polish=Optimise(method=method))
        plan = service.plan(request)
        at_time = 0.3 * plan.unwrap()[1].duration
        again = service.replan(plan, at_time=at_time, goal=request.start)
        found += [hashlib.sha256(b"".join(bits(result))).hexdigest() for result in (plan, again.result)]
        found += [str(result.counts.distances) for result in (plan, again)]
    return " ".join(found)


def test_an_optimum_is_driven_as_it_was_judged_even_if_stops_were_faster(
    bin_: PlannerService, monkeypatch: pytest.MonkeyPatch
) -> None:
    law = timed

    def slow(path: JointPath, *rest: Any) -> Any:
        trajectory, report = law(path, *rest)
        return (
            (trajectory, replace(report, duration=9.0, stop_duration=1.0))
            if path.blends.any()
            else (trajectory, report)
        )

    monkeypatch.setattr("planner_service.planning.pipeline.timed", slow)
    polished = bin_.plan(query("bin", 3, polish=Optimise()))
    assert present(polished.polish).kept
    assert polished.unwrap()[0].corners == ()


@pytest.mark.slow
def test_an_optimum_that_takes_too_long_is_left(bin_: PlannerService) -> None:
    class Endless(Planted):
        def minimise(self, problem: CurveProblem, corners: FloatArray, held: tuple[int, int]) -> MethodResult:
            while True:
                problem.checker.near(corners, 0.05)

    result = bin_.plan(query("bin", 3, polish=Optimise(method=Endless((0.0,) * 6)), time_limit=0.5))
    assert result.ok
    assert not result.deterministic
    assert result.polish is None
    assert result.notes == ("not optimised: the time limit passed",)


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


def test_an_optimum_keeps_more_than_the_padding_it_is_judged_with() -> None:
    service = PlannerService("wxai", "post")
    touching = service.plan(query("post", 0, polish=Optimise(clearance=0.0)))
    assert present(touching.polish).kept
    assert 0.0015 <= clearance(service, touching) < 0.004
    padded = service.plan(query("post", 0, padding=0.03, polish=Optimise()))  # its ends are nearer than that
    assert present(padded.polish).kept
    assert clearance(service, padded) > 0.02


def test_a_retreat_and_an_optimum_meet_in_a_stop(bin_: PlannerService) -> None:
    request = query("bin", 3, start=bin_.robot.pose("sleep"), polish=Optimise())
    result = bin_.plan(request)
    path, _ = result.unwrap()
    assert present(result.polish).kept
    assert result.exempt
    assert path.corners == (1,)
    assert path.waypoints[0].tolist() == [0.0] * 6


@pytest.mark.parametrize("timing", [ToppRa(), SCurve()], ids=lambda law: law.name)
def test_corners_suit_the_timing_law(bin_: PlannerService, timing: Any) -> None:
    plain, polished = (bin_.plan(query("bin", 3, timing=timing, polish=polish)) for polish in (None, Optimise()))
    assert present(polished.motion).duration < present(plain.motion).duration
    assert len(polished.unwrap()[0].waypoints) == (10 if isinstance(timing, ToppRa) else 5)
    given = bin_.plan(query("bin", 3, timing=timing, polish=Optimise(corners=6)))
    assert len(given.unwrap()[0].waypoints) == 8


@pytest.mark.slow
def test_the_field_of_voxels_gives_plans_too() -> None:
    service = PlannerService("wxai", "post")
    result = service.plan(query("post", 0, polish=Optimise(method=Chomp())))
    assert (present(result.polish).kept, present(result.polish).method) == (True, "chomp")
    assert clearance(service, result) >= 0.02


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


@pytest.mark.slow
def test_so_do_other_lines_to_begin_with(discs: PlannerService) -> None:
    result = discs.plan(asked(planner=Optimise(starts=6)))
    assert result.ok
    assert 1 < result.attempts <= 6
    assert present(result.certificate).certified
    assert bits(result) == bits(discs.plan(asked(planner=Optimise(starts=6))))


def test_a_straight_line_that_converges_to_a_free_curve_is_a_plan(bin_: PlannerService) -> None:
    result = bin_.plan(query("bin", 3, planner=Optimise()))
    assert result.ok
    assert result.attempts == 1
    assert result.stage(Stage.SEARCH).counts.distances > 0
    assert result.stage(Stage.SHORTCUT).counts == CheckCounts()
    assert clearance(bin_, result) >= 0.02


def test_of_several_goals_each_is_tried(discs: PlannerService) -> None:
    result = discs.plan(asked(goal=[GOAL, (-2.0, 1.0)], planner=Optimise()))
    assert result.ok
    assert result.goal_index == 1


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
        ({"polish": True}, "polish"),
        ({"polish": TrajOpt()}, "polish"),
        ({"polish": Optimise(), "planner": Optimise()}, "polish"),
        ({"polish": Optimise(), "blend": 0.0}, "blend"),
        ({"planner": Optimise(), "blend": 0.0}, "blend"),
        ({"planner": TrajOpt()}, "planner"),
    ],
)
def test_requests_that_make_no_sense_are_refused_by_name(given: dict[str, Any], named: str) -> None:
    with pytest.raises(InvalidRequest, match=f"^{named}: "):
        asked(**given)


@pytest.mark.parametrize(
    "changes",
    [
        {"polish": Optimise()},
        {"polish": Optimise(waypoints=30, smoothness=2.5, clearance=1 / 30, corners=4, method=Chomp(20, 0.01))},
        {"planner": Optimise(starts=3, method=TrajOpt(7))},
    ],
)
def test_a_request_comes_back_from_a_file(discs: PlannerService, tmp_path: Path, changes: Any) -> None:
    request = asked(**changes)
    result = discs.plan(asked(polish=Optimise()))
    save_plan(SavedPlan(discs.world, request, result), tmp_path / "plan.json")
    read = load_plan(tmp_path / "plan.json")
    assert (present(read.request).polish, present(read.request).planner) == (request.polish, request.planner)
    assert read.result.polish == result.polish
    assert bits(read.result) == bits(result)


@pytest.mark.parametrize(
    ("where", "value", "told"),
    [
        (("settings", "method", "name"), "gradient", "unknown method 'gradient'"),
        (("settings", "corners"), -1, "corners"),
        (("settings", "speed"), 1, "no other keys"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(
    discs: PlannerService, tmp_path: Path, where: tuple[str, ...], value: Any, told: str
) -> None:
    file = tmp_path / "plan.json"
    save_plan(SavedPlan(discs.world, asked(polish=Optimise()), discs.plan(asked())), file)
    document = json.loads(file.read_text())
    place = document["request"]["polish"]
    for key in where[:-1]:
        place = place[key]
    place[where[-1]] = value
    file.write_text(json.dumps(document))
    with pytest.raises(InvalidRequest, match=told):
        load_plan(file)


def line(*more: str) -> list[str]:
    found = queries.load("bin")[3]
    ends = [f"--{name}=" + ",".join(map(str, q.tolist())) for name, q in (("start", found.start), ("goal", found.goal))]
    return ["plan", *ends, "--scene", "bin", "--seed", "3", *more]


def test_the_command_line_tells_what_optimising_came_to() -> None:
    done = CliRunner().invoke(app, line("--polish", "--clearance", "0.015"))
    assert done.exit_code == 0
    assert "optimised: length" in done.output
    assert "trajopt" in done.output


def test_lines_bend_at_points_around_their_middle_inside_the_limits() -> None:
    robot = load_robot("wxai")
    start, goal = robot.home, robot.limits.lower
    straight, *bent = lines((start, goal), Optimise(starts=20), 3, robot)
    assert straight.tolist() == [start.tolist(), goal.tolist()]
    aside = max(BENT, BENT * math.dist(start, goal))
    middle = np.array([points[1] for points in bent])
    assert len({tuple(q) for q in middle.tolist()}) == 19
    assert ((middle >= robot.limits.lower) & (middle <= robot.limits.upper)).all()
    free = (middle > robot.limits.lower) & (middle < robot.limits.upper)
    assert (np.abs(middle - (start + goal) / 2.0)[free] <= aside).all()


def test_the_command_line_optimises_lines() -> None:
    done = CliRunner().invoke(app, line("--planner", "optimise", "--json"))
    document = json.loads(done.stdout)
    assert (done.exit_code, document["ok"] if "ok" in document else document["result"]["ok"]) == (0, True)
    assert document["result"]["polish"]["kept"] is True
    assert document["request"]["planner"]["name"] == "optimise"


def test_what_the_command_line_cannot_use_is_named() -> None:
    for more, told in [
        (("--clearance", "0.01"), "--polish"),
        (("--polish", "--clearance", "3"), "clearance: "),
        (("--polish", "--blend", "0"), "blend: "),
        (("--planner", "optimize"), "did you mean 'optimise'"),
    ]:
        done = CliRunner().invoke(app, line(*more))
        assert done.exit_code == 2
        assert told in done.stderr


# the measure


@pytest.mark.slow
def test_the_measure_keeps_its_promises_on_a_part_and_sees_a_plan_without_its_distance() -> None:
    rows = list(hybrid_rows(("post",), 2))
    assert [row["failure"] for row in rows] == [None] * 2
    kept = {promise.text: promise.kept for promise in promises(rows)}
    for words in ("smallest clearance", "length at most", "motion time at most", "no result without"):
        assert [value for text, value in kept.items() if text.startswith(words)] == [True], words
    near = list(hybrid_rows(("post",), 1, polish=Optimise(clearance=0.0)))
    assert not promises([row | {"wanted": 0.02} for row in near])[0].kept


def test_a_roadmap_is_polished_too(bin_: PlannerService) -> None:
    result = bin_.plan(query("bin", 3, planner=PRM(milestones=150), polish=Optimise()))
    assert result.ok
    assert math.isfinite(present(result.polish).after.cost)
    assert load_scene("bin").hash == bin_.scene.hash


# the picture


def test_the_picture_shows_both_paths_and_what_they_keep(tmp_path: Path, bin_: PlannerService) -> None:
    file = tmp_path / "clear.svg"
    done = CliRunner().invoke(app, line("--polish", "--plot", str(file)))
    assert done.exit_code == 0
    root = ElementTree.fromstring(file.read_text())
    texts = ["".join(element.itertext()) for element in root.iter("{http://www.w3.org/2000/svg}text")]
    curves = [element.get("points", "").split() for element in root.iter("{http://www.w3.org/2000/svg}polyline")]
    kept = 1000.0 * clearance(bin_, bin_.plan(query("bin", 3, polish=Optimise())))
    assert [text.partition(":")[0] for text in texts[-2:]] == ["not optimised", "optimised"]
    assert float(texts[-1].split()[-2]) == pytest.approx(kept, abs=0.3)
    lowest = [max(float(point.split(",")[1]) for point in curve) for curve in curves]
    assert lowest[0] > lowest[1]  # downwards is nearer
    assert len(curves[0]) == len(curves[1]) == 400


def test_the_picture_of_a_plan_that_was_not_optimised_shows_one_path(tmp_path: Path) -> None:
    assert CliRunner().invoke(app, line("--plot", str(tmp_path / "clear.svg"))).exit_code == 0
    texts = (tmp_path / "clear.svg").read_text()
    assert (texts.count("<polyline"), "the path: at least" in texts) == (1, True)


def test_without_a_path_there_is_no_picture_and_that_is_said(tmp_path: Path) -> None:
    file = tmp_path / "clear.svg"
    done = CliRunner().invoke(app, line("--max-checks", "1", "--plot", str(file)))
    assert done.exit_code == 1
    assert "note: there is no path to plot" in done.stdout
    assert not file.exists()


def test_a_picture_does_not_take_the_place_of_the_plan(tmp_path: Path) -> None:
    file = str(tmp_path / "plan.json")
    done = CliRunner().invoke(app, line("--out", file, "--plot", file))
    assert done.exit_code == 2
    assert "--plot: got" in done.stderr


def test_names_in_a_picture_are_no_markup() -> None:
    root = ElementTree.fromstring(plot_svg({"a < b & c": np.array([0.01, math.inf, -0.001])}))
    assert any("a < b & c" in "".join(element.itertext()) for element in root.iter())


def test_a_picture_that_cannot_be_written_is_refused_before_planning(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, line("--plot", str(tmp_path / "nowhere" / "clear.svg")))
    assert done.exit_code == 2
    assert "clear.svg" in done.stderr
