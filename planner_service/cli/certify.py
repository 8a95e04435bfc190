"""The command ``certify``: the proof of a saved plan or task, made anew."""

from __future__ import annotations

from typing import Annotated

import typer

from planner_service.certify import Certificate
from planner_service.cli.arguments import reopened
from planner_service.cli.exits import NO_PLAN, bad_input_exits, json_text
from planner_service.cli.options import AsJson
from planner_service.cli.tables import emit, render
from planner_service.errors import InvalidRequest
from planner_service.plan_file import SavedPlan, load_plan_or_task
from planner_service.proving import proofs
from planner_service.result_record import certificate_record
from planner_service.stagebook import in_words

__all__ = ["certify"]


def certify(
    plan_file: Annotated[str, typer.Argument(metavar="FILE", help="A plan or a task written with --out.")],
    scene: Annotated[str | None, typer.Option(help="Another scene than the one in FILE.")] = None,
    robot: Annotated[str | None, typer.Option(help="Another robot than the one in FILE.")] = None,
    padding: Annotated[float, typer.Option(help="Metres that every pair is to keep.")] = 0.0,
    as_json: AsJson = False,
) -> None:
    """Prove that the whole path of a plan is free, between samples too, or tell where and of what it is not proven.

    Of a task each motion is, with what is then carried. Stretches on which the plan says that pairs were not judged are
    left out here, too, and what a robot had passed when its motion was replanned.
    """
    with bad_input_exits():
        saved, notes = reopened(load_plan_or_task(plan_file), robot, scene)
        service = saved.service()
        found = proofs(saved, service, padding=padding)
        if not found or (saved.result if isinstance(saved, SavedPlan) else saved).failure is not None:
            raise InvalidRequest("FILE", plan_file, "a plan, not a failure")
    certified = all(certificate.certified for _, certificate in found)
    if as_json:
        head = {"robot": service.robot.name, "scene": service.scene.name}
        if isinstance(saved, SavedPlan):
            emit(json_text({**head, **certificate_record(found[0][1])}))
        else:
            motions = [{"name": name, **certificate_record(certificate)} for name, certificate in found]
            emit(json_text({**head, "certified": certified, "motions": motions}))
    else:
        what = f"{plan_file} with {service.robot.name} in {service.scene.name}"
        if isinstance(saved, SavedPlan):
            lines = [f"{_verdict(found[0][1])}: {what}: {_words(found[0][1])}"]
        else:
            lines = [f"{'certified' if certified else 'refused'}: {what}"]
            lines += [f"  {name}: {_verdict(certificate)}: {_words(certificate)}" for name, certificate in found]
        for name, certificate in found:
            of = "" if isinstance(saved, SavedPlan) else f"{name}: "
            if certificate.part is not None:
                begin, end = certificate.part
                notes.append(f"{of}only s = {begin:.4g} to {end:.4g} of the path is left to go")
            notes += [f"{of}{exempt}" for exempt in certificate.exempt]
        notes += [f"not judged, as who made the plan allowed: {a} x {b}" for a, b in saved.allowed]
        emit(render(*lines, *(f"note: {note}" for note in notes)))
    raise typer.Exit(0 if certified else NO_PLAN)


def _verdict(found: Certificate) -> str:
    return "certified" if found.certified else "refused"


def _words(found: Certificate) -> str:
    what = in_words(found.clearance) if found.certified else str(found.refusal)
    return what + ("" if found.part is None else f" (from s = {found.part[0]:.6g} to {found.part[1]:.6g} of its path)")
