"""What ``python -m benchmarks proven`` measured, as tables and promises."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from rich.table import Table

from benchmarks.harness.report import Promise, Row, p50, p95, spread, table, table_of
from benchmarks.worlds import queries, sheets
from planner_service.planning.result import Stage

__all__ = ["DRAWN", "GAP_STEP", "INSTANTS", "KINDS", "MOTION_STEP", "all_promises", "all_tables"]

DRAWN = "drawn"
"""The name under which all drawn scenes are told."""

MOTION_STEP, GAP_STEP = 0.0002, 0.005
"""Metres that any point of the robot moves between samples: of touches, and of the smallest gap."""

INSTANTS = 20_000
"""Samples of a trajectory, at least eight on each piece of time."""

KINDS = {"toppra": ("velocity", "acceleration"), "s-curve": ("velocity", "acceleration", "jerk")}
"""The limits that each law keeps; acceleration jumps under TOPP-RA."""

COAL_ERROR = 5e-6
"""Metres by which Coal's distances may be too small."""

LIMIT_TOLERANCE, ROUNDING = 1e-6, 1e-9
"""Relative to a limit: what breaks it, and by how much a sample may seem to exceed the exact peak."""

SHARES = {"toppra": 0.75, "s-curve": 0.9}
"""What blends are to leave of the motion time with stops, ..."""

BLENDS_PAY = ("shelf", "clutter")
"""... in these scenes."""

BOUNDS_SHARE = 0.5
"""What the certificate may ask of the bounds that plain bisection asks."""

MISSED = 20
"""Sheets that sampling must have missed at each step, before it says something that none was certified."""

STAGES = (Stage.SEARCH, Stage.SHORTCUT, Stage.POLISH, Stage.CERTIFY, Stage.TIMING)

NAMES = (*queries.SCENES, DRAWN)

THICKNESS_MM = sheets.THICKNESS * 1e3


def all_tables(rows: Sequence[Row], planting: Sequence[Row]) -> tuple[Table, ...]:
    """All tables."""
    tables = (_free_table, _mended_table, _limits_table, _duration_table, _bounds_table, _stages_table)
    return (*(made(rows) for made in tables), _sheet_table(planting))


def all_promises(rows: Sequence[Row], planting: Sequence[Row]) -> tuple[Promise, ...]:
    """All promises."""
    return (*_free_promises(rows), *_timing_promises(rows), *_proof_promises(rows, planting))


def _of(rows: Sequence[Row], name: str) -> list[Row]:
    """The planned queries of a scene, or of all drawn ones."""
    return [row for row in rows if row["world"] == name and row["failure"] is None]


def _done(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["failure"] is None]


def _free_table(rows: Sequence[Row]) -> Table:
    def line(name: str) -> Row:
        here, all_ = _of(rows, name), [row for row in rows if row["world"] == name]
        return {
            "scene": name,
            "planned": f"{len(here)}/{len(all_)}",
            "curves that touch": sum(row["touch"] is not None for row in here),
            "least proven mm": f"{min(row['clearance'] for row in here) * 1e3:.2f}",
            "proven mm p50": f"{p50(row['clearance'] for row in here) * 1e3:.2f}",
            "sampled mm p50": f"{p50(row['sampled_gap'] for row in here) * 1e3:.2f}",
            "proven / sampled p50": f"{p50(_tightness(row) for row in here):.2f}",
            "overstated": sum(_overstated(row) for row in here),
            "off path rad": f"{max(row['off_path'] for row in here):.0e}",
        }

    caption = (
        f"Curves that touch: by Coal at {MOTION_STEP * 1e3:g} mm motion steps along the blended curve. Proven: the "
        f"certificate's clearance. Sampled: Coal's smallest distance at {GAP_STEP * 1e3:g} mm steps. Off path: "
        "trajectory(t) from path(s(t))."
    )
    return table_of("The whole curve, judged independently", map(line, NAMES), caption=caption)


def _tightness(row: Row) -> float:
    return float(row["clearance"] / row["sampled_gap"])


def _overstated(row: Row) -> bool:
    return bool(row["clearance"] > row["sampled_gap"] + COAL_ERROR)


