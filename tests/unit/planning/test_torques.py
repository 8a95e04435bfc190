"""Plans under torque limits: ends that cannot be held, loads, reports, files, and torques worked out anew."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import Box, Pose
from planner_service.planning.request import Pace, PlanRequest, torque_limits
from planner_service.planning.result import Reason, Stage
from planner_service.planning.task_result import Handling
from planner_service.records.plan_file import SavedPlan, load_plan
from planner_service.records.recertify import recertify
from planner_service.robot.inertia import Payload
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene, save_scene
from planner_service.scene.scene import Attached, Scene
from planner_service.service import PlannerService
from planner_service.timing.laws import SCurve, ToppRa, Trapezoidal
from planner_service.timing.torque_limits import EXCESS
from tests.support.command import run

START = (0.0, -1.5, 1.5, -1.5, -1.5, 0.0)
STRETCHED = (0.0, 0.0, 0.0, -1.5, -1.5, 0.0)
UPRIGHT = (1.0, -1.5, 0.2, -1.5, -1.5, 0.0)
LAW = ToppRa(torque=True)


@cache
def service() -> PlannerService:
    return PlannerService("ur5", Scene())


def request(payload: float | None = 5.0, goal: object = UPRIGHT, start: object = START) -> PlanRequest:
    load = None if payload is None else Payload(payload, (0.0, 0.0, 0.05))
    return PlanRequest(start, goal, timing=LAW, payload=load, seed=1)  # type: ignore[arg-type]


def test_a_heavy_payload_makes_a_motion_slower_and_its_torques_are_reported() -> None:
    plain = service().plan(replace(request(), timing=ToppRa(), payload=None))
    heavy = service().plan(replace(request(12.0), torque_scale=0.7))
    assert heavy.motion is not None
    assert plain.motion is not None
    assert heavy.motion.duration > plain.motion.duration
    torques = heavy.motion.peaks.torques
    assert [peak.joint for peak in torques] == list(range(6))
    assert 0.99 < max(peak.ratio for peak in torques) <= 1.0 + EXCESS
    assert all(0.0 <= peak.time <= heavy.motion.duration for peak in torques)
    assert "torque 100% of the limits" in str(heavy.motion)
    assert plain.motion.peaks.torques == ()
    assert "torque" not in str(plain.motion)


@pytest.mark.parametrize(
    ("start", "goal", "reason", "end"),
    [
        (STRETCHED, START, Reason.START_EXCEEDS_TORQUE, "start"),
        (START, STRETCHED, Reason.GOAL_EXCEEDS_TORQUE, "goal"),
        (START, [STRETCHED, STRETCHED], Reason.GOAL_EXCEEDS_TORQUE, "goal[0]"),
    ],
)
def test_an_end_that_cannot_be_held_is_refused_before_any_search(
    start: object, goal: object, reason: Reason, end: str
) -> None:
    result = service().plan(request(12.0, goal, start))
    assert result.failure is not None
    assert (result.failure.stage, result.failure.reason) == (Stage.ENDPOINTS, reason)
    assert result.failure.detail.startswith(f"{end}: shoulder_lift_joint cannot hold 12 kg here: ")
    assert result.failure.detail.endswith(" of 150 Nm")
    assert [report.stage for report in result.stages] == [Stage.ENDPOINTS]


def test_of_several_goals_one_that_can_be_held_will_do() -> None:
    result = service().plan(request(12.0, [STRETCHED, UPRIGHT]))
    assert result.goal_index == 1


def test_a_followed_line_is_held_to_its_torques_too() -> None:
    pace = Pace(LAW, payload=Payload(12.0))
    assert service().follow([START, UPRIGHT], pace=pace).ok
    refused = service().follow([START, STRETCHED], pace=pace)
    assert refused.failure is not None
    assert refused.failure.reason is Reason.GOAL_EXCEEDS_TORQUE


def test_an_attached_object_weighs_as_the_payload_that_it_is() -> None:
    held = Attached("box", Box((0.1, 0.2, 0.3)), Pose((0.0, 0.0, 0.2)), ("wrist_3_link",), mass=3.0)
    moments = tuple(3.0 * (a * a + b * b) / 12.0 for a, b in ((0.2, 0.3), (0.1, 0.3), (0.1, 0.2)))
    payload = Payload(3.0, (0.0, 0.0, 0.2), (moments[0], 0.0, 0.0, moments[1], 0.0, moments[2]))
    robot, states = service().robot, np.random.default_rng(2).normal(size=(3, 5, 6))
    attached = torque_limits(robot, Scene(attached=(held,))).torques(*states)
    assert attached == pytest.approx(torque_limits(robot, Scene(), payload).torques(*states), abs=1e-12)
    light = torque_limits(robot, Scene(attached=(replace(held, mass=None),))).torques(*states)
    assert light == pytest.approx(torque_limits(robot, Scene()).torques(*states))


def test_the_mass_of_what_is_attached_is_part_of_a_scene_and_of_its_file(tmp_path: Path) -> None:
    held = Attached("box", Box((0.1, 0.2, 0.3)), Pose((0.0, 0.0, 0.2)), mass=3)
    scene = Scene(attached=(held,))
    assert scene.hash != Scene(attached=(replace(held, mass=None),)).hash
    save_scene(scene, tmp_path / "scene.toml")
    again = load_scene(tmp_path / "scene.toml")
    assert (again, again.hash) == (scene, scene.hash)
    for bad in (0.0, -1.0, float("nan"), "3", 1e5):
        with pytest.raises(InvalidRequest, match="mass: got"):
            replace(held, mass=bad)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"mass": -1.0}, "mass"),
        ({"mass": 1.0, "com": (0.0, 0.0, 2000.0)}, "com"),
        ({"mass": 1.0, "com": (0.0, 0.0)}, "com"),
        ({"mass": 1.0, "inertia": (1.0, 0.0, 0.0, 1.0, 0.0, 3.0)}, "inertia"),
        ({"mass": 1.0, "inertia": (-1.0, 0.0, 0.0, -1.0, 0.0, -1.0)}, "inertia"),
    ],
)
def test_a_payload_that_no_body_can_be_is_refused(given: dict[str, object], field: str) -> None:
    with pytest.raises(InvalidRequest, match=f"{field}: got"):
        Payload(**given)  # type: ignore[arg-type]


def test_a_payload_that_no_law_looks_at_is_refused() -> None:
    for law in (ToppRa(), Trapezoidal(), SCurve()):
        with pytest.raises(InvalidRequest, match=r"payload: got .*only timing=ToppRa\(torque=True\)"):
            replace(request(), timing=law)
        with pytest.raises(InvalidRequest, match=r"torque_scale: got 0\.5"):
            Pace(law, torque_scale=0.5)
    with pytest.raises(InvalidRequest, match="line_timing: got"):
        Handling(request=request(), line_timing=Trapezoidal())


def test_a_robot_without_masses_is_refused_before_it_is_planned_for() -> None:
    planar = PlannerService("planar2", "discs")
    with pytest.raises(InvalidRequest, match="robot planar2: upper_arm has no mass"):
        planar.plan(PlanRequest([0.0, 0.0], [0.1, 0.1], timing=LAW))


def test_replanning_refuses_torque_limits() -> None:
    result = service().plan(request())
    with pytest.raises(InvalidRequest, match="replan keeps no torque limits"):
        service().replan(result, at_time=0.1, goal=START)


def test_a_plan_file_keeps_the_payload_and_the_torques_and_they_are_worked_out_anew(tmp_path: Path) -> None:
    result = service().plan(request())
    result.save(tmp_path / "plan.json")
    saved = load_plan(tmp_path / "plan.json")
    assert saved.request is not None
    assert saved.request.payload == Payload(5.0, (0.0, 0.0, 0.05))
    assert saved.request.timing == LAW
    assert saved.result.motion is not None
    assert result.motion is not None
    assert saved.result.motion.peaks == result.motion.peaks
    assert recertify(saved).certified
    heavier = replace(saved, request=replace(saved.request, payload=Payload(40.0)))
    (problem,) = [text for text in recertify(heavier).problems if "shoulder_lift_joint" in text]
    assert " times its torque, at t = " in problem
    assert recertify(heavier, PlannerService("ur5", Scene())).problems == recertify(heavier).problems


def test_a_file_with_lighter_links_is_held_to_the_robot_that_is_given(tmp_path: Path) -> None:
    robot = load_robot("ur5")
    assert robot.dynamics is not None
    light = replace(robot.dynamics, links=tuple(replace(each, mass=each.mass / 100.0) for each in robot.dynamics.links))
    cheat = PlannerService(replace(robot, dynamics=light), Scene())
    result = cheat.plan(request(15.0, UPRIGHT, (0.0, -0.5, 0.3, -1.5, -1.5, 0.0)))
    result.save(tmp_path / "plan.json")
    saved = load_plan(tmp_path / "plan.json")
    assert recertify(saved).certified
    assert any("times its torque" in text for text in recertify(saved, service()).problems)


def test_dynamics_that_a_robot_cannot_have_are_refused(tmp_path: Path) -> None:
    document = SavedPlan.of(service().plan(request())).document()
    for change, match in (
        (lambda d: d["links"][0].update(body=99), r"dynamics.links\[0\].body"),
        (lambda d: d["links"][0].update(mass=-1.0), "mass: got -1.0"),
        (lambda d: d["effort"].pop(), "one for each joint"),
        (lambda d: d["effort"].__setitem__(0, -1.0), "effort"),
    ):
        broken = json.loads(json.dumps(document))
        change(broken["robot"]["dynamics"])  # type: ignore[no-untyped-call]
        file = tmp_path / "plan.json"
        file.write_text(json.dumps(broken))
        with pytest.raises(InvalidRequest, match=match):
            load_plan(file)


def test_the_command_line_plans_with_a_payload_and_plots_its_torques(tmp_path: Path) -> None:
    ends = ("--start", ",".join(map(str, START)), "--goal", ",".join(map(str, UPRIGHT)))
    plan = ("plan", "--robot", "ur5", "--scene", "table", *ends)
    done = run(*plan, "--payload", "5,0,0,0.05", "--plot", tmp_path / "plot.svg")
    assert done.exit_code == 0
    assert "torque" in done.stdout
    picture = (tmp_path / "plot.svg").read_text("utf-8")
    assert "torque / limit" in picture
    assert picture.count("<polyline") == 1 + 6
    assert "torque" not in run(*plan).stdout
    assert "torque" in run(*plan, "--torque").stdout
    refused = run(*plan, "--payload", "60")
    assert refused.exit_code == 1
    assert "cannot hold 60 kg here" in refused.stderr
    for wrong, expected in (
        (("--payload", "5,1"), "--payload: got '5,1'; expected KG or KG,X,Y,Z"),
        (("--payload", "-5"), "--payload: got '-5'; expected kilograms"),
        (("--torque", "--timing", "s-curve"), "--timing: got 's-curve'; expected toppra"),
    ):
        bad = run(*plan, *wrong)
        assert bad.exit_code == 2
        assert expected in " ".join(bad.stderr.split())
