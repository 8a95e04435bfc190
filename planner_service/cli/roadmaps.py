"""The commands of ``planner-service roadmap``: build one, ask it, show it, tell it of a changed scene."""

from __future__ import annotations

import math
import os
import time
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import typer

from planner_service.cli.arguments import (
    configuration,
    goals,
    load_libraries,
    optimise,
    require_places,
    service_of_terms,
    time_limit_of,
    timing_by_name,
    unit_of,
)
from planner_service.cli.exit_codes import bad_input_exits, finish, json_text, wrapped
from planner_service.cli.options import (
    DEFAULT,
    SECONDS,
    AsJson,
    Blend,
    Clearance,
    Goals,
    MaxChecks,
    Padding,
    Polish,
    RobotName,
    SceneName,
    Seed,
    Start,
    TimeLimit,
    TimingName,
    ToolSpeed,
)
from planner_service.cli.roadmap_text import (
    Learned,
    cost_words,
    difference,
    edge_words,
    facts,
    grower_words,
    milestone_words,
    roadmap_facts,
    roadmap_record,
    size_words,
    update_record,
)
from planner_service.cli.tables import console, emit, plan_rows, plan_words, render, table
from planner_service.collision import CheckCounts
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.writing import require_writable
from planner_service.planning.request import PlanRequest
from planner_service.planning.roadmap_work import GROWERS, Grower, require_robot
from planner_service.records.plan_file import SavedPlan, save_plan
from planner_service.roadmap import Roadmap, Terms
from planner_service.roadmap.roadmap_file import OURS, SUFFIX
from planner_service.robot.model import load_robot
from planner_service.scene.worlds import load_world
from planner_service.service import PlannerService

__all__ = ["roadmaps"]

MADE = "the roadmap was judged for"
_GROWERS = MappingProxyType({grower.name: grower for grower in GROWERS})

