"""The commands of ``planner-service roadmap``: build a roadmap, query it, show it, update it to a changed scene."""

from __future__ import annotations

import math
import os
import time
from dataclasses import asdict, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import typer

from planner_service.cli import arguments, options
from planner_service.cli.exit_codes import bad_input_exits, finish
from planner_service.cli.options import argument, option
from planner_service.cli.output import labelled, show, wrapped
from planner_service.cli.roadmap import text
from planner_service.collision import CheckCounts
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.writing import require_writable
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import plan_lines, plan_rows
from planner_service.planning.roadmap_work import GROWERS, Grower, require_robot
from planner_service.presentation.tables import CostTable
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedPlan
from planner_service.roadmap import Roadmap, Terms
from planner_service.roadmap.roadmap_file import OURS, SUFFIX
from planner_service.robot.model import length_unit
from planner_service.service import PlannerService

__all__ = ["roadmaps"]

_GROWERS = MappingProxyType({grower.name: grower for grower in GROWERS})


roadmaps = typer.Typer(
    help="Build a roadmap once, save it, query it many times, and update it when the scene changes.",
    short_help="Build, query and update saved roadmaps.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

File = Annotated[str, argument("FILE", "A roadmap saved by build, query or update.")]


@roadmaps.command(
    short_help="Build a roadmap and save it.", epilog=options.example("roadmap build --scene bin --out bin.npz")
)
@options.taking_robot
def build(
    out: Annotated[str, option("FILE", "The roadmap's file, an .npz file.")],
    scene: options.SceneName,
    robot: options.RobotName = options.WXAI,
    planner: Annotated[str, option("NAME", f"One of {', '.join(_GROWERS)}.")] = "prm",
    milestones: Annotated[int | None, option("N", "Configurations to sample.  [default: 1000]")] = None,
    neighbours: Annotated[int | None, option("N", "Nearest milestones to connect each to.  [default: 10]")] = None,
    max_checks: Annotated[int | None, option("N", "States that may be checked.  [default: 2000000]")] = None,
    seed: options.Seed = 0,
    padding: options.Padding = options.DEFAULT.padding,
    as_json: options.AsJson = False,
) -> None:
    """Build a roadmap of the free space, save it, and print its size and cost."""
    with bad_input_exits():
        _require_roadmap_path("--out", out)
        grower = _grower(planner, {"milestones": milestones, "neighbours": neighbours, "max_checks": max_checks})
        service = arguments.service_for(robot, scene)
        began = time.perf_counter()
        roadmap = service.build_roadmap(grower, seed=seed, padding=padding, progress=True)
        seconds = time.perf_counter() - began
        roadmap.save(out)
    size = os.path.getsize(out)
    counts = CheckCounts() if roadmap.built is None else roadmap.built.counts
    rows = [
        ("built by", text.built_by_text(roadmap)),
        ("milestones", text.milestones_text(roadmap)),
        ("edges", text.edges_text(roadmap)),
        ("cost", f"{counts}, {seconds:.1f} s"),
        ("size", text.size_text(roadmap, size)),
    ]
    rows += [("note", _cut_short(roadmap))] if _cut_short(roadmap) else []
    document = {"file": out, "seconds": seconds, **text.roadmap_record(roadmap, size)}
    show(document, *wrapped([f"built: {robot} in {scene}, written to {out}"]), *labelled(rows), as_json=as_json)


@roadmaps.command(
    short_help="Plan a motion over a saved roadmap.",
    epilog=options.example("roadmap query bin.npz --start home --goal ready --learn"),
)
@options.taking_robot
def query(
    roadmap_file: File,
    start: options.Start,
    goal: options.Goals,
    scene: options.OtherScene = None,
    robot: options.OtherRobot = None,
    learn: Annotated[bool, option("--learn", "Save what was learned, in FILE or --out.")] = False,
    remember: Annotated[bool, option("--remember", "Add the path found to the roadmap.")] = False,
    out: Annotated[str | None, option("NPZ", "Save what was learned in this file.")] = None,
    no_fallback: Annotated[bool, option("--no-fallback", "Fail if the roadmap has no path.")] = False,
    timing: options.TimingName = "toppra",
    seed: options.Seed = options.DEFAULT.seed,
    max_checks: options.MaxChecks = options.DEFAULT.max_checks,
    time_limit: options.TimeLimit = options.SECONDS,
    padding: Annotated[
        float | None, option("METRES", "Distance to keep from everything; default: the roadmap's.")
    ] = None,
    blend: options.Blend = options.DEFAULT.blend,
    max_tool_speed: options.ToolSpeed = None,
    polish: options.Polish = False,
    clearance: options.Clearance = None,
    plan_out: Annotated[str | None, option("--plan", "JSON", "Save the plan in this file.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Plan a motion over a roadmap and print what each stage did and cost.

    If the scene is not the one the roadmap was built for, edges that the change may affect are checked again where a
    path needs them. Nothing is saved without --learn or --out.
    """
    with bad_input_exits():
        target = _learned_path(roadmap_file, out, learn=learn, remember=remember)
        if clearance is not None and not polish:
            raise InvalidRequest("--clearance", clearance, "--polish too")
        _require_plan_path(plan_out, (roadmap_file, target))
        kept = Roadmap.load(roadmap_file)
        own = _own_padding(kept) if padding is None else padding
        service, notes = _service(kept, robot, scene, own)
        planner = replace(kept, fallback=kept.fallback and not no_fallback, remember=kept.remember or remember)
        request = PlanRequest(
            arguments.configuration("--start", start, service.robot),
            arguments.goals(goal, service.robot),
            planner,
            arguments.timing_by_name(timing),
            seed=seed,
            max_checks=max_checks,
            time_limit=arguments.time_limit_of(time_limit),
            padding=own,
            blend=blend,
            max_tool_speed=max_tool_speed,
            polish=arguments.optimise(clearance) if polish else None,
        )
        arguments.load_libraries(request, service.robot)
        result = service.plan(request)
        saved = SavedPlan.of(result)
        if plan_out is not None:
            save_plan(saved, plan_out)
        learned = replace(result.roadmap or planner, fallback=kept.fallback, remember=kept.remember)
        written = None if learned.hash == kept.hash and _same_file(target, roadmap_file) else target
        if written is not None:
            learned.save(written)
    title = f"{'planned' if result.ok else 'no plan'}: {service.robot.name} in {service.scene.name}, "
    title += f"{start} -> {' or '.join(goal)}, over {os.path.basename(roadmap_file)}"
    table = CostTable(title, plan_rows(result), length_unit(service.robot))
    lines = [*plan_lines(result), *(f"note: {note}" for note in notes), _learned_line(kept, learned, written)]
    answer = {
        "file": roadmap_file,
        "hash": kept.hash,
        "learned_hash": learned.hash,
        "differs": notes,
        "learned": asdict(text.Learned.of(kept, learned)),
        "written": written,
    }
    finish({**saved.document(), "roadmap": answer}, table, lines, result.failure, as_json=as_json)


@roadmaps.command(short_help="Show what is in a saved roadmap.", epilog=options.example("roadmap info bin.npz"))
def info(roadmap_file: File, as_json: options.AsJson = False) -> None:
    """Show which robot and scene a roadmap was built for, how it was built, and what is known of its edges."""
    with bad_input_exits():
        roadmap = Roadmap.load(roadmap_file)
    size = os.path.getsize(roadmap_file)
    document = {"file": roadmap_file, **text.roadmap_record(roadmap, size)}
    show(document, f"roadmap: {roadmap_file}", *labelled(text.roadmap_facts(roadmap, size)), as_json=as_json)


@roadmaps.command(
    short_help="Update a saved roadmap to a changed scene.",
    epilog=options.example("roadmap update bin.npz --scene moved.toml"),
)
@options.taking_robot
def update(
    roadmap_file: File,
    scene: options.OtherScene = None,
    robot: options.OtherRobot = None,
    out: Annotated[str | None, option("NPZ", "Save it in this file; default: FILE.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Check again everything in a roadmap that a change of the scene may affect, and save it.

    An edge that was free, and is proven to pass clear of what was added or moved, is kept without a check.
    """
    with bad_input_exits():
        target = roadmap_file if out is None else out
        _require_roadmap_path("--out", target)
        before = Roadmap.load(roadmap_file)
        service, notes = _service(before, robot, scene, _own_padding(before))
        began = time.perf_counter()
        updated = service.update_roadmap(before)
        seconds = time.perf_counter() - began
        written = updated.roadmap.hash != before.hash or not _same_file(target, roadmap_file)
        if written:
            updated.roadmap.save(target)
    facts = {"differs": notes, "update": text.update_record(updated), "seconds": seconds, "written": written}
    document = {"file": target, **facts, **text.roadmap_record(updated.roadmap, os.path.getsize(target))}
    title = f"updated: {service.robot.name} in {service.scene.name}, "
    title += f"written to {target}" if written else "nothing to update, the file is unchanged"
    rows = [
        ("update", str(updated)),
        ("cost", f"{updated.counts}, {seconds:.1f} s"),
        ("milestones", text.milestones_text(updated.roadmap)),
        ("edges", text.edges_text(updated.roadmap)),
    ]
    lines = [*wrapped([title]), *labelled(rows), *wrapped([f"note: {note}" for note in notes])]
    show(document, *lines, as_json=as_json)


def _cut_short(roadmap: Roadmap) -> str:
    """A note if the build reached its limit of checks; empty if not."""
    built = roadmap.built
    if built is None or built.counts.states < built.settings.get("max_checks", math.inf):
        return ""
    wanted = built.settings["milestones"]
    return f"the build ended at --max-checks with {len(roadmap.milestones):,} of {wanted:,} milestones"


def _grower(name: str, given: dict[str, int | None]) -> Grower:
    """The roadmap planner of that name with the given settings."""
    kind = _GROWERS.get(name.lower())
    if kind is None:
        raise UnknownName("roadmap planner", name, _GROWERS)
    settings = {field: value for field, value in given.items() if value is not None}
    known = {item.name for item in fields(kind)}
    for field, value in settings.items():
        if field not in known:
            raise InvalidRequest(f"--{field.replace('_', '-')}", value, f"no such option with {kind.name}")
    return kind(**settings)


def _require_roadmap_path(option: str, path: str) -> None:
    """Refuse a file that cannot be written before the work whose result would be lost."""
    if Path(path).suffix.lower() != SUFFIX:
        raise InvalidRequest(option, path, f"a file whose name ends in {SUFFIX}")
    require_writable(path, OURS)


def _learned_path(source: str, out: str | None, *, learn: bool, remember: bool) -> str | None:
    """The file to save what is learned in; None for none."""
    if out is None and not learn:
        if remember:
            raise InvalidRequest("--remember", True, "--learn or --out too: without them nothing is saved")
        return None
    target = source if out is None else out
    _require_roadmap_path("--out", target)
    return target


def _require_plan_path(path: str | None, taken: tuple[str | None, ...]) -> None:
    if path is None:
        return
    if any(_same_file(other, path) for other in taken):
        raise InvalidRequest("--plan", path, "a different file from the roadmap")
    arguments.require_outputs({"--plan": path})


def _same_file(one: str | None, other: str) -> bool:
    return one is not None and os.path.realpath(one) == os.path.realpath(other)


def _service(
    roadmap: Roadmap, robot: options.RobotChoice | None, scene: str | None, padding: float
) -> tuple[PlannerService, list[str]]:
    """The service a roadmap was built for, or one for the robot or scene given instead, and notes on differences."""
    terms = roadmap.terms
    if terms is None:
        return _service_for_any(roadmap, robot, scene), []
    service, notes = arguments.service_of_terms(terms, robot, scene)
    require_robot(roadmap, service.robot)
    differs = text.difference(terms, Terms.of(service.checker.variant(padding=padding)))
    return service, ["; ".join([*notes, differs])] if differs else notes


def _service_for_any(roadmap: Roadmap, robot: options.RobotChoice | None, scene: str | None) -> PlannerService:
    """The service for a roadmap that does not say what it was built for."""
    if robot is None or scene is None:
        option = "--robot" if robot is None else "--scene"
        raise InvalidRequest(option, None, "a name: the file does not say what the roadmap was built for")
    service = arguments.service_for(robot, scene)
    require_robot(roadmap, service.robot)
    return service


def _own_padding(roadmap: Roadmap) -> float:
    return options.DEFAULT.padding if roadmap.terms is None else roadmap.terms.padding


def _learned_line(kept: Roadmap, learned: Roadmap, written: str | None) -> str:
    """What a query learned, and the file that it was saved in, if any."""
    news, unsaved = "nothing new", ""
    if learned.hash != kept.hash:
        news, unsaved = str(text.Learned.of(kept, learned)), "; not saved, as --learn was not given"
    return f"learned: {news}{unsaved if written is None else f'; written to {written}'}"