def _mended_table(rows: Sequence[Row]) -> Table:
    def line(name: str) -> Row:
        all_ = [row for row in rows if row["world"] == name]
        here = _done(all_)
        failures = sorted(row["failure"] for row in all_ if row["failure"] is not None)
        before, after = (sum(row["corners"][k] for row in here) for k in (0, 1))
        again = sum(row["searched_again"] for row in here)
        return {
            "scene": name,
            "corners blended": f"{before - after}/{before}",
            "narrower blends": sum(row["first_refused"] for row in here) - again,
            "searched again": again,
            "no plan": ", ".join(f"{failures.count(f)} {f}" for f in dict.fromkeys(failures)) or "none",
        }

    caption = "Narrower blends, searched again: paths that were refused at first, and how they were mended."
    return table_of("Refused at first", map(line, NAMES), caption=caption)


def _worst(rows: Sequence[Row], law: str, by: str, kind: str) -> float:
    return max((row[law][by][kind] for row in rows), default=0.0)


def _over(rows: Sequence[Row], law: str, kind: str) -> float:
    """By how much a sample exceeds the exact peak, at most."""
    return max(float(row[law]["sampled"][kind] - row[law]["peaks"][kind]) for row in rows)


def _limits_table(rows: Sequence[Row]) -> Table:
    done = _done(rows)

    def cells(law: str, kind: str) -> list[str]:
        exact, sampled = _worst(done, law, "peaks", kind), _worst(done, law, "sampled", kind)
        return [f"{law}: {kind}", f"{exact - 1.0:+.1e}", f"{sampled - 1.0:+.1e}", f"{_over(done, law, kind):+.1e}"]

    kinds = [(law, kind) for law in KINDS for kind in KINDS[law]]
    columns = ("law", "largest peak - 1", "largest sample - 1", "sample - peak")
    caption = f"Shares of a limit. Peaks at polynomial roots; samples: {INSTANTS:,} instants of each trajectory."
    return table("Limits", columns, (cells(*kind) for kind in kinds), caption=caption)


def _share(rows: Sequence[Row], law: str) -> tuple[float, float]:
    """Motion time over that with stops: of the medians, and the median query's."""
    pairs = [(row[law]["duration"], row[law]["stops"]) for row in rows]
    medians = p50(duration for duration, _ in pairs) / p50(stops for _, stops in pairs)
    return medians, p50(duration / stops for duration, stops in pairs)


def _slower(rows: Sequence[Row], law: str) -> int:
    return sum(row[law]["duration"] > row[law]["stops"] * (1.0 + LIMIT_TOLERANCE) for row in rows)


def _duration_table(rows: Sequence[Row]) -> Table:
    def cells(name: str) -> list[str]:
        here = _of(rows, name)
        out = [name]
        for law in KINDS:
            out += [
                f"{p50(row[law]['stops'] for row in here):.2f}",
                f"{p50(row[law]['duration'] for row in here):.2f}",
                *(f"{share:.2f}" for share in _share(here, law)),
                str(_slower(here, law)),
            ]
        return out

    columns = ["scene"]
    for law in KINDS:
        columns += [f"{law} stops s", "blended s", "ratio of p50", "p50 of ratios", "slower"]
    caption = (
        "The same polyline under the same law, with a stop at each corner and blended. Slower: blended takes longer."
    )
    return table("Motion time", columns, (cells(name) for name in NAMES), caption=caption)


def _bounds_share(rows: Sequence[Row]) -> float:
    return float(sum(row["distances"] for row in rows) / sum(row["plain"] for row in rows))


def _bounds_table(rows: Sequence[Row]) -> Table:
    def line(name: str) -> Row:
        here = _of(rows, name)
        ratios = [row["distances"] / row["plain"] for row in here]
        return {
            "scene": name,
            "certificate": spread([row["distances"] for row in here]),
            "plain bisection": spread([row["plain"] for row in here]),
            "ratio of sums": f"{_bounds_share(here):.2f}",
            "p50 of ratios": f"{p50(ratios):.2f}",
            "worst": f"{max(ratios):.2f}",
        }

    caption = "(configuration, pair) bounds asked for the same curve, p50 / p95. Plain: every stretch for all pairs."
    return table_of("Bounds of a certificate", map(line, NAMES), caption=caption)


def _stages_table(rows: Sequence[Row]) -> Table:
    def line(name: str) -> Row:
        here = _of(rows, name)
        spent = {stage.value: spread([row["ms"].get(stage.value, 0.0) for row in here], 1) for stage in STAGES}
        laws = {law: spread([row[law]["ms"] for row in here], 1) for law in KINDS}
        return {"scene": name, **spent, **laws, "judging s": f"{sum(row['judging_seconds'] for row in here):.0f}"}

    caption = (
        "Milliseconds, p50 / p95. Timing: TOPP-RA with its peaks, tool speed and stops; each law alone has a column. "
        "Judging: seconds in all of the independent checker's samples."
    )
    return table_of("Milliseconds by stage", map(line, NAMES), caption=caption)


