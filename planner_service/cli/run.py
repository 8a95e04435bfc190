"""``planner-service run``: a plan on the simulated arm, or on a real one."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Annotated, Any

import typer
from rich.table import Table

from planner_service.cli.arguments import (
    differences,
    from_file,
    load_libraries,
    pairs_of_texts,
    require_obstacles,
    service_for,
)
from planner_service.cli.exit_codes import BAD_INPUT, NO_PLAN, bad_input_exits, finish, json_text, wrapped
from planner_service.cli.listings import columns
from planner_service.cli.options import DEFAULT, Allow, AsJson, Seed
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
)
from planner_service.execute.preconditions import needs_a_service
from planner_service.execute.trossen import JOINT_NAMES
from planner_service.planning.request import PlanRequest
from planner_service.records.plan_file import SavedPlan, SavedTask, load_plan_or_task
from planner_service.records.recertify import Recertified, recertify
from planner_service.robot.model import Robot, load_robot
from planner_service.scene.worlds import load_world
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import plan_pick_place

__all__ = ["run"]

PADDING = 0.005
"""Metres that a pick-and-place to be executed keeps: an arm leaves its path by one to three millimetres."""

PATIENCE = 0.5
"""Seconds by which a command to the simulated arm may be late: there a stall does no harm."""


FOR_PLANNING = {"target": "--object", "onto": "--onto", "seed": "--seed"}
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
    robot: Annotated[
        str | None,
        typer.Option(
            help="The robot to plan for; with FILE your own, which must equal the one in it.  [default: wxai]"
        ),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(help="The scene to plan in; with FILE your own, which must equal the one in it.  [default: bin]"),
    ] = None,
    allow: Allow = None,
    target: Annotated[str, typer.Option("--object", help="The obstacle to take.")] = "blue_block",
    onto: Annotated[str, typer.Option(help="The obstacle on whose middle to place it.")] = "tray",
    seed: Seed = DEFAULT.seed,
    as_json: AsJson = False,
) -> None:
    """Execute a plan, motion by motion, and compare the measured with the planned motion.

    FILE is proven again first. With --sim and no FILE, a pick-and-place is planned in the simulated scene.
    """
    with bad_input_exits():
        streaming = Streaming(speed=speed, latest=PATIENCE) if sim else Streaming(speed=speed)
        if sim == (arm is not None):
            found = "neither" if arm is None else "both"
            raise InvalidRequest("--sim", sim, "one", message=f"got {found}; give either --sim or --arm ADDRESS")
        for name, option in FOR_PLANNING.items():
            source = context.get_parameter_source(name)
            if plan_file is not None and source is not None and source.name != "DEFAULT":
                given = context.params[name]
                raise InvalidRequest(option, given, "no such option with a FILE, which is executed as it was planned")
        if arm is not None:
            if plan_file is None:
                raise InvalidRequest("FILE", None, "a saved plan or task: look at it before an arm follows it")
            _on_an_arm(_opened(plan_file, robot, scene, allow, streaming), arm, streaming, yes=yes, as_json=as_json)
            return
        if plan_file is None:
            if allow:
                raise InvalidRequest("--allow", " ".join(allow), "it with a FILE: it names pairs that FILE exempts")
            plan, done = _planned(load_robot(robot or "wxai"), (scene or "bin", target, onto), seed, streaming)
        else:
            opened = _opened(plan_file, robot, scene, allow, streaming)
            plan, done = opened.plan, _rehearsed(opened, streaming)
    if done is None:
        finish(plan.document(), "", plan.failure if isinstance(plan, SavedTask) else None, (), as_json=as_json)
    else:
        if plan_file is not None and scene is None:
            typer.echo(f"note: {from_file(plan)}", err=True)
        _tell(done, plan, as_json=as_json)


@dataclass(frozen=True, eq=False)
class _Opened:
    """A saved plan with what was found of it; ``service`` is the operator's own, if it was given."""

    plan: SavedPlan | SavedTask
    service: PlannerService | None
    allowed: tuple[tuple[str, str], ...]
    found: Recertified


