"""Robots that nobody here drew, met as a new user meets them: how long it takes to a proven plan, and what is solved.

Each is met by a fresh process with empty caches. Its file is read by Pinocchio and Coal, too, which judge random
configurations and the plans.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from tempfile import TemporaryDirectory

from rich.table import Table

from benchmarks.harness.fresh_process import told_by
from benchmarks.harness.report import Promise, Report, Row, merged, p50, spread, table, table_of
from benchmarks.studies import checks, meshes, readings
from benchmarks.worlds.foreign import READINGS, ROBOTS, ForeignRobot
from planner_service.errors import InvalidRequest, UnknownName

__all__ = ["PARTS", "run"]

PARTS = ("plans", "readings", "meshes", "check")
QUERIES, STATES = 20, 10_000
AT_MOST = 1800.0
"""Seconds for a robot, its judgement included."""

USUAL, LONGEST = 10.0, 60.0
"""Seconds of CPU from the file to the first proven plan: of half of the robots, and of any."""
GIVEN_UP = 0.05
CONTACT = 1e-6
"""Metres from contact within which two judges may differ."""


def run(
    queries: int = QUERIES, states: int = STATES, seed: int = 0, robot: str | None = None, part: str | None = None
) -> Report:
    """Meet all robots, or the one of that name; more than an hour on quiet cores.

    Args:
        part: One of ``PARTS``.

    Raises:
        UnknownName: there is no such robot.
    """
    names = [one.name for one in READINGS]
    if robot is not None and robot not in names:
        raise UnknownName("robot", robot, names)
    chosen = [one for one in ROBOTS if robot in (None, one.name)]
    listed = part is not None or robot is not None
    reports = []
    if part in (None, "plans"):
        rows = tuple(_rows(chosen, queries, states, seed))
        reports.append(Report("robots", rows, tuple(_tables(rows)), tuple(_promises(rows))))
    if part in (None, "readings"):
        reports.append(readings.run(seed=seed, robot=robot, listed=listed))
    if part in (None, "meshes"):
        reports.append(meshes.run(seed=seed, robot=robot))
    if part in (None, "check"):
        reports.append(checks.run(robot=robot, listed=listed))
    summary = [] if part is not None else [Report("robots", (), (_summary(reports),))]
    return merged("robots", [*summary, *reports])


def _summary(reports: Sequence[Report]) -> Table:
    """What matters most of each robot that is planned for, whose rows are the first report's, out of all parts."""
    cut = {row["robot"]: row for report in reports for row in report.rows if "hull_blocked" in row}
    lines = []
    for row in reports[0].rows:
        met, judged = "first_s" in row, cut.get(row["robot"])
        lines.append(
            {
                "robot": row["robot"],
                "as published": "loads" if met else "refused",
                "first plan": row["first"] if met else "-",
                "tool": "-" if not met else f"{row['tool']}{'' if _tool_is_right(row) else ' (wrong)'}",
                "known to be right": "yes" if met and row["right tools"] and _tool_is_right(row) else "-",
                "hulls alone %": "-" if judged is None else f"{100 * judged['hull_blocked'] / judged['states']:.1f}",
                "pieces alone %": "-" if judged is None else f"{100 * judged['piece_blocked'] / judged['states']:.1f}",
                "missed touches of triangles": "-" if judged is None else judged["missed"],
                "verdicts that differ": row.get("differ", "-"),
            }
        )
    caption = (
        "As published: the file as its package brings it. First plan: from home to a random configuration. Hulls and "
        "pieces alone, missed: next to Coal on the triangles of the meshes, of arms whose links are meshes. Verdicts "
        "that differ: from Coal's on the hulls, of random states."
    )
    return table_of("Robots out of packages, in one line each", lines, caption=caption)


def _rows(chosen: Sequence[ForeignRobot], queries: int, states: int, seed: int) -> Iterator[Row]:
    for one in chosen:
        yield {"robot": one.name, "source": f"{one.distribution}, {one.file}"} | _met(one, queries, states, seed)


