"""The command ``run``: executes a plan on the simulated arm or on a real one."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from planner_service.cli import arguments, options
from planner_service.cli.exit_codes import BAD_INPUT, NO_PLAN, bad_input_exits, finish, report_error
from planner_service.cli.options import argument, option
from planner_service.cli.output import show, wrapped
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
)
from planner_service.execute.preconditions import needs_a_service
from planner_service.execute.trossen import JOINT_NAMES
from planner_service.planning.request import PlanRequest
from planner_service.presentation.tables import Table
from planner_service.records.plan_file import SavedPlan, SavedTask, load_plan_or_task
from planner_service.records.recertify import Recertified, recertify
from planner_service.robot.model import Robot
from planner_service.scene.loading import load_scene
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import plan_pick_place

__all__ = ["run", "signals_as_ctrl_c"]

PADDING = 0.005
"""Padding in metres of a pick-and-place that is executed: an arm deviates from its path by one to three millimetres."""

PATIENCE = 0.5
"""Seconds by which a command to the simulated arm may be late; a delay does no harm in simulation."""


PLANNING_OPTIONS = {"target": "--object", "onto": "--onto", "seed": "--seed"}
"""Options for planning, which are no use with a FILE."""


def run(
    context: typer.Context,
    plan_file: Annotated[
        str | None, argument("FILE", "A plan or task saved with --out; without it, one is planned.")
    ] = None,
    sim: Annotated[bool, option("--sim", "Execute on the simulated arm.")] = False,
    arm: Annotated[str | None, option("ADDRESS", "Execute on the arm at this address; needs FILE.")] = None,
    yes: Annotated[bool, option("--yes", "Move the real arm; without it, only say what would happen.")] = False,
    speed: Annotated[
        float | None, option("X", "Fraction of the planned speed.  [default: 1 in simulation, 0.2 on an arm]")
    ] = None,
    robot: Annotated[
        options.RobotChoice | None,
        option(
            "NAME",
            "Robot to plan for; with FILE, your own, which must equal FILE's.  [default: wxai]",
            parser=options.chosen,
        ),
    ] = None,
    scene: Annotated[
        str | None, option("NAME", "Scene to plan in; with FILE, your own, which must equal FILE's.  [default: bin]")
    ] = None,
    allow: options.Allow = None,
    target: options.Target = "blue_block",
    onto: options.Onto = "tray",
    seed: options.Seed = options.DEFAULT.seed,
    as_json: options.AsJson = False,
) -> None:
    """Execute a plan motion by motion, and compare the measured motion with the planned one.

    FILE is proven again first. With --sim and without FILE, a pick-and-place is planned in the simulated scene.
    """
    with bad_input_exits():
        streaming = Streaming(speed=speed, latest=PATIENCE) if sim else Streaming(speed=speed)
        if sim == (arm is not None):
            given = "neither" if arm is None else "both"
            raise InvalidRequest("--sim", sim, "one", message=f"got {given}; give either --sim or --arm ADDRESS")
        for name, option in PLANNING_OPTIONS.items():
            source = context.get_parameter_source(name)
            if plan_file is not None and source is not None and source.name != "DEFAULT":
                value = context.params[name]
                raise InvalidRequest(option, value, "no such option with FILE, which is executed as it was planned")
        if arm is not None:
            if plan_file is None:
                raise InvalidRequest(
                    "FILE", None, "a saved plan or task, so that you can look at it before the arm moves"
                )
            _on_an_arm(_opened(plan_file, robot, scene, allow, streaming), arm, streaming, yes=yes, as_json=as_json)
            return
        if plan_file is None:
            if allow:
                raise InvalidRequest("--allow", " ".join(allow), "FILE too: it confirms pairs that FILE lets touch")
            arm_model = (robot or options.WXAI).load()
            plan, done = _planned(arm_model, scene or "bin", target=target, onto=onto, seed=seed, streaming=streaming)
        else:
            opened = _opened(plan_file, robot, scene, allow, streaming)
            plan, done = opened.plan, _rehearsed(opened, streaming)
    if done is None:
        finish(plan.document(), None, (), plan.failure, as_json=as_json)
    else:
        if plan_file is not None and scene is None:
            report_error(f"note: {arguments.from_file(plan)}")
        _report(done, plan, as_json=as_json)


@dataclass(frozen=True, eq=False)
class _Opened:
    """A saved plan and its new proof; ``service`` is the operator's own robot and scene, if given."""

    plan: SavedPlan | SavedTask
    service: PlannerService | None
    allowed: tuple[tuple[str, str], ...]
    proven: Recertified


def _opened(
    file: str, robot: options.RobotChoice | None, scene: str | None, allow: Sequence[str] | None, streaming: Streaming
) -> _Opened:
    """A saved plan, proven again, in the operator's own robot and scene if both are given.

    Raises:
        NotProven: it is not.
    """
    plan, service = load_plan_or_task(file), None
    _require_plan(plan)
    if robot is not None or scene is not None:
        if robot is None or scene is None:
            option = "--robot" if robot is None else "--scene"
            raise InvalidRequest(option, None, "both --robot and --scene: your own, to compare with those in FILE")
        service = arguments.service_for(robot, scene)
    for note in arguments.differences(plan.robot) if service is None else []:
        report_error(f"note: {note}")
    allowed = arguments.pairs_of_texts("--allow", allow or ())
    proven = recertify(plan, service, allowed=allowed, squeeze=streaming.squeeze)
    return _Opened(plan, service, allowed, proven.required())


def _rehearsed(opened: _Opened, streaming: Streaming) -> Rehearsal:
    world, plan = opened.proven.world, opened.plan
    start = opened.proven.motions[0].motion.trajectory(0.0)
    with SimulatedArm(world.robot, world.scene, start, loose=opened.proven.taken) as arm:
        return rehearse(arm, plan, world.robot, streaming, service=opened.service, allowed=opened.allowed)


