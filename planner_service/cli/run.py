"""``planner-service run``: a plan on the simulated arm, or on a real one."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Annotated, Any

import typer
from rich.table import Table

from planner_service.cli.arguments import load_libraries, require_obstacles
from planner_service.cli.exits import BAD_INPUT, NO_PLAN, bad_input_exits, finish, json_text, wrapped
from planner_service.cli.listings import columns
from planner_service.cli.options import DEFAULT, AsJson, RobotName, Seed
from planner_service.cli.tables import emit, render
from planner_service.errors import InvalidRequest
from planner_service.execute import (
    HARDWARE_SPEED,
    ExecutedMotion,
    ExecutionReport,
    ExecutionStopped,
    Rehearsal,
    SimulatedArm,
    Streaming,
    TrossenDriver,
    execute,
    rehearse,
    taken,
)
from planner_service.execute.trossen import JOINT_NAMES
from planner_service.interchange import load_world
from planner_service.pick_place import plan_pick_place
from planner_service.plan_file import SavedPlan, SavedTask, load_plan_or_task
from planner_service.proving import proven_anew
from planner_service.request import PlanRequest
from planner_service.robot import Robot, load_robot
from planner_service.service import PlannerService
from planner_service.task import Segment
from planner_service.trajectory import Trajectory

__all__ = ["run"]

PADDING = 0.005
"""Metres that a pick-and-place to be executed keeps: an arm leaves its path by one to three millimetres."""

PATIENCE = 0.5
"""Seconds by which a command to the simulated arm may be late: there a stall does no harm."""


FOR_PLANNING = {"robot": "--robot", "scene": "--scene", "target": "--object", "onto": "--onto", "seed": "--seed"}
"""Options that say what is planned; a FILE has all that."""


def run(
    context: typer.Context,
    plan_file: Annotated[
        str | None, typer.Argument(metavar="FILE", help="A plan or task written with --out; else one is planned.")
    ] = None,
    sim: Annotated[bool, typer.Option("--sim", help="On the simulated arm.")] = False,
    arm: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="On the arm at this address; FILE is needed.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Move the real arm; without it, say what would be done.")] = False,
    speed: Annotated[
        float | None, typer.Option(help="Part of the planned speed.  [default: 1 in simulation, 0.2 on an arm]")
    ] = None,
    robot: RobotName = "wxai",
    scene: Annotated[str, typer.Option("--scene", help="The scene of a pick-and-place that is planned.")] = "bin",
    target: Annotated[str, typer.Option("--object", help="The obstacle to take.")] = "blue_block",
    onto: Annotated[str, typer.Option(help="The obstacle on whose middle to place it.")] = "tray",
    seed: Seed = DEFAULT.seed,
    as_json: AsJson = False,
) -> None:
    """Execute a plan, motion by motion, and compare where the arm was with where it was to be.

    With --sim and without a FILE a pick-and-place is planned for what lies where it does in the simulation.
    """
    with bad_input_exits():
        streaming = Streaming(speed=speed, latest=PATIENCE) if sim else Streaming(speed=speed)
        if sim == (arm is not None):
            raise InvalidRequest("--sim", sim, "either --sim or --arm ADDRESS")
        for name, option in FOR_PLANNING.items():
            source = context.get_parameter_source(name)
            if plan_file is not None and source is not None and source.name != "DEFAULT":
                given = context.params[name]
                raise InvalidRequest(option, given, "no such option with a FILE, which is executed as it was planned")
        if arm is not None:
            if plan_file is None:
                raise InvalidRequest("FILE", None, "a saved plan or task: look at it before an arm follows it")
            _on_an_arm(_opened(plan_file), arm, streaming, yes=yes, as_json=as_json)
            return
        opened = None if plan_file is None else _opened(plan_file)
        if opened is None:
            plan, done = _planned(load_robot(robot), (scene, target, onto), seed, streaming)
        else:
            plan, done = opened.plan, _rehearsed(opened, streaming)
    if done is None:
        finish(plan.document(), "", plan.failure if isinstance(plan, SavedTask) else None, (), as_json=as_json)
    else:
        _tell(done, plan, as_json=as_json)


@dataclass(frozen=True, eq=False)
class _Opened:
    """A saved plan with what it was made for."""

    plan: SavedPlan | SavedTask
    service: PlannerService


def _opened(file: str) -> _Opened:
    plan = load_plan_or_task(file)
    service = plan.service()
    return _Opened(proven_anew(plan, service), service)


def _rehearsed(opened: _Opened, streaming: Streaming) -> Rehearsal:
    service, plan = opened.service, opened.plan
    start = _trajectories(plan)[0][1](0.0)
    with SimulatedArm(service.robot, service.scene, start, loose=taken(plan, service.robot)) as arm:
        return rehearse(arm, plan, service.robot, streaming)


def _planned(
    robot: Robot, asked: tuple[str, str, str], seed: int, streaming: Streaming
) -> tuple[SavedPlan | SavedTask, Rehearsal | None]:
    """A pick-and-place for what is seen in the simulation, and how it went; None if there is no plan."""
    scene, target, onto = asked
    world = load_world(scene)
    require_obstacles(world, {"--object": target, "--onto": onto})
    with SimulatedArm(robot, world, loose=(target,)) as arm:
        service = PlannerService(robot, arm.seen())
        request = PlanRequest(robot.home, robot.home, seed=seed, padding=PADDING)
        load_libraries(request, robot)
        task = plan_pick_place(service, target, onto, request)
        return task, None if task.failure is not None else rehearse(arm, task, robot, streaming)


def _trajectories(plan: SavedPlan | SavedTask) -> list[tuple[str, Trajectory]]:
    """The motions with their names, in order.

    Raises:
        InvalidRequest: there is none, or one has no plan.
    """
    parts = plan.segments if isinstance(plan, SavedTask) else (Segment("motion", plan.result, 0.0),)
    found = [(part.name, part.result.trajectory) for part in parts if part.result.trajectory is not None]
    if not parts or len(found) < len(parts):
        raise InvalidRequest("FILE", "a failure", "a plan")
    return found


def _on_an_arm(opened: _Opened, address: str, streaming: Streaming, *, yes: bool, as_json: bool) -> None:
    robot, plan = opened.service.robot, opened.plan
    motions = _trajectories(plan)
    if robot.joint_names != JOINT_NAMES:  # six joints of another arm would be driven, were they near enough
        expected = f"a plan for the WidowX AI, of {JOINT_NAMES[0]} to {JOINT_NAMES[-1]}"
        raise InvalidRequest("FILE", robot.name, expected, message=f"FILE: made for {robot.name}; expected {expected}")
    if not yes:
        speed = HARDWARE_SPEED if streaming.speed is None else streaming.speed
        names, seconds = ", ".join(name for name, _ in motions), math.fsum(motion.duration for _, motion in motions)
        typer.echo(
            f"would move the arm at {address}: {names}; {seconds / speed:.1f} s of motion at {speed:g} of the planned "
            "speed.\nNothing was moved, nor connected to. Rehearse it with --sim, clear the arm's surroundings, have "
            "its emergency stop at hand, and say --yes.",
            err=True,
        )
        raise typer.Exit(BAD_INPUT)
    with _ended_as_by_ctrl_c(), closing(TrossenDriver(address)) as driver:
        try:
            report = execute(plan, driver, robot, streaming)
        except ExecutionStopped as stopped:
            report = stopped.report
    _tell(report, plan, as_json=as_json)


@contextmanager
def _ended_as_by_ctrl_c() -> Iterator[None]:
    """Have the arm hold, too, when this process is told to end, or the terminal that it runs in is gone."""
    found = [getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP")]
    numbers = [number for number in found if number is not None and signal.getsignal(number) != signal.SIG_IGN]
    before = [(number, signal.signal(number, signal.default_int_handler)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)


def _tell(found: Rehearsal | ExecutionReport, plan: SavedPlan | SavedTask, *, as_json: bool) -> None:
    report = found.report if isinstance(found, Rehearsal) else found
    if as_json:
        emit(json_text({"task": plan.task if isinstance(plan, SavedTask) else "motion", **found.document()}))
    else:
        where = "in simulation" if report.simulated else "on the arm"
        head = f"{'executed' if found.ok else 'NOT as planned'} {where}"
        head += f": {plan.task}" if isinstance(plan, SavedTask) else ""
        emit(render(head, "", _table(report.motions), "", *wrapped(_words(found))))
    if report.stopped is not None:
        typer.echo(report.stopped, err=True)
    if not found.ok:
        raise typer.Exit(NO_PLAN)


def _table(motions: tuple[ExecutedMotion, ...]) -> Table:
    names = ("seconds", "max mrad", "rms mrad", "final mrad", "lag mm", "off path mm", "late")
    rows = columns(("motion", False), *((name, True) for name in names))
    for motion in motions:
        angles = (motion.error_max.max(), motion.error_rms.max(), motion.final_error.max())
        figures = [f"{motion.duration:.2f}", *(f"{angle * 1000.0:.1f}" for angle in angles)]
        figures += [f"{metres * 1000.0:.1f}" for metres in (motion.tool_lag, motion.tool_off_path)]
        rows.add_row(motion.name, *figures, f"{motion.late} of {motion.ticks}")
    return rows


def _words(found: Rehearsal | ExecutionReport) -> list[str]:
    report: Any = found.report if isinstance(found, Rehearsal) else found
    motion = sum(one.duration for one in report.motions)
    lines = [f"wall time: {report.seconds:.1f} s, {motion:.1f} s of it motion at {report.speed:g} of the planned speed"]
    if isinstance(found, Rehearsal):
        pairs = sorted({" x ".join(sorted(contact.pair)) for contact in found.meant})
        lines += [f"contacts nobody meant: {len(found.contacts)}", *(f"  {contact}" for contact in found.contacts)]
        lines += [f"meant contacts: {', '.join(pairs)}"] if pairs else []
        for name, pose in found.loose.items():
            lines.append(f"{name} lies at {', '.join(f'{x:.4f}' for x in pose.position)}")
    return lines
