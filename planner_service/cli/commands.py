"""The commands: read what was asked, plan or judge, print, and say by the exit code what came of it."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from planner_service.certify import Certifier
from planner_service.cli import OUR_BUG, listings
from planner_service.cli.arguments import (
    configuration,
    from_file,
    goals,
    load_libraries,
    optimise,
    planner_or_optimise,
    require_obstacles,
    require_places,
    require_proven,
    service_for,
    time_limit_of,
    timing_by_name,
    unit_of,
)
from planner_service.cli.certify import certify
from planner_service.cli.episodes import episodes
from planner_service.cli.exit_codes import NO_PLAN, bad_input_exits, finish, json_text, wrapped
from planner_service.cli.import_report import import_record, import_table, locks, to_check
from planner_service.cli.options import (
    DEFAULT,
    SECONDS,
    Allow,
    AsJson,
    Blend,
    Clearance,
    Goals,
    MaxChecks,
    Out,
    Padding,
    Picture,
    PlannerName,
    Plot,
    Polish,
    RobotName,
    SceneName,
    Seed,
    Start,
    TimeLimit,
    TimingName,
    ToolSpeed,
)
from planner_service.cli.plot import write_clearance_plot
from planner_service.cli.roadmaps import roadmaps
from planner_service.cli.run import run
from planner_service.cli.tables import (
    console,
    emit,
    health_words,
    plan_rows,
    plan_words,
    proof_words,
    render,
    table,
    task_rows,
)
from planner_service.cli.view import view
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.writing import require_writable, write_whole
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import PlanResult
from planner_service.records.plan_file import SavedPlan, SavedTask, load_plan_or_task, save_plan
from planner_service.records.trajectory_export import OURS, csv_text, joint_trajectory, task_csv_text, task_trajectories
from planner_service.robot.model import load_robot
from planner_service.robot_setup.import_robot import Source, import_robot
from planner_service.robot_setup.kernel_check import examine
from planner_service.scene.scene import scene_names
from planner_service.scene.worlds import load_world
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import plan_pick_place
from planner_service.view.still.pictures import draw_check, draw_plan, draw_task

__all__ = ["app"]

EXPORTS = ("joint-trajectory", "csv")

app = typer.Typer(
    help="Motion planning for a robot arm on a table, with every collision check counted.",
    epilog="Exit codes: 0 planned or free, 1 no plan or colliding, 2 bad input, 130 interrupted, 70 our own error.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.add_typer(roadmaps, name="roadmap")
app.command(short_help="Prove that a saved plan is free.")(certify)
app.command(short_help="Execute a plan, on the simulated arm or a real one.")(run)
app.command(short_help="Show robot, scene and plan in the browser.")(view)
app.command(short_help="Write a data set of planned motions.")(episodes)

Name = Annotated[str | None, typer.Argument(help="Show this one in detail; a name, or a path.")]


@app.command(short_help="Plan a motion to a goal, stage by stage.")
def plan(
    start: Start,
    goal: Goals,
    scene: SceneName,
    robot: RobotName = "wxai",
    planner: PlannerName = "rrtconnect",
    timing: TimingName = "toppra",
    seed: Seed = DEFAULT.seed,
    max_checks: MaxChecks = DEFAULT.max_checks,
    time_limit: TimeLimit = SECONDS,
    padding: Padding = DEFAULT.padding,
    blend: Blend = DEFAULT.blend,
    max_tool_speed: ToolSpeed = None,
    polish: Polish = False,
    clearance: Clearance = None,
    plot: Plot = None,
    png: Picture = None,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Plan a motion from one configuration to a goal, and print it stage by stage."""
    with bad_input_exits():
        require_places({"--out": out, "--plot": plot, "--png": png})
        service = service_for(robot, scene)
        request = PlanRequest(
            configuration("--start", start, service.robot),
            goals(goal, service.robot),
            planner_or_optimise(planner, clearance, polish=polish),
            timing_by_name(timing),
            seed=seed,
            max_checks=max_checks,
            time_limit=time_limit_of(time_limit),
            padding=padding,
            blend=blend,
            max_tool_speed=max_tool_speed,
            polish=optimise(clearance) if polish else None,
        )
        load_libraries(request, service.robot)
        result = service.plan(request)
        saved = SavedPlan.of(result)
        if out is not None:
            save_plan(saved, out)
        if png is not None:
            draw_plan(service, request, result, png)
        lines = plan_words(result)
        if plot is not None and result.path is not None:
            _plot(plot, service, request, result)
        elif plot is not None:
            lines.append(f"note: without a path {plot} is not drawn")
    words = f"{'planned' if result.ok else 'no plan'}: {robot} in {scene}, {start} -> {' or '.join(goal)}"
    text = "" if as_json else render(table(words, plan_rows(result), console().width, unit_of(service.robot)))
    finish(saved.document(), text, result.failure, lines, as_json=as_json)