def _planned(
    robot: Robot, scene: str, *, target: str, onto: str, seed: int, streaming: Streaming
) -> tuple[SavedPlan | SavedTask, Rehearsal | None]:
    """A pick-and-place for the scene seen in simulation, and how it went; None if there is no plan."""
    world = load_scene(scene)
    arguments.require_obstacles(world, {"--object": target, "--onto": onto})
    with SimulatedArm(robot, world, loose=(target,)) as arm:
        service = PlannerService(robot, arm.seen())
        request = PlanRequest(robot.home, robot.home, seed=seed, padding=PADDING)
        arguments.load_libraries(request, robot)
        task = SavedTask.of(plan_pick_place(service, target, onto, request))
        return task, None if task.failure is not None else rehearse(arm, task, robot, streaming)


def _require_plan(plan: SavedPlan | SavedTask) -> None:
    if plan.failure is not None or not plan.segments:
        raise InvalidRequest("FILE", "a failure", "a file that holds a plan")


def _on_an_arm(opened: _Opened, address: str, streaming: Streaming, *, yes: bool, as_json: bool) -> None:
    robot, plan, proven = opened.proven.world.robot, opened.plan, opened.proven
    if robot.joint_names != JOINT_NAMES:  # the driver would accept any six joints
        expected = f"a plan for the WidowX AI, of {JOINT_NAMES[0]} to {JOINT_NAMES[-1]}"
        raise InvalidRequest("FILE", robot.name, expected, message=f"FILE: made for {robot.name}; expected {expected}")
    if not yes:
        speed = HARDWARE_SPEED if streaming.speed is None else streaming.speed
        names = ", ".join(motion.name for motion in proven.motions)
        seconds = math.fsum(motion.motion.trajectory.duration for motion in proven.motions)
        unchecked = ["", "Not checked:", *(f"  {line}" for line in proven.not_checked)] if proven.not_checked else []
        missing = (
            []
            if opened.service
            else ["To move a real arm, also give --robot and --scene: your own, equal to those in FILE."]
        )
        report_error(
            f"would move the arm at {address}: {names}; {seconds / speed:.1f} s of motion, "
            f"at {100.0 * speed:g}% of the planned speed.",
            *wrapped(unchecked, "    "),
            "Nothing moved, and no connection was made. Rehearse with --sim, clear the area around the arm, "
            "keep the emergency stop within reach, then add --yes.",
            *missing,
        )
        raise typer.Exit(BAD_INPUT)
    if opened.service is None:
        raise needs_a_service(plan)
    with signals_as_ctrl_c(), closing(TrossenDriver(address)) as driver:
        try:
            report = execute(plan, driver, None, streaming, service=opened.service, allowed=opened.allowed)
        except ExecutionStopped as stopped:
            report = stopped.report
        except KeyboardInterrupt as interrupt:
            report_error(f"interrupted; {interrupt}" if interrupt.args else "interrupted")
            raise
    _report(report, plan, as_json=as_json)


@contextmanager
def signals_as_ctrl_c() -> Iterator[None]:
    """Stop the arm as Ctrl-C does when the process is terminated or its terminal is closed."""
    known = [getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP")]
    numbers = [number for number in known if number is not None and signal.getsignal(number) != signal.SIG_IGN]
    before = [(number, signal.signal(number, signal.default_int_handler)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)


def _report(done: Rehearsal | ExecutionReport, plan: SavedPlan | SavedTask, *, as_json: bool) -> None:
    report = done.report if isinstance(done, Rehearsal) else done
    where = "in simulation" if report.simulated else "on the arm"
    title = f"{'executed' if done.ok else 'NOT as planned'} {where}"
    title += f": {plan.task}" if isinstance(plan, SavedTask) else ""
    document = {"task": plan.task if isinstance(plan, SavedTask) else "motion", **done.document()}
    show(document, title, "", _table(report.motions), "", *wrapped(_lines(done)), as_json=as_json)
    if report.stopped is not None:
        report_error(report.stopped)
    if not done.ok:
        raise typer.Exit(NO_PLAN)


def _table(motions: tuple[ExecutedMotion, ...]) -> Table:
    names = ("seconds", "max mrad", "rms mrad", "final mrad", "lag mm", "off path mm", "late")
    rows = []
    for motion in motions:
        angles = (motion.error_max.max(), motion.error_rms.max(), motion.final_error.max())
        figures = [f"{motion.duration:.2f}", *(f"{angle * 1000.0:.1f}" for angle in angles)]
        figures += [f"{metres * 1000.0:.1f}" for metres in (motion.tool_lag, motion.tool_off_path)]
        rows.append((motion.name, *figures, f"{motion.late} of {motion.ticks}"))
    return Table(("motion", *names), rows, numeric=names)


def _lines(done: Rehearsal | ExecutionReport) -> list[str]:
    report: Any = done.report if isinstance(done, Rehearsal) else done
    motion = sum(each.duration for each in report.motions)
    speed = f"{100.0 * report.speed:g}% of the planned speed"
    lines = [f"wall time: {report.seconds:.1f} s, {motion:.1f} s in motion, at {speed}"]
    if isinstance(done, Rehearsal):
        pairs = sorted({" x ".join(sorted(contact.pair)) for contact in done.meant})
        lines += [f"unexpected contacts: {len(done.contacts)}", *(f"  {contact}" for contact in done.contacts)]
        lines += [f"expected contacts: {', '.join(pairs)}"] if pairs else []
        for name, pose in done.loose.items():
            lines.append(f"{name} lies at {', '.join(f'{x:.4f}' for x in pose.position)}")
    return lines