roadmaps = typer.Typer(
    help="Roadmaps: built once, saved, asked many times, and told of what changes in the scene.",
    short_help="Build, ask and update saved roadmaps.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

File = Annotated[str, typer.Argument(metavar="FILE", help="A roadmap written by build, query or update.")]
OtherRobot = Annotated[str | None, typer.Option("--robot", help="Another robot than the file names.")]
OtherScene = Annotated[str | None, typer.Option("--scene", help="Another scene than the file names.")]


@roadmaps.command(short_help="Grow a roadmap and save it.")
def build(
    out: Annotated[str, typer.Option(metavar="FILE", help="Where to write the roadmap, an .npz file.")],
    scene: SceneName,
    robot: RobotName = "wxai",
    planner: Annotated[str, typer.Option(help=f"One of {', '.join(_GROWERS)}.")] = "prm",
    milestones: Annotated[int | None, typer.Option(help="Configurations to sample; if not given, 1000.")] = None,
    neighbours: Annotated[int | None, typer.Option(help="Nearest milestones each is joined to; else 10.")] = None,
    max_checks: Annotated[int | None, typer.Option(help="States after which growing ends; else 2,000,000.")] = None,
    seed: Seed = 0,
    padding: Padding = DEFAULT.padding,
    as_json: AsJson = False,
) -> None:
    """Grow a roadmap of the free space, save it, and print what is in it and what that cost."""
    with bad_input_exits():
        _require_place("--out", out)
        grower = _grower(planner, {"milestones": milestones, "neighbours": neighbours, "max_checks": max_checks})
        service = PlannerService(load_robot(robot), load_world(scene))
        began = time.perf_counter()
        roadmap = service.build_roadmap(grower, seed=seed, padding=padding)
        seconds = time.perf_counter() - began
        roadmap.save(out)
    size = os.path.getsize(out)
    if as_json:
        emit(json_text({"file": out, "seconds": seconds, **roadmap_record(roadmap, size)}))
        return
    counts = CheckCounts() if roadmap.built is None else roadmap.built.counts
    rows = [
        ("grown by", grower_words(roadmap)),
        ("milestones", milestone_words(roadmap)),
        ("edges", edge_words(roadmap)),
        ("cost", f"{cost_words(counts)}, {seconds:.1f} s"),
        ("size", size_words(roadmap, size)),
    ]
    rows += [("note", _cut_short(roadmap))] if _cut_short(roadmap) else []
    emit(render(*wrapped([f"built: {robot} in {scene}, written to {out}"]), *facts(rows)))


@roadmaps.command(short_help="Plan a motion over a saved roadmap.")
def query(
    roadmap_file: File,
    start: Start,
    goal: Goals,
    scene: OtherScene = None,
    robot: OtherRobot = None,
    learn: Annotated[bool, typer.Option("--learn", help="Write what was learned back to FILE, or to --out.")] = False,
    remember: Annotated[bool, typer.Option("--remember", help="Add the path found to what is learned.")] = False,
    out: Annotated[str | None, typer.Option(metavar="NPZ", help="Write what was learned there instead.")] = None,
    no_fallback: Annotated[bool, typer.Option("--no-fallback", help="Ask no other planner if it has no path.")] = False,
    timing: TimingName = "toppra",
    seed: Seed = DEFAULT.seed,
    max_checks: MaxChecks = DEFAULT.max_checks,
    time_limit: TimeLimit = SECONDS,
    padding: Annotated[float | None, typer.Option(help="Metres to keep; if not given, the roadmap's own.")] = None,
    blend: Blend = DEFAULT.blend,
    max_tool_speed: ToolSpeed = None,
    polish: Polish = False,
    clearance: Clearance = None,
    plan_out: Annotated[str | None, typer.Option("--plan", metavar="JSON", help="Write the plan to a file.")] = None,
    as_json: AsJson = False,
) -> None:
    """Plan a motion over a roadmap, and print it stage by stage.

    If the scene is not the one the roadmap was judged for, edges that the change may have touched are judged again
    where a path needs them. Nothing is written unless it is asked for with --learn or --out.
    """
    with bad_input_exits():
        target = _learning(roadmap_file, out, learn=learn, remember=remember)
        if clearance is not None and not polish:
            raise InvalidRequest("--clearance", clearance, "--polish with it")
        _require_plan_place(plan_out, (roadmap_file, target))
        kept = Roadmap.load(roadmap_file)
        own = _own_padding(kept) if padding is None else padding
        service, notes = _service(kept, robot, scene, own)
        asked = replace(kept, fallback=kept.fallback and not no_fallback, remember=kept.remember or remember)
        request = PlanRequest(
            configuration("--start", start, service.robot),
            goals(goal, service.robot),
            asked,
            timing_by_name(timing),
            seed=seed,
            max_checks=max_checks,
            time_limit=time_limit_of(time_limit),
            padding=own,
            blend=blend,
            max_tool_speed=max_tool_speed,
            polish=optimise(clearance) if polish else None,
        )
        load_libraries(request, service.robot)
        result = service.plan(request)
        saved = SavedPlan.of(result)
        if plan_out is not None:
            save_plan(saved, plan_out)
        learned = replace(result.roadmap or asked, fallback=kept.fallback, remember=kept.remember)
        written = None if learned.hash == kept.hash and _same_file(target, roadmap_file) else target
        if written is not None:
            learned.save(written)
    words = f"{'planned' if result.ok else 'no plan'}: {service.robot.name} in {service.scene.name}, "
    words += f"{start} -> {' or '.join(goal)}, over {os.path.basename(roadmap_file)}"
    text = "" if as_json else render(table(words, plan_rows(result), console().width, unit_of(service.robot)))
    answer = _Answer(roadmap_file, kept, learned, tuple(notes), written)
    lines = [*plan_words(result), *answer.lines]
    finish({**saved.document(), "roadmap": answer.record}, text, result.failure, lines, as_json=as_json)


@roadmaps.command(short_help="Show what is in a saved roadmap.")
def info(roadmap_file: File, as_json: AsJson = False) -> None:
    """Show for which robot and scene a roadmap was judged, how it was grown, and what is known of its edges."""
    with bad_input_exits():
        roadmap = Roadmap.load(roadmap_file)
    size = os.path.getsize(roadmap_file)
    if as_json:
        emit(json_text({"file": roadmap_file, **roadmap_record(roadmap, size)}))
    else:
        emit(render(f"roadmap: {roadmap_file}", *facts(roadmap_facts(roadmap, size))))


@roadmaps.command(short_help="Tell a saved roadmap of a changed scene.")
def update(
    roadmap_file: File,
    scene: OtherScene = None,
    robot: OtherRobot = None,
    out: Annotated[str | None, typer.Option(metavar="NPZ", help="Write it there; if not given, to FILE.")] = None,
    as_json: AsJson = False,
) -> None:
    """Judge again all of a roadmap that a change may have touched, and write it back.

    An edge that was free, and that is proven to pass clear of what came or moved, is kept without a check.
    """
    with bad_input_exits():
        target = roadmap_file if out is None else out
        _require_place("--out", target)
        before = Roadmap.load(roadmap_file)
        service, notes = _service(before, robot, scene, _own_padding(before))
        began = time.perf_counter()
        found = service.update_roadmap(before)
        seconds = time.perf_counter() - began
        written = found.roadmap.hash != before.hash or not _same_file(target, roadmap_file)
        if written:
            found.roadmap.save(target)
    if as_json:
        size = os.path.getsize(target)
        told = {"differs": notes, "update": update_record(found), "seconds": seconds, "written": written}
        emit(json_text({"file": target, **told, **roadmap_record(found.roadmap, size)}))
        return
    head = f"updated: {service.robot.name} in {service.scene.name}, "
    head += f"written to {target}" if written else "nothing was in doubt, the file is left as it is"
    rows = [
        ("update", str(found)),
        ("cost", f"{cost_words(found.counts)}, {seconds:.1f} s"),
        ("milestones", milestone_words(found.roadmap)),
        ("edges", edge_words(found.roadmap)),
    ]
    emit(render(*wrapped([head]), *facts(rows), *wrapped([f"note: {note}" for note in notes])))


def _cut_short(roadmap: Roadmap) -> str:
    """What is to be said of a roadmap whose growing ended at its limit; empty if it did not."""
    built = roadmap.built
    if built is None or built.counts.states < built.settings.get("max_checks", math.inf):
        return ""
    asked = built.settings["milestones"]
    return f"growing ended at --max-checks, with {len(roadmap.milestones):,} of {asked:,} milestones"


def _grower(name: str, given: dict[str, int | None]) -> Grower:
    """The planner of that name with the settings that were given."""
    kind = _GROWERS.get(name.lower())
    if kind is None:
        raise UnknownName("planner of roadmaps", name, _GROWERS)
    settings = {field: value for field, value in given.items() if value is not None}
    known = {item.name for item in fields(kind)}
    for field, value in settings.items():
        if field not in known:
            raise InvalidRequest(f"--{field.replace('_', '-')}", value, f"no such option: {kind.name} has no {field}")
    grower: Any = kind(**settings)
    return grower  # type: ignore[no-any-return]


def _require_place(option: str, path: str) -> None:
    """Refuse what cannot be written before the work whose result would be lost."""
    if Path(path).suffix.lower() != SUFFIX:
        raise InvalidRequest(option, path, f"a file whose name ends in {SUFFIX}")
    require_writable(path, OURS)


def _learning(source: str, out: str | None, *, learn: bool, remember: bool) -> str | None:
    """Where what is learned is to be written; None if nowhere."""
    if out is None and not learn:
        if remember:
            raise InvalidRequest("--remember", True, "--learn or --out with it: else nothing is written")
        return None
    target = source if out is None else out
    _require_place("--out", target)
    return target


def _require_plan_place(path: str | None, taken: tuple[str | None, ...]) -> None:
    if path is None:
        return
    if any(_same_file(other, path) for other in taken):
        raise InvalidRequest("--plan", path, "another file than the roadmap itself")
    require_places({"--plan": path})


def _same_file(one: str | None, other: str) -> bool:
    return one is not None and os.path.realpath(one) == os.path.realpath(other)


def _service(
    roadmap: Roadmap, robot: str | None, scene: str | None, padding: float
) -> tuple[PlannerService, list[str]]:
    """The service for what a roadmap was judged for, or for what was given instead, and what is to be said of that."""
    terms = roadmap.terms
    if terms is None:
        return _service_for_any(roadmap, robot, scene), []
    service, notes = service_of_terms(terms, robot, scene, MADE)
    require_robot(roadmap, service.robot)
    differs = difference(terms, Terms.of(service.checker.variant(padding=padding)))
    return service, ["; ".join([*notes, differs])] if differs else notes


def _service_for_any(roadmap: Roadmap, robot: str | None, scene: str | None) -> PlannerService:
    """The service that was given for a roadmap which does not say for what it was judged."""
    if robot is None or scene is None:
        option = "--robot" if robot is None else "--scene"
        raise InvalidRequest(option, None, "a name: the file does not say for what the roadmap was judged")
    service = PlannerService(load_robot(robot), load_world(scene))
    require_robot(roadmap, service.robot)
    return service


def _own_padding(roadmap: Roadmap) -> float:
    return DEFAULT.padding if roadmap.terms is None else roadmap.terms.padding


@dataclass(frozen=True)
class _Answer:
    """What a query of a roadmap says of the roadmap.

    Attributes:
        file: From which it was read.
        kept: The roadmap there.
        learned: The same with what was learned.
        notes: What is not as it was when it was judged.
        written: The file to which what was learned went; None if to none.
    """

    file: str
    kept: Roadmap
    learned: Roadmap
    notes: tuple[str, ...]
    written: str | None

    @property
    def record(self) -> dict[str, Any]:
        """For machines."""
        found = asdict(Learned.of(self.kept, self.learned))
        hashes = {"hash": self.kept.hash, "learned_hash": self.learned.hash}
        return {"file": self.file, **hashes, "differs": list(self.notes), "learned": found, "written": self.written}

    @property
    def lines(self) -> list[str]:
        """For people."""
        if self.learned.hash == self.kept.hash:
            told, unwritten = "nothing that the roadmap did not know", ""
        else:
            told, unwritten = str(Learned.of(self.kept, self.learned)), "; not written, for want of --learn"
        where = unwritten if self.written is None else f"; written to {self.written}"
        return [*(f"note: {note}" for note in self.notes), f"learned: {told}{where}"]