def _sheet_table(planting: Sequence[Row]) -> Table:
    def cells(step: float) -> list[str]:
        here = [row for row in planting if row["step"] == step]
        keys = ("tried", "touched", "missed", "caught")
        counts = [sum(row[key] for row in here) for key in keys]
        return [f"{step:g} rad", str(len(here)), *map(str, counts), str(counts[1] - counts[3])]

    columns = ("sampling", "paths", "sheets tried", "touched", "missed by sampling", "certificate refused", "let pass")
    caption = (
        f"{THICKNESS_MM:g} mm thick. Touched: between two samples, by Coal at {MOTION_STEP * 1e3:g} mm motion steps, "
        "and not at these two. Missed: all samples of the path at the step are free by FCL."
    )
    return table("Planted sheets", columns, (cells(step) for step in sheets.STEPS), caption=caption)


def _named(rows: Sequence[Row], tell: Callable[[Row], str] = lambda row: "") -> str:
    return ", ".join(f"{row['query']} {tell(row)}".strip() for row in rows) or "none"


def _free_promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    done = _done(rows)
    stored = [row for row in rows if row["world"] != DRAWN]
    touching = [row for row in done if row["touch"] is not None]
    overstated = [row for row in done if _overstated(row)]
    lost = [row for row in stored if row["failure"] == "NOT_CERTIFIED"]
    off = max(row["off_path"] for row in done)
    free = f"0 of {len(done)} curves in collision at {MOTION_STEP * 1e3:g} mm motion steps"
    ratio = f"{_named(overstated)}; p50 of the ratio {p50(map(_tightness, done)):.2f}"
    return (
        Promise(free, _named(touching, lambda row: str(row["touch"])), not touching),
        Promise("the timed curve is the certified one", f"{off:g} rad off", off == 0.0),
        Promise("no certificate states more than Coal's smallest distance", ratio, not overstated),
        Promise("stored queries: none NOT_CERTIFIED", _named(lost), not lost),
    )


def _timing_promises(rows: Sequence[Row]) -> Iterator[Promise]:
    done = _done(rows)
    for law in KINDS:
        kinds = KINDS[law]
        worst = max(_worst(done, law, by, kind) for by in ("peaks", "sampled") for kind in kinds)
        broken = [row for row in done if max(row[law]["peaks"].values()) > 1.0 + LIMIT_TOLERANCE]
        sampled = [row for row in done if max(row[law]["sampled"].values()) > 1.0 + LIMIT_TOLERANCE]
        measured_ = f"{len(broken)} by peaks, {len(sampled)} by samples; worst {worst - 1.0:+.1e}"
        text = f"{law}: 0 violations of {', '.join(kinds)} above {LIMIT_TOLERANCE:g} relative"
        yield Promise(text, measured_, not broken and not sampled)
    over = max(_over(done, law, kind) for law in KINDS for kind in KINDS[law])
    yield Promise("no sample of a motion exceeds its exact peak", f"{over:+.1e}", over <= ROUNDING)
    for law, wanted in SHARES.items():
        for name in BLENDS_PAY:
            of_medians, of_ratios = _share(_of(rows, name), law)
            text = f"{name}: {law} blended at most {wanted:g} x of with stops (p50)"
            yield Promise(text, f"{of_medians:.3f} (p50 of ratios {of_ratios:.3f})", of_medians <= wanted)


def _proof_promises(rows: Sequence[Row], planting: Sequence[Row]) -> Iterator[Promise]:
    for name in NAMES:
        here = _of(rows, name)
        text = f"{name}: at most {BOUNDS_SHARE:g} x the bounds of plain bisection"
        share, high = _bounds_share(here), p95(row["distances"] / row["plain"] for row in here)
        yield Promise(text, f"{share:.2f} (p95 {high:.2f})", share <= BOUNDS_SHARE)
    for step in sheets.STEPS:
        here = [row for row in planting if row["step"] == step]
        touched, missed, caught = (sum(row[key] for row in here) for key in ("touched", "missed", "caught"))
        text = (
            f"every {THICKNESS_MM:g} mm sheet is refused, {MISSED} and more that {step:g} rad samples miss among them"
        )
        measured_ = f"{caught} of {touched}, {missed} of them missed"
        yield Promise(text, measured_, caught == touched and missed >= MISSED)
