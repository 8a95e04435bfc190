"""Whatever is given in place of an argument: an answer, or an error that names it; soon, and in little memory."""

from __future__ import annotations

import resource
import time
import warnings
from collections.abc import Iterator
from importlib import import_module
from inspect import isclass, isfunction, signature
from pathlib import Path

import numpy as np
import pytest

import planner_service
from benchmarks.attack.callables import HOSTILE, SKIPPED, Call, calls
from benchmarks.attack.files import crossing_arms
from planner_service import (
    Attached,
    Box,
    JointPath,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    Scene,
    Sphere,
    load_robot,
)
from planner_service.cell import Anywhere, Arm, AtTool, Cell
from planner_service.certify import certify, certify_gripper, prove_kept
from planner_service.collision import CheckCounts
from planner_service.constraints import KeepUpright
from planner_service.errors import BrokenInvariant, MissingDependency, PlannerServiceError, shown
from planner_service.execute import Streaming
from planner_service.execute.cells import execute_cell
from planner_service.gate import ActionGate, TargetFilter, Tracking
from planner_service.infeasibility import prove_no_path
from planner_service.records.cells import (
    load_cell_plan,
    load_saved,
    prove_cell,
    read_cell_request,
    save_cell_plan,
    with_cell_evidence,
)
from planner_service.roadmap import RoadmapReference
from planner_service.scene import remove_robot
from planner_service.scheduling import PickJob, Schedule, prove_schedule, schedule_picks
from tests.support.arms import FakeArm

MEMORY = 1_500_000_000
"""Bytes that the calls may take beside what the tests have."""

SECONDS, WAIT = 5.0, 60.0
"""Of CPU time that a call may take, and on the clock: machines that test have other work, too."""

PACKAGES = (
    *("cell", "certify", "collision", "constraints", "gate", "grasping", "optimize", "parallel", "path"),
    *(
        "execute.cells",
        "infeasibility",
        "memory",
        "tasks.ordering",
        "planning",
        "replanning",
        "roadmap",
        "scene",
        "scheduling",
        "search",
        "tasks",
    ),
    "workspace",
)
"""Subpackages of which every name is attacked, as of the root."""

