"""The command ``certify``: proves a saved plan or task again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from planner_service.certify import Certificate
from planner_service.certify.certifier import clearance_text
from planner_service.cli import options
from planner_service.cli.arguments import pairs_of_texts, reopened
from planner_service.cli.exit_codes import NO_PLAN, bad_input_exits
from planner_service.cli.options import option
from planner_service.cli.output import show
from planner_service.errors import InvalidRequest
from planner_service.records.cells import SavedCellPlan, load_saved, prove_cell, with_cell_evidence
from planner_service.records.evidence import with_evidence
from planner_service.records.recertify import Recertified, recertify
from planner_service.records.result import certificate_record
from planner_service.scene.loading import load_scene

__all__ = ["certify"]


def certify(
    plan_file: options.PlanFile,
    scene: options.OtherScene = None,
    robot: options.OtherRobot = None,
    padding: Annotated[float, option("METRES", "Distance that every pair must keep.")] = 0.0,
    allow: options.Allow = None,
    evidence: Annotated[str | None, option("FILE", "Save the plan with the trail of its proof, for others.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Prove again that a saved plan or task is collision-free, between samples too, and keeps its limits.

    Every motion of a task is proven with the object it carries, and so is every opening and closing of the gripper.
    Pairs that are not checked are listed: only those that picking and placing need, and those you confirm with --allow.
    Of a cell's plan every two arms are proven apart, however late each is within the delay that the file claims.
    """
    with bad_input_exits():
        loaded = load_saved(plan_file)
    if isinstance(loaded, SavedCellPlan):
        with bad_input_exits():
            _certify_cell(plan_file, loaded, scene, robot, padding, allow, evidence, as_json=as_json)
        return
    with bad_input_exits():
        saved, notes = reopened(loaded, robot, scene)
        proven = recertify(saved, allowed=pairs_of_texts("--allow", allow or ()), padding=padding)
        if evidence is not None and proven.certified:
            with_evidence(saved).save(evidence)
            notes = [*notes, f"the trail of the proof is in {evidence}"]
    remarks = [*notes, *proven.not_checked]
    remarks += [
        f"{motion.name}: only s = {part[0]:.4g} to {part[1]:.4g} of its path remains"
        for motion in proven.motions
        if (part := motion.certificate.part) is not None
    ]
    verdict = "certified" if proven.certified else "refused"
    title = f"{verdict}: {plan_file} with {proven.world.robot.name} in {proven.world.scene.name}"
    blocks = (title, *_verdicts(proven), *(f"note: {remark}" for remark in remarks))
    show(_document(proven, notes), *blocks, as_json=as_json)
    raise typer.Exit(0 if proven.certified else NO_PLAN)


def _certify_cell(
    plan_file: str,
    saved: SavedCellPlan,
    scene: str | None,
    robot: options.RobotChoice | None,
    padding: float,
    allow: Sequence[str] | None,
    evidence: str | None,
    *,
    as_json: bool,
) -> None:
    """The same of the plan of a cell."""
    for option_name, given in (("--robot", robot), ("--allow", allow or None)):
        if given is not None:
            raise InvalidRequest(option_name, str(given), "a plan or a task; this is the plan of a cell")
    notes = ["using the robots and the scene in this file"]
    if scene is not None:
        saved, notes = saved.within(load_scene(scene)), [f"using --scene {scene} instead of the scene in this file"]
    proven = prove_cell(saved, padding=padding)
    if evidence is not None and proven.certified:
        shown = with_cell_evidence(saved)
        shown.save(evidence)
        less = shown.plan.tolerates < proven.tolerates
        notes.append(f"the trail of the proof is in {evidence}" + f", for {shown.plan.tolerates:g} s of delay" * less)
    verdict = "certified" if proven.certified else "refused"
    arms = ", ".join(proven.cell.arms)
    late = "one arm moves" if proven.tolerates == math.inf else f"tolerates {proven.tolerates:.3f} s of delay"
    title = f"{verdict}: {plan_file} with {arms} in {proven.cell.scene.name}"
    lines = [
        f"  {' and '.join(clock.arms)}, from {clock.start:.2f} s: {_verdict(motion.motions[0].certificate)}"
        for clock, motion in zip(proven.plan.clocks, proven.motions, strict=True)
        if motion.motions
    ]
    lines += (
        [f"  all of them: {late}"] if proven.certified else [f"  refused: {problem}" for problem in proven.problems]
    )
    document = {
        "arms": list(proven.cell.arms),
        "scene": proven.cell.scene.name,
        "notes": notes,
        "certified": proven.certified,
        "problems": list(proven.problems),
        "tolerates": None if proven.tolerates == math.inf else proven.tolerates,
        "rectangles": proven.rectangles,
        "motions": [
            {"arms": list(clock.arms), "start": clock.start, **certificate_record(motion.motions[0].certificate)}
            for clock, motion in zip(proven.plan.clocks, proven.motions, strict=True)
            if motion.motions
        ],
    }
    remarks = [*notes, *proven.not_checked]
    show(document, title, *lines, *(f"note: {remark}" for remark in remarks), as_json=as_json)
    raise typer.Exit(0 if proven.certified else NO_PLAN)


def _verdicts(proven: Recertified) -> list[str]:
    """A line per motion and per gripper motion, then the problems that none of them names."""
    lines, named = [], set()
    for motion in proven.motions:
        if (gripper := motion.gripper) is not None:
            verdict = f"refused: {gripper.refused}" if gripper.refused else _verdict(gripper.certificate)
            lines.append(f"  {gripper.name} before {motion.name}: {verdict}")
            named.add(f"{motion.name}: {gripper.refused}")
        lines.append(f"  {motion.name}: {_verdict(motion.certificate)}")
        named.add(f"{motion.name}: {motion.certificate.refusal}")
    return [*lines, *(f"  refused: {problem}" for problem in proven.problems if problem not in named)]


def _verdict(certificate: Certificate) -> str:
    if certificate.refusal is not None:
        return f"refused: {certificate.refusal}"
    part = certificate.part
    stretch = "" if part is None else f" (from s = {part[0]:.6g} to {part[1]:.6g} of its path)"
    free = f"certified: {clearance_text(certificate.clearance)}{stretch}"
    return "; ".join([free, *map(str, certificate.kept)])


def _document(proven: Recertified, notes: Sequence[str]) -> dict[str, Any]:
    return {
        "robot": proven.world.robot.name,
        "scene": proven.world.scene.name,
        "notes": list(notes),
        "certified": proven.certified,
        "problems": list(proven.problems),
        "allowed": [list(pair) for pair in proven.allowed],
        "motions": [{"name": motion.name, **certificate_record(motion.certificate)} for motion in proven.motions],
    }