def _opened(
    file: str, robot: str | None, scene: str | None, allow: Sequence[str] | None, streaming: Streaming
) -> _Opened:
    """A saved plan that is proven again, in the world that the operator knows if both parts of it are given.

    Raises:
        NotProven: it is not.
    """
    plan, service = load_plan_or_task(file), None
    _require_plan(plan)
    if robot is not None or scene is not None:
        if robot is None or scene is None:
            option = "--robot" if robot is None else "--scene"
            raise InvalidRequest(option, None, "both --robot and --scene: your own, to compare with those in FILE")
        service = service_for(robot, scene)
    for note in differences(plan.robot) if service is None else []:
        typer.echo(f"note: {note}", err=True)
    allowed = pairs_of_texts("--allow", allow or ())
    found = recertify(plan, service, allowed=allowed, squeeze=streaming.squeeze)
    return _Opened(plan, service, allowed, found.required())


def _rehearsed(opened: _Opened, streaming: Streaming) -> Rehearsal:
    world, plan = opened.found.world, opened.plan
    start = opened.found.motions[0].leg.trajectory(0.0)
    with SimulatedArm(world.robot, world.scene, start, loose=opened.found.taken) as arm:
        return rehearse(arm, plan, world.robot, streaming, service=opened.service, allowed=opened.allowed)


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
        task = SavedTask.of(plan_pick_place(service, target, onto, request))
        return task, None if task.failure is not None else rehearse(arm, task, robot, streaming)


def _require_plan(plan: SavedPlan | SavedTask) -> None:
    failure = plan.failure if isinstance(plan, SavedTask) else plan.result.failure
    if failure is not None or (isinstance(plan, SavedTask) and not plan.segments):
        raise InvalidRequest("FILE", "a failure", "a plan")


def _on_an_arm(opened: _Opened, address: str, streaming: Streaming, *, yes: bool, as_json: bool) -> None:
    robot, plan, found = opened.found.world.robot, opened.plan, opened.found
    if robot.joint_names != JOINT_NAMES:  # six joints of another arm would be driven, were they near enough
        expected = f"a plan for the WidowX AI, of {JOINT_NAMES[0]} to {JOINT_NAMES[-1]}"
        raise InvalidRequest("FILE", robot.name, expected, message=f"FILE: made for {robot.name}; expected {expected}")
    if not yes:
        speed = HARDWARE_SPEED if streaming.speed is None else streaming.speed
        names = ", ".join(motion.name for motion in found.motions)
        seconds = math.fsum(motion.leg.trajectory.duration for motion in found.motions)
        unjudged = ["", "Not judged:", *(f"  {line}" for line in found.lenience)] if found.lenience else []
        missing = (
            [] if opened.service else ["A real arm also needs --robot and --scene: your own, equal to those in FILE."]
        )
        typer.echo(
            "\n".join(
                [
                    f"would move the arm at {address}: {names}; {seconds / speed:.1f} s of motion, "
                    f"at {100.0 * speed:g}% of the planned speed.",
                    *wrapped(unjudged, "    "),
                    "Nothing moved, and no connection was made. Rehearse it with --sim, clear the area around the arm, "
                    "keep the emergency stop within reach, then add --yes.",
                    *missing,
                ]
            ),
            err=True,
        )
        raise typer.Exit(BAD_INPUT)
    if opened.service is None:
        raise needs_a_service(plan)
    with _ended_as_by_ctrl_c(), closing(TrossenDriver(address)) as driver:
        try:
            report = execute(plan, driver, None, streaming, service=opened.service, allowed=opened.allowed)
        except ExecutionStopped as stopped:
            report = stopped.report
        except KeyboardInterrupt as interrupt:
            typer.echo(f"interrupted; {interrupt}" if interrupt.args else "interrupted", err=True)
            raise
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
    speed = f"{100.0 * report.speed:g}% of the planned speed"
    lines = [f"wall time: {report.seconds:.1f} s, {motion:.1f} s in motion, at {speed}"]
    if isinstance(found, Rehearsal):
        pairs = sorted({" x ".join(sorted(contact.pair)) for contact in found.meant})
        lines += [f"unexpected contacts: {len(found.contacts)}", *(f"  {contact}" for contact in found.contacts)]
        lines += [f"meant contacts: {', '.join(pairs)}"] if pairs else []
        for name, pose in found.loose.items():
            lines.append(f"{name} lies at {', '.join(f'{x:.4f}' for x in pose.position)}")
    return lines