ANSWERS = {
    *(
        "ArmCourse",
        "Built",
        "CellPlan",
        "CellReport",
        "CellStopped",
        "Chain",
        "Counts",
        "Course",
        "Decision",
        "Explanation",
        "Figures",
        "FilteredTarget",
        "InWorker",
        "Kept",
        "KeptBound",
        "KeptRefusal",
        "Lost",
        "MethodResult",
    ),
    *(
        "ImproveReport",
        "NoPath",
        "Occupied",
        "OwnClock",
        "Optimum",
        "Reached",
        "Refused",
        "Origin",
        "Remedy",
        "ProvenSchedule",
        "Schedule",
        "Setpoint",
        "Terms",
        "Trail",
    ),
    *("FailedLeg", "GraspQuality", "OrderResult", "Stop", "Whereabouts", "World", "load_solver"),
}
"""What is made of values that have been checked, or takes none."""


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Call]:
    arm, scene = load_robot("wxai"), Scene()
    world = {"robot": arm, "scene": scene}
    upright = KeepUpright((0.0, 0.0, 1.0), 3.0)
    part = {"allowed": (), "padding": 0.0, "exempt": (), "constraints": (upright,)}
    gripper = {"widths": (0.0, 0.01), "allowed": (), "touching": (), "reason": ""}
    service, tracking = PlannerService(arm, scene), Tracking(0.1, 0.01)
    alone = Cell({"one": arm}, scene)
    blocked = Cell({"one": arm}, Scene((Obstacle("block", Box((0.3, 0.3, 0.6))),)))
    nothing = Schedule((), {"one": arm.home}, (), 0.0, {}, 0.0, None, 0, 0, CheckCounts(), alone.layout)
    settings = {"acceleration_scale": 1.0, "jerk_scale": 1.0, "torque_scale": 1.0, "slow": True, "repair": True}
    when, log = {"sent": 0, "elapsed": 0.1}, tmp_path_factory.mktemp("gate") / "log.jsonl"

    def gate() -> ActionGate:
        made = ActionGate(service, rate=30.0, tracking=tracking)
        made.reset(arm.home)
        return made

    return calls(tmp_path_factory.mktemp("files")) | {
        "Tracking": Call(Tracking, {"goal_time": 0.1, "error": 0.01}),
        "Tracking.of": Call(tracking.of, {"joints": 6}),
        "ActionGate": Call(
            ActionGate, {"service": service, "rate": 30.0, "tracking": tracking, **settings, "log": log}, into=("log",)
        ),
        "ActionGate.check": Call(
            lambda **given: gate().check(**given), {"q": arm.home, "chunk": [arm.home], **when, "around": ()}
        ),
        "Arm": Call(Arm, {"robot": arm, "base": Pose()}),
        "Cell": Call(Cell, {"arms": {"one": arm}, "scene": scene}),
        "Cell.of": Call(
            Cell.of, {"robot": arm, "groups": {"one": list(arm.joint_names)}, "scene": scene, "tools": None}
        ),
        "execute_cell": Call(
            execute_cell,
            {
                "cell": alone,
                "plan": alone.plan({"one": PlanRequest(arm.home, arm.home)}),
                "drivers": {"one": FakeArm(np.array(arm.home), width=arm.gripper_width)},
                "streaming": Streaming(settle=0.0),
            },
        ),
        "schedule_picks": Call(
            schedule_picks,
            {"cell": blocked, "jobs": [PickJob("block", Pose((0.3, 0.0, 0.1)))], "starts": {"one": arm.home}}
            | {"request": PlanRequest(arm.home, arm.home), "delay": 0.1, "gripper_seconds": 0.5, "looked_at": 2}
            | {"cancel": None},
        ),
        "prove_schedule": Call(prove_schedule, {"schedule": nothing}),
        "Cell.plan": Call(
            Cell({"one": arm}, scene).plan,
            {"requests": {"one": PlanRequest(arm.home, arm.home)}, "standing": None, "delay": 0.0, "cancel": None}
            | {"goals": None},
        ),
        "AtTool": Call(AtTool, {"arm": "one", "pose": Pose()}),
        "Anywhere": Call(Anywhere, {}),
        "Cell.plan to goals of others": Call(
            Cell({"one": arm, "two": Arm(arm, Pose((2.0, 0.0, 0.0)))}, scene).plan,
            {
                "requests": {"one": PlanRequest(arm.home, arm.home)},
                "goals": {"one": AtTool("two", Pose((-2.0, 0.0, 0.0)))},
                "standing": None,
                "delay": 0.0,
                "cancel": None,
            },
        ),
        "Cell.carrying": Call(
            Cell({"one": arm}, scene).carrying, {"carried": {"one": [Attached("ball", Sphere(0.01), Pose())]}}
        ),
        "Cell.arm": Call(Cell({"one": arm}, scene).arm, {"name": "one", "standing": None}),
        "Cell.joined": Call(Cell({"one": arm}, scene).joined, {"values": {"one": arm.home}}),
        "Cell.of_arm": Call(Cell({"one": arm}, scene).of_arm, {"name": "one", "q": arm.home}),
        "Cell.between": Call(
            Cell({"one": arm, "two": Arm(arm, Pose((2.0, 0.0, 0.0)))}, scene).between,
            {"a": "one", "b": "two", "q": [*arm.home, *arm.home]},
        ),
        "prove_cell": Call(prove_cell, {"plan": crossing_arms(), "padding": 0.0}),
        "with_cell_evidence": Call(with_cell_evidence, {"plan": crossing_arms()}),
        "save_cell_plan": Call(
            save_cell_plan,
            {"plan": crossing_arms(), "path": tmp_path_factory.mktemp("cells") / "out.json"},
            into=("path",),
        ),
        "load_cell_plan": Call(load_cell_plan, {"path": "nothing-there"}),
        "read_cell_request": Call(read_cell_request, {"path": "nothing-there"}),
        "load_saved": Call(load_saved, {"path": "nothing-there"}),
        "ActionGate.update": Call(lambda **given: gate().update(**given), {"scene": scene, **when}),
        "ActionGate.occupied": Call(lambda **given: gate().occupied(**given), {"name": "arm", "base": None}),
        "TargetFilter": Call(TargetFilter, {"gate": gate(), "jump": 0.2, "speed": 0.5}),
        "TargetFilter.next": Call(
            lambda **given: TargetFilter(gate()).next(**given), {"q": arm.home, "wanted": arm.home, "elapsed": 0.1}
        ),
        "ActionGate.reset": Call(lambda **given: gate().reset(**given), {"target": arm.home}),
        "certify": Call(certify, {**world, "path": [arm.home, arm.home], **part}),
        "certify_gripper": Call(certify_gripper, {**world, "q": arm.home, **gripper}),
        "prove_kept": Call(
            prove_kept,
            {"robot": arm, "path": JointPath(np.array([arm.home, arm.home])), "constraints": [upright], "part": None},
        ),
        "prove_no_path": Call(
            prove_no_path,
            {**world, "start": arm.home, "goals": [arm.home], "allowed": (), "max_boxes": 100, "charge": None},
        ),
        "RoadmapReference": Call(RoadmapReference, {"hash": "0" * 64}),
        "remove_robot": Call(
            remove_robot, {"points": [[1.0, 0.0, 0.0]], "robot": arm, "q": arm.home, "margin": 0.01, "attached": ()}
        ),
    }