@app.command("pick-place", short_help="Plan a whole pick-and-place.")
def pick_place(
    robot: RobotName = "wxai",
    scene: SceneName = "bin",
    target: Annotated[str, typer.Option("--object", help="The obstacle to take.")] = "blue_block",
    onto: Annotated[str, typer.Option(help="The obstacle on whose middle to place it.")] = "tray",
    planner: PlannerName = "rrtconnect",
    timing: TimingName = "toppra",
    seed: Seed = DEFAULT.seed,
    max_checks: MaxChecks = DEFAULT.max_checks,
    time_limit: TimeLimit = DEFAULT.time_limit or math.inf,
    padding: Padding = DEFAULT.padding,
    blend: Blend = DEFAULT.blend,
    max_tool_speed: ToolSpeed = None,
    png: Picture = None,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Plan a whole pick-and-place from home and back, and print every motion with its cost."""
    with bad_input_exits():
        require_places({"--out": out, "--png": png})
        service = service_for(robot, scene)
        require_obstacles(service.scene, {"--object": target, "--onto": onto})
        request = PlanRequest(
            service.robot.home,
            service.robot.home,
            planner_or_optimise(planner, None, polish=False),
            timing_by_name(timing),
            seed=seed,
            max_checks=max_checks,
            time_limit=time_limit_of(time_limit),
            padding=padding,
            blend=blend,
            max_tool_speed=max_tool_speed,
        )
        load_libraries(request, service.robot)
        task = SavedTask.of(plan_pick_place(service, target, onto, request))
        if out is not None:
            save_plan(task, out)
        if png is not None:
            draw_task(service, task, png)
    words = f"{'planned' if task.failure is None else 'no plan'}: {task.task}"
    text = "" if as_json else render(table(words, task_rows(task), console().width, unit_of(service.robot)))
    grips = [segment.gripper for segment in task.segments if segment.gripper is not None]
    proof = proof_words([segment.result for segment in task.segments], grips)
    notes = [*task.notes, *(f"{each.name}: {note}" for each in task.segments for note in each.result.notes)]
    lines = [*filter(None, [proof]), *(f"note: {note}" for note in notes)]
    finish(task.document(), text, task.failure, tuple(lines), as_json=as_json)


@app.command(short_help="Is a configuration free?")
def check(
    q: Annotated[str, typer.Option("--q", help="A named pose, or joint values separated by commas.")],
    scene: SceneName,
    robot: RobotName = "wxai",
    png: Picture = None,
    as_json: AsJson = False,
) -> None:
    """Tell whether a configuration is free, which pairs touch, and how much room is left at least."""
    with bad_input_exits():
        require_places({"--png": png})
        arm, world = load_robot(robot), load_world(scene)
        values = configuration("--q", q, arm)
        checker = CollisionChecker(arm, world)
        contacts, clearance = checker.contacts(values), checker.clearance(values)
        if png is not None:
            draw_check(checker, values, png)
    bound = clearance if math.isfinite(clearance) else None
    if as_json:
        touching = [{"a": c.a, "b": c.b, "depth_at_most": c.depth} for c in contacts]
        words = {"free": not contacts, "q": values.tolist(), "contacts": touching, "clearance_at_least": bound}
        emit(json_text({"robot": arm.name, "scene": world.name, **words}))
    else:
        lines = [f"{'colliding' if contacts else 'free'}: {robot} in {scene} at {q}"]
        lines += [f"  {contact}" for contact in contacts]
        if not contacts:
            room = "nothing is judged" if bound is None else f"clearance: at least {bound * 1000:.1f} mm"
            lines.append(f"  {room}")
        emit(render(*lines))
    raise typer.Exit(NO_PLAN if contacts else 0)


@app.command(short_help="Write a saved plan for others to read.")
def export(
    plan_file: Annotated[str, typer.Argument(metavar="FILE", help="A plan or a task written with --out.")],
    form: Annotated[
        str, typer.Option("--format", help="joint-trajectory (JSON in the shape of the ROS message) or csv.")
    ] = EXPORTS[0],
    dt: Annotated[float, typer.Option(help="Seconds between points; the exact end is always one.")] = 0.01,
    out: Annotated[str | None, typer.Option(metavar="FILE", help="Write to a file instead of printing.")] = None,
    allow: Allow = None,
) -> None:
    """Write the trajectory of a plan as points in time: positions, velocities and accelerations of all joints.

    Of a task, all motions on one clock that stands still while the gripper moves; each motion is told with its name and
    the gripper's width.
    """
    with bad_input_exits():
        if form not in EXPORTS:
            raise UnknownName("format", form, EXPORTS)
        if out is not None and os.path.realpath(out) == os.path.realpath(plan_file):
            raise InvalidRequest("--out", out, "another file than the plan itself")
        if out is not None:
            require_writable(out, OURS)
        saved = load_plan_or_task(plan_file)
        names = saved.robot.joint_names
        if (saved.result if isinstance(saved, SavedPlan) else saved).failure is not None:
            raise InvalidRequest("FILE", plan_file, "a plan, not a failure")
        require_proven(saved, allow)
        if isinstance(saved, SavedTask):
            parts = saved.segments
            text = task_csv_text(parts, names, dt) if form == "csv" else json_text(task_trajectories(parts, names, dt))
        else:
            motion = saved.result
            text = csv_text(motion, names, dt) if form == "csv" else json_text(joint_trajectory(motion, names, dt))
        if out is not None:
            write_whole(Path(out), text, OURS)
    typer.echo(f"note: {from_file(saved)}", err=True)
    if out is None:
        emit(text)


@app.command(short_help="List the robots, or show one.")
def robots(name: Name = None, as_json: AsJson = False) -> None:
    """List the robots that come with the package, or show one: its joint limits and named poses."""
    with bad_input_exits():
        found, missing = listings.shipped_robots() if name is None else ([load_robot(name)], {})
    if as_json:
        records = [listings.robot_record(robot) for robot in found]
        emit(json_text({"robots": records, "missing": missing} if name is None else records[0]))
    elif name is not None:
        (robot,) = found
        hand = "" if robot.gripper is None else f", gripper {robot.gripper.lower:g} to {robot.gripper.upper:g} m wide"
        head = f"{robot.name}: {robot.n} joints, {len(robot.shapes)} collision shapes, tool {robot.tool_frame}{hand}"
        units = "rad, m for a prismatic joint; s" if unit_of(robot) == "" else "rad, s"
        emit(render(head, f"limits in {units}", "", listings.joint_table(robot), "", listings.pose_table(robot)))
    else:
        rows = listings.columns(("robot", False), ("joints", True), ("shapes", True), ("poses", False))
        for robot in found:
            rows.add_row(robot.name, str(robot.n), str(len(robot.shapes)), ", ".join(robot.poses))
        for absent, why in missing.items():
            rows.add_row(absent, "", "", why)
        emit(render(rows))


@app.command(short_help="List the scenes, or show one.")
def scenes(name: Name = None, as_json: AsJson = False) -> None:
    """List the scenes that come with the package, or show one: its obstacles with sizes and poses, in metres."""
    with bad_input_exits():
        found = [load_world(entry) for entry in ([name] if name is not None else scene_names())]
    if as_json:
        records = [listings.scene_record(scene) for scene in found]
        emit(json_text({"scenes": records} if name is None else records[0]))
    elif name is not None:
        (scene,) = found
        emit(render(f"{scene.name or name}: {scene.description or 'a scene'}", "", listings.object_table(scene)))
    else:
        rows = listings.columns(("scene", False), ("obstacles", True), ("description", False))
        for scene in found:
            rows.add_row(scene.name, str(len(scene.obstacles)), scene.description)
        emit(render(rows))


@app.command(short_help="Is the compiled kernel in use, and is it right?")
def doctor(
    robot: RobotName = "wxai",
    scene: SceneName = "bin",
    states: Annotated[int, typer.Option(help="Random configurations on which both are compared.")] = 1000,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Say which instruction sets checks and proofs use, and compare both with their references, on random states."""
    with bad_input_exits():
        health = examine(load_robot(robot), load_world(scene), states=states, seed=seed)
    if as_json:
        emit(json_text({**asdict(health), "agrees": health.agrees}))
    else:
        emit(render(*health_words(health, f"{robot} in {scene}")))
    raise typer.Exit(0 if health.agrees else OUR_BUG)


@app.command("import-robot", short_help="Write a robot.toml from a URDF.")
def import_robot_(
    urdf: Annotated[str, typer.Argument(metavar="URDF", help="The robot's description.")],
    out: Annotated[
        str, typer.Option(metavar="DIR", help="The folder for robot.toml and copies of the URDF and meshes.")
    ],
    srdf: Annotated[str | None, typer.Option(help="A file with disabled pairs and named poses.")] = None,
    tool_frame: Annotated[str | None, typer.Option(help="The tool's link; else the last of the longest chain.")] = None,
    package_dir: Annotated[list[str] | None, typer.Option(help="A folder in which meshes may lie.")] = None,
    lock: Annotated[list[str] | None, typer.Option(metavar="JOINT=VALUE", help="A joint that stands still.")] = None,
    joint: Annotated[list[str] | None, typer.Option(help="A joint that moves; the others stand still.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there.")] = False,
    as_json: AsJson = False,
) -> None:
    """Write a robot.toml from a URDF: limits with their sources, and the contacts to allow, worked out and explained.

    Pairs of links that can never touch are proven so over the whole joint box; pairs that sometimes do stay judged.
    """
    with bad_input_exits():
        folders = tuple(Path(folder) for folder in package_dir or ())
        given, joints = None if srdf is None else Path(srdf), tuple(joint) if joint else None
        source = Source(Path(urdf), given, tool_frame, folders, locks(lock or ()), joints)
        found = import_robot(source, out, force=force)
    if as_json:
        emit(json_text(import_record(found)))
    else:
        words = f"imported: {found.robot.name}, written to {found.path}, in {found.seconds:.1f} s"
        checks = [f"check: {line}" for line in to_check(found, source)]
        emit(render(words, "", import_table(found), "", *wrapped(checks)))


def _plot(file: str, service: PlannerService, request: PlanRequest, result: PlanResult) -> None:
    """Draw the clearance along a path; and along the one that there is without optimising, if the optimum was kept."""
    paths = {} if result.path is None else {"the path": result.path}
    if result.path is not None and request.polish is not None and result.polish is not None and result.polish.kept:
        before = service.plan(replace(request, polish=None)).path
        paths = ({} if before is None else {"not optimised": before}) | {"optimised": result.path}
    write_clearance_plot(file, Certifier(service.robot, service.scene), paths)
