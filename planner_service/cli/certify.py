"""The command ``certify``: the proof of a saved plan or task, made anew."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import typer

from planner_service.certify import Certificate
from planner_service.cli.arguments import pairs_of_texts, reopened
from planner_service.cli.exit_codes import NO_PLAN, bad_input_exits, json_text
from planner_service.cli.options import Allow, AsJson
from planner_service.cli.tables import emit, render
from planner_service.planning.accounting import in_words
from planner_service.records.plan_file import load_plan_or_task
from planner_service.records.recertify import Recertified, recertify
from planner_service.records.result import certificate_record

__all__ = ["certify"]


def certify(
    plan_file: Annotated[str, typer.Argument(metavar="FILE", help="A plan or a task written with --out.")],
    scene: Annotated[str | None, typer.Option(help="Another scene than the one in FILE.")] = None,
    robot: Annotated[str | None, typer.Option(help="Another robot than the one in FILE.")] = None,
    padding: Annotated[float, typer.Option(help="Metres that every pair is to keep.")] = 0.0,
    allow: Allow = None,
    as_json: AsJson = False,
) -> None:
    """Prove again that a plan or task is collision-free, between samples too, and keeps its limits.

    Every motion of a task is proven with what it carries, and so is the gripper's opening and closing. Pairs that were
    not judged are listed: only those that picking and placing need, and those named with --allow.
    """
    with bad_input_exits():
        saved, notes = reopened(load_plan_or_task(plan_file), robot, scene)
        found = recertify(saved, allowed=pairs_of_texts("--allow", allow or ()), padding=padding)
    if as_json:
        emit(json_text(_document(found, notes)))
    else:
        what = f"{plan_file} with {found.world.robot.name} in {found.world.scene.name}"
        lines = [f"{'certified' if found.certified else 'refused'}: {what}"]
        for motion in found.motions:
            if (grip := motion.gripper) is not None:
                words = f"refused: {grip.refused}" if grip.refused else _words(grip.certificate)
                lines.append(f"  {grip.name} before {motion.name}: {words}")
            lines.append(f"  {motion.name}: {_words(motion.certificate)}")
        said = {f"{motion.name}: {motion.certificate.refusal}" for motion in found.motions}
        said |= {f"{motion.name}: {motion.gripper.refused}" for motion in found.motions if motion.gripper is not None}
        lines += [f"  refused: {objection}" for objection in found.objections if objection not in said]
        notes += found.lenience
        notes += [
            f"{motion.name}: only s = {motion.certificate.part[0]:.4g} to {motion.certificate.part[1]:.4g} of the path "
            "is left to go"
            for motion in found.motions
            if motion.certificate.part is not None
        ]
        emit(render(*lines, *(f"note: {note}" for note in notes)))
    raise typer.Exit(0 if found.certified else NO_PLAN)


def _document(found: Recertified, notes: Sequence[str]) -> dict[str, Any]:
    return {
        "robot": found.world.robot.name,
        "scene": found.world.scene.name,
        "notes": list(notes),
        "certified": found.certified,
        "objections": list(found.objections),
        "allowed": [list(pair) for pair in found.allowed],
        "motions": [{"name": motion.name, **certificate_record(motion.certificate)} for motion in found.motions],
    }


def _words(found: Certificate) -> str:
    if found.refusal is not None:
        return f"refused: {found.refusal}"
    part = "" if found.part is None else f" (from s = {found.part[0]:.6g} to {found.part[1]:.6g} of its path)"
    return f"certified: {in_words(found.clearance)}{part}"
