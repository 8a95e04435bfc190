"""The command line: its commands in the order a person meets them."""

from __future__ import annotations

import inspect
import logging
import math
import os
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from planner_service.cli import arguments, options
from planner_service.cli.exit_codes import NO_PLAN, OUR_BUG, ErrorLog, bad_input_exits, finish
from planner_service.cli.options import argument, option
from planner_service.cli.output import show, wrapped
from planner_service.collision import CollisionChecker
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import PlanResult, plan_lines, plan_rows
from planner_service.presentation.tables import CostTable, Table
from planner_service.robot.model import length_unit, robot_blocks
from planner_service.robot_setup.loading import robot_file
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import scene_blocks, scene_names
from planner_service.service import PlannerService

if TYPE_CHECKING:
    from planner_service.robot_setup.kernel_check import Health

__all__ = ["app"]

NAMES = (
    *(
        "robots",
        "scenes",
        "problems",
        "check",
        "plan",
        "plan-cell",
        "explain",
        "pick-place",
        "solve",
        "order",
        "view",
        "certify",
        "export",
        "join",
    ),
    *("run", "import-robot", "episodes", "serve", "doctor", "roadmap", "reachability", "gate", "robot"),
)
"""All commands, in the order of the help."""


class _Commands(TyperGroup):
    """A group whose commands are here, or are imported as they are asked for: see ``_others``."""

    def get_command(self, ctx: typer.Context, cmd_name: str) -> Any:  # type: ignore[override]
        """The command of a name; None if there is none."""
        if cmd_name not in self.commands:
            others: Any = typer.main.get_command(_others())
            self.commands.update(others.commands)
        return super().get_command(ctx, cmd_name)

    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]
        """The names of all commands."""
        return list(NAMES)