def _met(one: ForeignRobot, queries: int, states: int, seed: int) -> Row:
    """What a fresh process with empty caches tells."""
    try:
        source = one.source()
    except InvalidRequest as error:
        return {"error": str(error).splitlines()[0]}
    with TemporaryDirectory() as caches:
        return told_by(
            "benchmarks.studies.one_robot", source, queries, states, seed, seconds=AT_MOST, caches=caches
        ) | {"right tools": one.tools}


def _tables(rows: Sequence[Row]) -> Iterator[Table]:
    lines = [
        {
            "robot": row["robot"],
            "joints": row["joints"],
            "shapes": row["shapes"],
            "tool": row["tool"] + ("" if _tool_is_right(row) else " (wrong)"),
            "load CPU s": f"{row['load_s']:.1f}",
            "first plan CPU s": f"{row['first_s']:.1f}",
            "solved": row["solved"],
            "ends": row["ends"],
            "no path": row["impossible"],
            "given up": len(row["given up"]),
            "ms": spread(row["ms"]),
            "states": row.get("states", "-"),
            "differ": row.get("differ", "-"),
            "plans judged": row.get("judged plans", "-"),
            "touch": len(row["touched"]) if "touched" in row else "-",
        }
        for row in rows
        if "first_s" in row
    ]
    caption = (
        "CPU seconds from the start of a process to the robot, and to its first proven plan, from home to a random "
        "configuration, all processes together. "
        "Ends: not free in 20 draws, which the answer proves. No path: proven. "
        "ms: p50 / p95 of all queries. Differ: verdicts of random "
        "states from Coal's. Touch: plans along which Coal finds a contact, no point moving more than the step "
        "between two looks."
    )
    if lines:
        yield table_of("Robots that nobody here drew", lines, caption=caption)
    told = [(row["robot"], line) for row in rows for line in _left(row)]
    if told:
        yield table("What went wrong", ("robot", "what"), told)


def _tool_is_right(row: Row) -> bool:
    return not row["right tools"] or row["tool"] in row["right tools"]


def _left(row: Row) -> Iterator[str]:
    yield from row.get("given up", ())
    yield from row.get("touched", ())
    if row.get("first", "proven") != "proven":
        yield f"first plan: {row['first']}"
    if row.get("differ"):
        yield f"{row['differ']} verdicts differ, at most {row['apart']:.2g} m apart or {row['deep']:.2g} m deep"
    if "error" in row:
        yield str(row["error"])


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    met = [row for row in rows if "first_s" in row and row["first"] == "proven"]
    failed = [row["robot"] for row in rows if row not in met or "error" in row]
    yield Promise("every robot gives a proven plan and is judged", ", ".join(failed) or f"{len(met)}", not failed)
    wrong = [row["robot"] for row in met if not _tool_is_right(row)]
    yield Promise("the tool frame is the one that the file means", ", ".join(wrong) or "all", not wrong)
    seconds = [row["first_s"] for row in met] or [1e9]
    measured = f"p50 {p50(seconds):.1f} s, at most {max(seconds):.1f} s"
    kept = p50(seconds) <= USUAL and max(seconds) <= LONGEST
    yield Promise(f"from the file to a proven plan: p50 {USUAL:g} s of CPU, none above {LONGEST:g} s", measured, kept)
    asked, left = sum(len(row["ms"]) for row in met), sum(len(row["given up"]) for row in met)
    yield Promise(f"at most {GIVEN_UP:.0%} given up", f"{left} of {asked}", left <= GIVEN_UP * asked)
    wrong = [row["robot"] for row in met if row.get("apart", 0.0) > CONTACT + row.get("larger", 0.0)]
    wrong += [row["robot"] for row in met if row.get("deep", 0.0) > CONTACT]
    yield Promise(
        "verdicts are Coal's but within a micrometre of contact, or of a simplified hull's growth",
        ", ".join(wrong) or "all",
        not wrong,
    )
    touched = [row["robot"] for row in met if row.get("touched")]
    yield Promise("no plan touches anything", ", ".join(touched) or "none", not touched)
