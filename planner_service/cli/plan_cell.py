"""The command ``plan-cell``: motions of several arms, each on its own clock."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Annotated, Any

from planner_service.cell import CellPlan
from planner_service.cli import arguments, options
from planner_service.cli.exit_codes import bad_input_exits, finish
from planner_service.cli.options import argument, option
from planner_service.records.cells import SavedCellPlan, read_cell_request, save_cell_plan, with_cell_evidence

__all__ = ["plan_cell"]


def plan_cell(
    file: Annotated[str, argument("FILE", "A TOML file with the scene, the arms, and what each is to do.")],
    delay: Annotated[
        float | None, option("SECONDS", "How late any arm may be without touching another; as the file says.")
    ] = None,
    png: options.Picture = None,
    out: options.Out = None,
    evidence: Annotated[bool, option("--evidence", "Keep the trail of the proof in the file, for others.")] = False,
    as_json: options.AsJson = False,
) -> None:
    """Plan for several arms in one scene, each on its own clock, and prove that they do not touch, however late.

    The file names a scene and up to four arms, each with its robot, the place of its base, a start and a goal, or where
    it stands. An arm starts as early as it is proven not to touch another that may be late.
    """
    with bad_input_exits():
        arguments.require_outputs({"--out": out, "--png": png})
        asked = read_cell_request(file)
        plan = (asked if delay is None else replace(asked, delay=delay)).plan()
        saved = SavedCellPlan.of(plan)
        if evidence and plan.ok:
            saved = with_cell_evidence(saved)
        if out is not None:
            save_cell_plan(saved, out)
        if png is not None and plan.ok:
            from planner_service.view.still.cells import draw_cell

            draw_cell(plan, png)
    title = f"{'planned' if plan.ok else 'no plan'}: {', '.join(asked.cell.arms)} in {asked.cell.scene.name}"
    finish(partial(_document, saved), None, [title, *_lines(plan)], plan.failure, as_json=as_json)


def _document(saved: SavedCellPlan) -> dict[str, Any]:
    return saved.document()


def _lines(plan: CellPlan) -> list[str]:
    return [line.strip() for line in str(plan).splitlines()] if plan.ok else []