app = typer.Typer(
    cls=_Commands,
    help="Motion planning for a robot arm on a table, with every collision check counted.",
    epilog="Exit codes: 0 planned or free, 1 no plan or in collision, 2 bad input, 130 interrupted, 70 internal error.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

ONE = "Show this one in detail; a name or a file."
Name = Annotated[str | None, argument("NAME", ONE)]
RobotName = Annotated[options.RobotChoice | None, argument("NAME", ONE, parser=options.chosen)]


def plan(
    start: options.Start,
    goal: options.Goals,
    scene: options.SceneName,
    robot: options.RobotName = options.WXAI,
    planner: options.PlannerName = options.DEFAULT.planner.name,
    timing: options.TimingName = "toppra",
    seed: options.Seed = options.DEFAULT.seed,
    max_checks: options.MaxChecks = options.DEFAULT.max_checks,
    time_limit: options.TimeLimit = options.SECONDS,
    padding: options.Padding = options.DEFAULT.padding,
    start_overlap: options.StartOverlap = options.DEFAULT.start_overlap,
    blend: options.Blend = options.DEFAULT.blend,
    max_tool_speed: options.ToolSpeed = None,
    torque: options.Torque = False,
    payload: options.PayloadText = None,
    improve: options.Improve = options.DEFAULT.improve,
    polish: options.Polish = False,
    clearance: options.Clearance = None,
    upright: options.Upright = None,
    region: options.Region = None,
    plot: options.Plot = None,
    png: options.Picture = None,
    out: options.Out = None,
    as_json: options.AsJson = False,
) -> None:
    """Plan a motion from a configuration to a goal and print what each stage did and cost."""
    with bad_input_exits():
        arguments.require_outputs({"--out": out, "--plot": plot, "--png": png})
        service = arguments.service_for(robot, scene)
        q_start = arguments.configuration("--start", start, service.robot)
        constraints, kept = arguments.constraints(upright, region, service.robot, q_start)
        request = PlanRequest(
            q_start,
            arguments.goals(goal, service.robot),
            arguments.planner_or_optimise(planner, clearance, polish=polish),
            arguments.timing_by_name(timing, torque=torque or payload is not None),
            seed=seed,
            max_checks=max_checks,
            time_limit=arguments.time_limit_of(time_limit),
            padding=padding,
            start_overlap=start_overlap,
            blend=blend,
            max_tool_speed=max_tool_speed,
            payload=arguments.payload(payload),
            improve=improve,
            polish=arguments.optimise(clearance) if polish else None,
            constraints=constraints,
        )
        arguments.load_libraries(request, service.robot)
        result = service.plan(request)
        if out is not None:
            result.save(out)
        if png is not None:
            from planner_service.view.still.pictures import draw_plan

            draw_plan(service, request, result, png)
        lines = [*kept, *plan_lines(result)]
        if plot is not None and result.path is not None:
            _plot(plot, service, request, result)
        elif plot is not None:
            lines.append(f"note: there is no path to plot; {plot} is not written")
    title = f"{'planned' if result.ok else 'no plan'}: {robot} in {scene}, {start} -> {' or '.join(goal)}"
    table = CostTable(title, plan_rows(result), length_unit(service.robot))
    finish(partial(_plan_document, result), table, lines, result.failure, as_json=as_json)


def _plan_document(result: PlanResult) -> dict[str, Any]:
    from planner_service.records.plan_file import SavedPlan

    return SavedPlan.of(result).document()


def explain(
    start: options.Start,
    goal: options.Goals,
    scene: options.SceneName,
    robot: options.RobotName = options.WXAI,
    seed: options.Seed = options.DEFAULT.seed,
    max_checks: options.MaxChecks = options.DEFAULT.max_checks,
    time_limit: Annotated[float, option("SECONDS", "Wall time of all of it; inf for no limit.")] = math.inf,
    padding: options.Padding = options.DEFAULT.padding,
    start_overlap: options.StartOverlap = options.DEFAULT.start_overlap,
    upright: options.Upright = None,
    region: options.Region = None,
    plans: Annotated[int, option("N", "Plans that may be tried.")] = 60,
    evidence: Annotated[
        str | None, option("FILE", "Save the proof that no path exists, if one is found, for others.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Explain why there is no plan, whether that is proven, and what would help.

    Every change that is suggested was planned and gives a proven plan: an end moved out of a collision, the tool
    turned, a constraint relaxed, an object moved just far enough, or taken away.
    """
    from planner_service.records.exports.explanation import ReachedRecord
    from planner_service.records.exports.no_path_file import save_no_path
    from planner_service.records.result import result_record

    with bad_input_exits():
        arguments.require_outputs({"--evidence": evidence})
        service = arguments.service_for(robot, scene)
        q_start = arguments.configuration("--start", start, service.robot)
        constraints, _ = arguments.constraints(upright, region, service.robot, q_start)
        request = PlanRequest(
            q_start,
            arguments.goals(goal, service.robot),
            seed=seed,
            max_checks=max_checks,
            padding=padding,
            start_overlap=start_overlap,
            constraints=constraints,
        )
        explained = service.explain(request, plans=plans, time_limit=arguments.time_limit_of(time_limit))
        if evidence is not None and explained.no_path is not None:
            save_no_path(explained.no_path, service.world, q_start, request.goals(service.robot), evidence)
    failure = explained.result.failure
    document = {
        "ok": failure is None,
        "failure": result_record(explained.result)["failure"],
        "proven": explained.proven,
        "no_path": None if explained.no_path is None else str(explained.no_path),
        "reached": None if explained.reached is None else ReachedRecord.of(explained.reached).document(),
        "way": None if explained.way is None else _plan_document(explained.way),
        "remedies": [remedy.text for remedy in explained.remedies],
        "plans": explained.plans,
        "complete": explained.complete,
    }
    lines = str(explained).splitlines()
    if evidence is not None:
        found = f"the proof that no path exists is in {evidence}"
        lines.append("no proof that no path exists was found" if explained.no_path is None else found)
    show(document, *lines, as_json=as_json)
    raise typer.Exit(0 if failure is None else NO_PLAN)


def pick_place(
    robot: options.RobotName = options.WXAI,
    scene: options.SceneName = "bin",
    target: options.Target = "blue_block",
    onto: options.Onto = "tray",
    planner: options.PlannerName = options.DEFAULT.planner.name,
    timing: options.TimingName = "toppra",
    seed: options.Seed = options.DEFAULT.seed,
    max_checks: options.MaxChecks = options.DEFAULT.max_checks,
    time_limit: options.TimeLimit = options.SECONDS,
    padding: options.Padding = options.DEFAULT.padding,
    blend: options.Blend = options.DEFAULT.blend,
    max_tool_speed: options.ToolSpeed = None,
    torque: options.Torque = False,
    payload: options.PayloadText = None,
    upright: options.UprightObject = None,
    png: options.Picture = None,
    out: options.Out = None,
    as_json: options.AsJson = False,
) -> None:
    """Plan a pick-and-place from home and back to home, and print what each motion did and cost."""
    from planner_service.planning.task_result import task_lines, task_rows
    from planner_service.records.evidence import save_plan
    from planner_service.records.plan_file import SavedTask
    from planner_service.tasks.pick_place import plan_pick_place
    from planner_service.view.still.pictures import draw_task

    with bad_input_exits():
        arguments.require_outputs({"--out": out, "--png": png})
        service = arguments.service_for(robot, scene)
        arguments.require_obstacles(service.scene, {"--object": target, "--onto": onto})
        request = PlanRequest(
            service.robot.home,
            service.robot.home,
            arguments.planner_or_optimise(planner, None, polish=False),
            arguments.timing_by_name(timing, torque=torque or payload is not None),
            seed=seed,
            max_checks=max_checks,
            time_limit=arguments.time_limit_of(time_limit),
            padding=padding,
            blend=blend,
            max_tool_speed=max_tool_speed,
            payload=arguments.payload(payload),
        )
        arguments.load_libraries(request, service.robot)
        task = SavedTask.of(plan_pick_place(service, target, onto, request, upright=arguments.lean(upright)))
        if out is not None:
            save_plan(task, out)
        if png is not None:
            draw_task(service, task, png)
    title = f"{'planned' if task.failure is None else 'no plan'}: {task.task}"
    table = CostTable(title, task_rows(task), length_unit(service.robot))
    finish(task.document(), table, task_lines(task), task.failure, as_json=as_json)


def solve(
    file: Annotated[str, argument("FILE", "A task: its steps as JSON, as Task.save writes them.")],
    scene: options.SceneName,
    start: options.Start = "home",
    robot: options.RobotName = options.WXAI,
    planner: options.PlannerName = options.DEFAULT.planner.name,
    timing: options.TimingName = "toppra",
    seed: options.Seed = options.DEFAULT.seed,
    max_checks: options.MaxChecks = options.DEFAULT.max_checks,
    time_limit: options.TimeLimit = options.SECONDS,
    padding: options.Padding = options.DEFAULT.padding,
    max_tool_speed: options.ToolSpeed = None,
    memory: options.MemoryFile = None,
    png: options.Picture = None,
    out: options.Out = None,
    as_json: options.AsJson = False,
) -> None:
    """Solve a task that is composed of steps, and print what each motion cost, or which step has no plan and why."""
    from planner_service.memory import NOTHING, Memory
    from planner_service.planning.task_result import step_table, task_lines, task_rows
    from planner_service.records.evidence import save_plan
    from planner_service.records.plan_file import SavedTask
    from planner_service.tasks.task import Task
    from planner_service.view.still.pictures import draw_task

    with bad_input_exits():
        arguments.require_outputs({"--out": out, "--png": png, "--memory": memory})
        service, task = arguments.service_for(robot, scene), Task.load(file)
        known = None
        if memory is not None:
            known = Memory.load(memory) if os.path.lexists(memory) else NOTHING
        q = arguments.configuration("--start", start, service.robot)
        request = PlanRequest(
            q,
            q,
            arguments.planner_or_optimise(planner, None, polish=False),
            arguments.timing_by_name(timing, torque=False),
            seed=seed,
            max_checks=max_checks,
            time_limit=arguments.time_limit_of(time_limit),
            padding=padding,
            max_tool_speed=max_tool_speed,
        )
        arguments.load_libraries(request, service.robot)
        solved = service.solve(task, q, request=request, memory=known)
        saved = SavedTask.of(solved)
        if memory is not None:
            solved.memory.save(memory)
        if out is not None:
            save_plan(saved, out)
        if png is not None:
            draw_task(service, saved, png)
    title = f"{'planned' if saved.failure is None else 'no plan'}: {saved.task}"
    table = CostTable(title, task_rows(saved), length_unit(service.robot))
    fared = None if saved.failure is None else step_table(saved.steps)
    finish(saved.document(), table, task_lines(saved), saved.failure, as_json=as_json, last=fared)


def order(
    file: Annotated[str, argument("FILE", "Visits as JSON, as save_visits writes them.")],
    scene: options.SceneName,
    start: options.Start = "home",
    end: Annotated[str | None, option("--end", "Q", "Where the arm ends; where it starts if not given.")] = None,
    gap: Annotated[float, option("--gap", "SHARE", "Share by which the order may be longer than the best.")] = 0.05,
    plans: Annotated[int, option("--plans", "N", "Motions between visits that may be planned.", min=1)] = 3000,
    robot: options.RobotName = options.WXAI,
    planner: options.PlannerName = options.DEFAULT.planner.name,
    timing: options.TimingName = "toppra",
    seed: options.Seed = options.DEFAULT.seed,
    max_checks: options.MaxChecks = options.DEFAULT.max_checks,
    time_limit: options.TimeLimit = options.SECONDS,
    padding: options.Padding = options.DEFAULT.padding,
    max_tool_speed: options.ToolSpeed = None,
    png: options.Picture = None,
    out: options.Out = None,
    as_json: options.AsJson = False,
) -> None:
    """Put visits in the order that takes least time, and print each motion and how far from the best that can be."""
    from planner_service.planning.task_result import task_lines, task_rows
    from planner_service.records.evidence import save_plan
    from planner_service.records.visits import load_visits, saved_order
    from planner_service.tasks.ordering import order as ordered
    from planner_service.view.still.pictures import draw_task

    with bad_input_exits():
        arguments.require_outputs({"--out": out, "--png": png})
        service, visits = arguments.service_for(robot, scene), load_visits(file)
        q = arguments.configuration("--start", start, service.robot)
        request = PlanRequest(
            q,
            q,
            arguments.planner_or_optimise(planner, None, polish=False),
            arguments.timing_by_name(timing, torque=False),
            seed=seed,
            max_checks=max_checks,
            time_limit=arguments.time_limit_of(time_limit),
            padding=padding,
            max_tool_speed=max_tool_speed,
        )
        arguments.load_libraries(request, service.robot)
        last = None if end is None else arguments.configuration("--end", end, service.robot)
        found = ordered(service, visits, request, end=last, gap=gap, plans=plans)
        saved = saved_order(found)
        if out is not None:
            save_plan(saved, out)
        if png is not None:
            draw_task(service, saved, png)
    title = f"{'planned' if found.ok else 'no plan'}: {saved.task}"
    table = CostTable(title, task_rows(saved), length_unit(service.robot))
    lines = [*([str(found)] if found.ok else []), *task_lines(saved)]
    finish(saved.document(), table, lines, saved.failure, as_json=as_json)


def check(
    q: Annotated[str, option("--q", "Q", "A named pose, or comma-separated joint values.")],
    scene: options.SceneName,
    robot: options.RobotName = options.WXAI,
    png: options.Picture = None,
    as_json: options.AsJson = False,
) -> None:
    """Say whether a configuration is collision-free, which pairs touch, and how much clearance is proven."""
    with bad_input_exits():
        arguments.require_outputs({"--png": png})
        arm, world = robot.load(), load_scene(scene)
        values = arguments.configuration("--q", q, arm)
        checker = CollisionChecker(arm, world)
        contacts, clearance = checker.contacts(values), checker.clearance(values)
        if png is not None:
            from planner_service.view.still.pictures import draw_check

            draw_check(checker, values, png)
    bound = clearance if math.isfinite(clearance) else None
    touching = [{"a": c.a, "b": c.b, "depth_at_most": c.depth} for c in contacts]
    verdict = {"free": not contacts, "q": values.tolist(), "contacts": touching, "clearance_at_least": bound}
    lines = [f"{'colliding' if contacts else 'free'}: {robot} in {scene} at {q}"]
    lines += [f"  {contact}" for contact in contacts]
    if not contacts:
        lines.append("  nothing to touch" if bound is None else f"  clearance: at least {bound * 1000:.1f} mm")
    show({"robot": arm.name, "scene": world.name, **verdict}, *lines, as_json=as_json)
    raise typer.Exit(NO_PLAN if contacts else 0)


def robots(name: RobotName = None, as_json: options.AsJson = False) -> None:
    """List the robots that come with the package, or show one: its joint limits and named poses."""
    from planner_service.cli import listings

    with bad_input_exits():
        models, missing = listings.shipped_robots() if name is None else ([name.load()], {})
    records = [listings.robot_record(robot) for robot in models]
    if name is not None:
        show(records[0], *robot_blocks(models[0]), as_json=as_json)
        return
    rows = [[robot.name, str(robot.n), str(len(robot.shapes)), ", ".join(robot.poses)] for robot in models]
    rows += [[absent, "", "", why] for absent, why in missing.items()]
    table = Table(("robot", "joints", "shapes", "poses"), rows, numeric=("joints", "shapes"))
    show({"robots": records, "missing": missing}, table, as_json=as_json)


def scenes(name: Name = None, as_json: options.AsJson = False) -> None:
    """List the scenes that come with the package, or show one: its obstacles with sizes and poses, in metres."""
    from planner_service.cli import listings

    with bad_input_exits():
        worlds = [load_scene(entry) for entry in ([name] if name is not None else scene_names())]
    records = [listings.scene_record(scene) for scene in worlds]
    if name is not None:
        show(records[0], *scene_blocks(worlds[0]), as_json=as_json)
        return
    rows = [[scene.name, str(len(scene.obstacles)), scene.description] for scene in worlds]
    table = Table(("scene", "obstacles", "description"), rows, numeric=("obstacles",))
    show({"scenes": records}, table, as_json=as_json)


def problems(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE", help="A folder or .tar.bz2 of MotionBenchMaker, JSON of VAMP or ours, or robometrics' YAML."
        ),
    ],
    robot: Annotated[
        options.RobotChoice | None, option("NAME", "Plan the problems with this robot.", parser=options.chosen)
    ] = None,
    only: Annotated[str | None, typer.Option("--id", metavar="ID", help="Only the problem of that name.")] = None,
    planner: options.PlannerName = options.DEFAULT.planner.name,
    seed: options.Seed = options.DEFAULT.seed,
    time_limit: options.TimeLimit = options.SECONDS,
    as_json: options.AsJson = False,
) -> None:
    """List the problems of a published set, or plan them with a robot."""
    from planner_service.cli import listings
    from planner_service.records.problems import read_problems

    with bad_input_exits():
        found = read_problems(file)
        chosen = found.problems if only is None else (found.problem(only),)
        settings: dict[str, Any] = {"seed": seed, "time_limit": arguments.time_limit_of(time_limit)}
        settings["planner"] = arguments.planner_or_optimise(planner, None, polish=False)
        results: list[PlanResult | None] = [None] * len(chosen)
        if robot is not None:
            arm = robot.load()
            requests = [problem.request(arm, **settings) for problem in chosen]  # all are refused before any is planned
            pairs = zip(chosen, requests, strict=True)
            results = [PlannerService(arm, problem.scene).plan(request) for problem, request in pairs]
    records = [listings.problem_record(*pair) for pair in zip(chosen, results, strict=True)]
    planned = [result for result in results if result is not None]
    rows = [
        [
            *(record["id"], str(record["obstacles"]), str(record["goals"])),
            *([] if result is None else ["yes" if result.ok else str(result.failure), f"{result.counts.states:,}"]),
            *([] if result is None else [f"{1e3 * result.seconds:.1f}"]),
        ]
        for record, result in zip(records, results, strict=True)
    ]
    columns = ("problem", "obstacles", "goals", *(("planned", "states", "ms") if planned else ()))
    table = Table(columns, rows, numeric=("obstacles", "goals", "states", "ms"))
    solved = sum(result.ok for result in planned)
    lines = [f"{solved} of {len(planned)} planned"] if planned else []
    show({"robot": found.robot, "source": found.source, "problems": records}, table, *wrapped(lines), as_json=as_json)
    if solved < len(planned):
        raise typer.Exit(NO_PLAN)


def doctor(
    robot: options.RobotName = options.WXAI,
    scene: options.SceneName = "bin",
    states: Annotated[int, option("N", "Random configurations to compare them on.")] = 1000,
    seed: options.Seed = 0,
    as_json: options.AsJson = False,
) -> None:
    """Show which compiled code is in use, and compare it with its judges: checks, searches, proofs and timing."""
    from planner_service.robot_setup.kernel_check import examine

    with bad_input_exits():
        health = examine(robot.load(), load_scene(scene), states=states, seed=seed)
    document = {**asdict(health), "agrees": health.agrees}
    show(document, *_health_lines(health, f"{robot} in {scene}"), as_json=as_json)
    raise typer.Exit(0 if health.agrees else OUR_BUG)


def import_robot_(
    urdf: Annotated[str, argument("URDF", "The robot's description: URDF, xacro or MJCF, or example-robot-data:NAME.")],
    out: Annotated[str, option("DIR", "Folder for robot.toml and for copies of the URDF and meshes.")],
    srdf: Annotated[str | None, option("FILE", "An SRDF with disabled pairs and named poses.")] = None,
    tool_frame: options.ToolFrame = None,
    gripper: options.GripperJoints = None,
    package_dir: options.PackageDirs = None,
    xacro_arg: options.XacroArgs = None,
    lock: options.Locks = None,
    joint: Annotated[list[str] | None, option("JOINT", "A joint that moves; all others are fixed. Repeatable.")] = None,
    visual_as_collision: options.VisualAsCollision = False,
    prove: Annotated[
        bool, option("--prove", "Look for proofs that pairs of links never touch: they need no checks then.")
    ] = False,
    workers: options.Workers = None,
    force: Annotated[bool, option("--force", "Overwrite existing files.")] = False,
    as_json: options.AsJson = False,
) -> None:
    """Write a robot.toml from a URDF: limits with their sources, and the self-collisions to allow, with reasons.

    Links may touch that are adjacent, that the SRDF disables, or that always overlap; all other pairs are checked. With
    --prove, pairs that can never touch are proven so over all joint values and need no checks.
    """
    from planner_service.cli.robots.import_report import import_record, import_table, to_check
    from planner_service.parallel.named import engine_named
    from planner_service.robot_setup.import_robot import Source, import_robot

    with bad_input_exits():
        folders = tuple(Path(folder) for folder in package_dir or ())
        srdf_file, joints = None if srdf is None else Path(srdf), tuple(joint) if joint else None
        locked, given = options.locks(lock or ()), options.xacro_args(xacro_arg or ())
        hand = options.gripper(gripper)
        file = Path(urdf) if Path(urdf).is_file() else robot_file(urdf)
        source = Source(file, srdf_file, tool_frame, folders, locked, joints, visual_as_collision, given, hand)
        engine = engine_named("processes", workers)
        imported = import_robot(source, out, force=force, prove=prove, engine=engine, progress=True)
    title = f"imported: {imported.robot.name}, written to {imported.path}, in {imported.seconds:.1f} s"
    agreement = imported.agreement
    reader = (
        f"second reader: yourdfpy sees all {agreement.frames} frames at the same places "
        f"(within {max(agreement.difference, 1e-12):.0e} m, in {agreement.configurations} configurations)"
    )
    checks = [f"check: {line}" for line in to_check(imported, source)]
    lines = wrapped([reader, *checks])
    show(import_record(imported), title, "", import_table(imported), "", *lines, as_json=as_json)


def _plot(file: str, service: PlannerService, request: PlanRequest, result: PlanResult) -> None:
    """Plot the clearance along the path, along the path before optimising if the optimum was kept, and torques."""
    from planner_service.certify import Certifier
    from planner_service.planning.request import Pace, torques_of
    from planner_service.view.still.motion_plot import write_plot

    paths = {} if result.path is None else {"the path": result.path}
    if result.path is not None and request.polish is not None and result.polish is not None and result.polish.kept:
        before = service.plan(replace(request, polish=None)).path
        paths = ({} if before is None else {"not optimised": before}) | {"optimised": result.path}
    limits = torques_of(Pace.of(request), service.robot, service.scene)
    torques = None if limits is None or result.trajectory is None else limits.samples(result.trajectory)
    write_plot(file, Certifier(service.robot, service.scene), paths, torques)


def _health_lines(health: Health, where: str) -> list[str]:
    kernels = (
        ("checks", health.checks, f"random states of {where}", " ({:,} collide)", "state"),
        ("searches", health.searches, "shortened paths between free ones", " ({:,} are given up)", "path"),
        ("proofs", health.proofs, "short edges between them", " ({:,} are refused)", "edge"),
        ("timing", health.timing, "paths through them, with toppra", "", "path"),
    )
    lines = []
    for name, opinions, questions, refused, unit in kernels:
        lines += [
            f"{name}: {opinions.instruction_set}; this processor has {', '.join(opinions.available)}",
            f"  compared on {opinions.asked:,} {questions}{refused.format(opinions.refused)}: "
            f"{opinions.differences:,} differences",
            f"  {opinions.us:.1f} us per {unit}, {opinions.reference_us:.1f} us by its judge",
        ]
    return lines


def _show_version(wanted: bool) -> None:
    if wanted:
        from planner_service.files.release import RELEASE

        typer.echo(f"planner-service {RELEASE}")
        raise typer.Exit


@app.callback()
def _global_options(
    context: typer.Context,
    verbose: Annotated[bool, option("--verbose", "-v", "Log each stage of planning to standard error.")] = False,
    version: Annotated[
        bool, option("--version", "Print the version and exit.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    if verbose:
        logger, handler = logging.getLogger("planner_service"), ErrorLog()
        context.call_on_close(partial(logger.removeHandler, handler))
        context.call_on_close(partial(logger.setLevel, logger.level))
        logger.addHandler(handler)
        logger.setLevel(logging.DEBUG)


def _add(group: typer.Typer, command: Callable[..., None], name: str, short_help: str, example: str) -> None:
    parameters = inspect.signature(command).parameters
    takes = "robot" if "robot" in parameters else "name" if command is robots else None
    whole = command if takes is None else options.taking_robot(command, takes)
    group.command(name, short_help=short_help, epilog=options.example(example))(whole)


_add(app, robots, "robots", "List the robots, or show one.", "robots wxai")
_add(app, scenes, "scenes", "List the scenes, or show one.", "scenes bin")
_add(app, problems, "problems", "List or plan a published problem set.", "problems problems.json --robot panda")
_add(app, check, "check", "Check one configuration for collisions.", "check --scene table --q ready")
_add(app, plan, "plan", "Plan a motion to a goal.", "plan --scene table --start home --goal ready --out plan.json")
_add(
    app,
    explain,
    "explain",
    "Say why there is no plan, and what helps.",
    "explain --scene bin --start home --goal ready",
)
_add(app, pick_place, "pick-place", "Plan a whole pick-and-place.", "pick-place --object blue_block --onto tray")
_add(app, solve, "solve", "Solve a task that is composed of steps.", "solve steps.json --scene bin --out task.json")
_add(app, order, "order", "Put visits in order.", "order visits.json --scene bin --out task.json")
_add(app, import_robot_, "import-robot", "Write a robot.toml from a URDF.", "import-robot arm.urdf --out my_arm")
_add(app, doctor, "doctor", "Compare compiled code with its judges.", "doctor")


def _others() -> typer.Typer:
    """The commands that need more than planning does, from files of plans to servers; importing them takes 0.2 s."""
    from planner_service.cli.certify import certify
    from planner_service.cli.episodes import episodes
    from planner_service.cli.export import export, join
    from planner_service.cli.gate.commands import gates
    from planner_service.cli.plan_cell import plan_cell
    from planner_service.cli.roadmap.commands import roadmaps
    from planner_service.cli.robots.check import robot_commands
    from planner_service.cli.run import run
    from planner_service.cli.serve import mcp, serve
    from planner_service.cli.view import view
    from planner_service.cli.workspace import maps

    others = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False)
    _add(others, view, "view", "Show robot, scene and plan in the browser.", "view plan.json")
    _add(others, certify, "certify", "Prove a saved plan again.", "certify plan.json")
    _add(others, plan_cell, "plan-cell", "Plan for several arms.", "plan-cell cell.toml --delay 0.1 --out cell.json")
    _add(others, export, "export", "Write a saved plan or task for other tools.", "export plan.json --format csv")
    _add(others, join, "join", "Write saved tasks as one.", "join pick.json place.json --out task.json")
    _add(others, run, "run", "Execute a plan on the simulated arm or a real one.", "run plan.json --sim")
    _add(others, episodes, "episodes", "Write a data set of planned motions.", "episodes --out motions --count 100")
    _add(others, serve, "serve", "Plan for other programs over HTTP.", "serve --scene bin --port 8080 --state state")
    _add(others, mcp, "mcp", "Offer planning as tools to an agent.", "mcp --scene bin --execute simulator")
    others.add_typer(roadmaps, name="roadmap")
    others.add_typer(maps, name="reachability")
    others.add_typer(gates, name="gate")
    others.add_typer(robot_commands, name="robot")
    return others