@pytest.fixture
def little_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    taken = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def is_called(value: object) -> bool:
    """Whether a name stands for a function or a class of which there are objects."""
    return isfunction(value) or (isclass(value) and not getattr(value, "_is_protocol", False))


def test_every_public_name_is_attacked_or_says_why_not(known: dict[str, Call]) -> None:
    attacked = {name.split(".")[0] for name in known}
    packages = [planner_service, *(import_module(f"planner_service.{name}") for name in PACKAGES)]
    names = {name for package in packages for name in package.__all__ if is_called(getattr(package, name))}
    assert names - attacked - set(SKIPPED) == ANSWERS
    assert set(SKIPPED) <= names


def test_every_question_to_a_service_is_attacked_with_every_argument(known: dict[str, Call]) -> None:
    asked = {
        name for name, value in vars(planner_service.PlannerService).items() if isfunction(value) and name[0] != "_"
    }
    assert {name for name in asked if f"PlannerService.{name}" not in known} == {"view"}, "which opens a port"
    left = {
        name: missing
        for name, call in known.items()
        if (missing := set(signature(call.function).parameters) - set(call.arguments) - {"given"})
    }
    assert left == {}


def test_arguments_that_are_right_are_taken(known: dict[str, Call]) -> None:
    refused = []
    for name, call in known.items():
        try:
            call.function(**call.arguments)
        except MissingDependency:
            pass
        except PlannerServiceError as error:
            if "no such file" not in str(error):
                refused.append(f"{name}: {error}"[:200])
    assert refused == []


def harm(call: Call, argument: str, hostile: str) -> str | None:
    """What is wrong with how a call takes a hostile argument."""
    value, began, worked = HOSTILE[hostile](), time.monotonic(), time.process_time()
    try:
        call.function(**{**call.arguments, argument: value})
    except BrokenInvariant as error:
        return f"BrokenInvariant: {error}"[:160]
    except PlannerServiceError as error:
        if "np." in str(error):  # repr of a number of numpy's
            return str(error)[:160]
    except Exception as error:  # that is what is looked for
        return f"{type(error).__name__}: {shown(error)}"[:160]
    worked, seconds = time.process_time() - worked, time.monotonic() - began
    return f"{worked:.1f} s of CPU time, {seconds:.1f} s" if worked > SECONDS or seconds > WAIT else None


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("hostile", HOSTILE)
def test_only_our_errors_come_of_hostile_arguments(known: dict[str, Call], hostile: str) -> None:
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, call in known.items():
            for argument in call.arguments:
                wrong = harm(call, argument, hostile)
                if wrong is not None:
                    found.append(f"{name}({argument}=): {wrong}")
    assert found == []
