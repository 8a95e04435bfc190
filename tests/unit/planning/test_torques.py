"""Plans under torque limits: ends that cannot be held, loads, reports, files, and torques worked out anew."""

from __future__ import annotations

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
from planner_service.records.plan_file import load_plan
from planner_service.records.recertify import recertify
from planner_service.robot.inertia import Payload
from planner_service.robot_setup.loading import load_robot
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


def test_an_end_that_cannot_be_held_is_refused_before_any_search() -> None:
    for start, goal, reason, end in [
        (STRETCHED, START, Reason.START_EXCEEDS_TORQUE, "start"),
        (START, [STRETCHED, STRETCHED], Reason.GOAL_EXCEEDS_TORQUE, "goal[0]"),
    ]:
        result = service().plan(request(12.0, goal, start))
        assert result.failure is not None
        assert (result.failure.stage, result.failure.reason) == (Stage.ENDPOINTS, reason)
        assert result.failure.detail.startswith(f"{end}: shoulder_lift_joint cannot hold 12 kg here: ")
        assert [report.stage for report in result.stages] == [Stage.ENDPOINTS]


def test_an_attached_object_weighs_as_the_payload_that_it_is() -> None:
    held = Attached("box", Box((0.1, 0.2, 0.3)), Pose((0.0, 0.0, 0.2)), ("wrist_3_link",), mass=3.0)
    moments = tuple(3.0 * (a * a + b * b) / 12.0 for a, b in ((0.2, 0.3), (0.1, 0.3), (0.1, 0.2)))
    payload = Payload(3.0, (0.0, 0.0, 0.2), (moments[0], 0.0, 0.0, moments[1], 0.0, moments[2]))
    robot, states = service().robot, np.random.default_rng(2).normal(size=(3, 5, 6))
    attached = torque_limits(robot, Scene(attached=(held,))).torques(*states)
    assert attached == pytest.approx(torque_limits(robot, Scene(), payload).torques(*states), abs=1e-12)
    light = torque_limits(robot, Scene(attached=(replace(held, mass=None),))).torques(*states)
    assert light == pytest.approx(torque_limits(robot, Scene()).torques(*states))


def test_a_payload_that_no_law_looks_at_is_refused() -> None:
    for law in (ToppRa(), Trapezoidal(), SCurve()):
        with pytest.raises(InvalidRequest, match=r"payload: got .*only timing=ToppRa\(torque=True\)"):
            replace(request(), timing=law)
        with pytest.raises(InvalidRequest, match=r"torque_scale: got 0\.5"):
            Pace(law, torque_scale=0.5)
    with pytest.raises(InvalidRequest, match="line_timing: got"):
        Handling(request=request(), line_timing=Trapezoidal())


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


def test_the_command_line_plans_with_a_payload_and_plots_its_torques(tmp_path: Path) -> None:
    ends = ("--start", ",".join(map(str, START)), "--goal", ",".join(map(str, UPRIGHT)))
    plan = ("plan", "--robot", "ur5", "--scene", "table", *ends)
    done = run(*plan, "--payload", "5,0,0,0.05", "--plot", tmp_path / "plot.svg")
    assert done.exit_code == 0
    assert "torque" in done.stdout
    assert (tmp_path / "plot.svg").read_text("utf-8").count("<polyline") == 1 + 6
    for wrong, code, expected in (
        (("--payload", "60"), 1, "cannot hold 60 kg here"),
        (("--payload", "5,1"), 2, "--payload: got '5,1'; expected KG or KG,X,Y,Z"),
        (("--torque", "--timing", "s-curve"), 2, "--timing: got 's-curve'; expected toppra"),
    ):
        bad = run(*plan, *wrong)
        assert (bad.exit_code, expected in " ".join(bad.stderr.split())) == (code, True)
