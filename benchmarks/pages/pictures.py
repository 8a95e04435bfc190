"""The pictures of the page, drawn by matplotlib and handed over as SVG that takes its colours of text from the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.harness.rows import Row, states_of
from benchmarks.pages.page_numbers import Group, Sheet, rejected, seconds, stage_order, stage_seconds, states
from benchmarks.pages.svg import INK, WIDTH, drawn_as_svg
from planner_service import Stage

__all__ = ["COLOURS", "pictures_of"]

COLOURS = ("#3d85c6", "#d9722b", "#2a9d72", "#b565a7", "#b8922b", "#7d6fd1", "#5f9e2f", "#d0544f", "#2f9fa8", "#8a8a8a")
"""Readable on white and on near black."""

STAGE_COLOURS = {
    Stage.ENDPOINTS.value: "#8a8a8a",
    Stage.STRAIGHT_LINE.value: "#5aa9a0",
    Stage.ROADMAP.value: "#5f9e2f",
    Stage.SEARCH.value: "#3d85c6",
    Stage.SHORTCUT.value: "#d9722b",
    Stage.POLISH.value: "#b8922b",
    Stage.CERTIFY.value: "#7d6fd1",
    Stage.TIMING.value: "#b565a7",
}
"""The same in every picture."""

DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.2, 1.2, 1.2)), (0, (8, 2, 2, 2)))

UNLIKE = 8.0
"""Times the shortest of some bars that the longest may be; beyond, bars are shares."""

SEEN = 0.01
"""Share of the longest bar below which a stage is left out: a line in the picture, and a box in its legend."""


def pictures_of(sheet: Sheet) -> Iterator[tuple[str, str, str]]:
    """Name, caption and SVG of each picture that the rows of a suite allow."""
    groups, counting = sheet.present, [group for group in sheet.present if group.counts]
    colours = {group.name: COLOURS[k % len(COLOURS)] for k, group in enumerate(sheet.groups)}
    boxes = "{} Box: quartiles; line: median; whiskers: 5 % and 95 %."
    within, mean = "Share of the queries solved within so many {}.", "{} per query by stage, mean."
    profile = (
        "Performance profile (Dolan and Moré, 2002): share of the problems solved within a multiple of the best {}."
    )
    clearance = "Smallest clearance against length of the final path; crosses: refused by the independent checker."
    failures, length, duration = "per query, failures included.", _of("length"), _of("duration")
    drawn: dict[str, tuple[str, str, Callable[[Any], bool]]] = {
        "box-states": (boxes, f"States judged {failures}", _boxes(counting, states, colours, "states")),
        "box-ms": (boxes, f"Processor milliseconds {failures}", _boxes(groups, _ms, colours, "ms")),
        "box-length": (boxes, "Length of the final path.", _boxes(groups, length, colours, "rad")),
        "box-duration": (boxes, "Duration of the motion, where it is timed.", _boxes(groups, duration, colours, "s")),
        "ecdf-states": (within, "states", _shares(counting, states, colours, "states")),
        "ecdf-ms": (within, "milliseconds of processor time", _shares(groups, _ms, colours, "ms")),
        "profile-states": (profile, "count of states", _profiles(counting, states, colours)),
        "profile-ms": (profile, "time", _profiles(groups, _ms, colours)),
        "stages-states": (mean, "States judged", _stages(counting, "checks")),
        "stages-ms": (mean, "Processor milliseconds", _stages(groups, "seconds")),
        "clearance-length": (clearance, "", _scatter(groups, colours)),
    }
    for name, (caption, what, draw) in drawn.items():
        picture = drawn_as_svg(f"{sheet.suite}-{name}", draw)
        if picture is not None:
            yield name, caption.format(what), picture


def _ms(row: Row) -> float | None:
    return seconds(row) * 1e3


def _of(key: str) -> Callable[[Row], float | None]:
    return lambda row: None if row[key] is None else float(row[key])


# --- what is in it


def _boxes(
    groups: Sequence[Group], measure: Callable[[Row], float | None], colours: Mapping[str, str], unit: str
) -> Callable[[Any], bool]:
    log = unit in ("states", "ms")  # which span decades, and which failures cost, too

    def draw(figure: Any) -> bool:
        found = [(g, [v for v in g.values(measure, charged=log) if v > 0.0 or not log]) for g in groups]
        found = [(group, values) for group, values in found if values]
        if not found:
            return False
        figure.set_size_inches(WIDTH, 0.95 + 0.34 * len(found))
        axes = figure.subplots()
        boxes = axes.boxplot(
            [values for _, values in found],
            orientation="horizontal",
            whis=(5, 95),
            showfliers=False,
            widths=0.62,
            patch_artist=True,
            tick_labels=[group.name for group, _ in found],
            medianprops={"color": INK, "linewidth": 1.6},
        )
        for k, (group, _) in enumerate(found):
            colour = colours[group.name]
            boxes["boxes"][k].set(facecolor=_faint(colour), edgecolor=colour, linewidth=1.2)
            for line in (*boxes["whiskers"][2 * k : 2 * k + 2], *boxes["caps"][2 * k : 2 * k + 2]):
                line.set(color=colour, linewidth=1.2)
        axes.invert_yaxis()
        axes.set_xlabel(unit)
        axes.grid(axis="y", visible=False)
        if log:
            _log(axes)
        return True

    return draw


def _shares(
    groups: Sequence[Group], measure: Callable[[Row], float | None], colours: Mapping[str, str], unit: str
) -> Callable[[Any], bool]:
    def draw(figure: Any) -> bool:
        found = [(group, sorted(value for value in group.values(measure) if value > 0.0)) for group in groups]
        found = [(group, values) for group, values in found if values]
        if not found:
            return False
        axes = _lined(figure, len(found))
        last = max(values[-1] for _, values in found)
        for k, (group, values) in enumerate(found):
            heights = np.arange(1, len(values) + 1) / len(group.rows)
            _step(axes, [*values, last], [*heights.tolist(), float(heights[-1])], group, colours, k)
        axes.set_xlabel(unit)
        _log(axes)
        _legend(figure, axes)
        return True

    return draw


def _profiles(
    groups: Sequence[Group], measure: Callable[[Row], float | None], colours: Mapping[str, str]
) -> Callable[[Any], bool]:
    def draw(figure: Any) -> bool:
        if len(groups) < 2:
            return False
        table = [_by_problem(group, measure) for group in groups]
        common = [problem for problem in table[0] if all(problem in values for values in table)]
        best = {problem: min(values[problem] for values in table) for problem in common}
        common = [problem for problem in common if np.isfinite(best[problem]) and best[problem] > 0.0]
        if not common:
            return False
        axes = _lined(figure, len(groups))
        ratios = [sorted(values[p] / best[p] for p in common) for values in table]
        ratios = [[ratio for ratio in row if np.isfinite(ratio)] for row in ratios]
        last = max(max(row, default=1.0) for row in ratios) * 1.05
        for k, (group, row) in enumerate(zip(groups, ratios, strict=True)):
            heights = [(n + 1) / len(common) for n in range(len(row))]
            _step(axes, [1.0, *row, last], [0.0, *heights, heights[-1] if heights else 0.0], group, colours, k)
        axes.set_xlabel("times the best")
        _log(axes)
        _legend(figure, axes)
        return True

    return draw


def _by_problem(group: Group, measure: Callable[[Row], float | None]) -> dict[str, float]:
    """The median over a problem's seeds, failures being infinite."""
    found: dict[str, list[float]] = {}
    for row in group.rows:
        value = measure(row) if row["ok"] else None
        found.setdefault(row["problem"], []).append(np.inf if value is None else value)
    return {problem: sorted(values)[len(values) // 2] for problem, values in found.items()}


def _stages(groups: Sequence[Group], part: str) -> Callable[[Any], bool]:
    unit = "states" if part == "checks" else "ms"

    def draw(figure: Any) -> bool:
        stages = [stage for stage in stage_order(groups, part) if stage != "setup"]
        means = {stage: np.array([_mean(group, part, stage) for group in groups]) for stage in stages}
        totals = np.sum(list(means.values()), axis=0)
        if not means or not totals.max(initial=0.0):
            return False
        names, unlike = [group.name for group in groups], totals.max() > UNLIKE * max(totals.min(), 1e-9)
        if unlike:  # the shorter bars would show nothing
            names = [
                f"{name}: {_number(float(f'{total:.3g}'))} {unit}" for name, total in zip(names, totals, strict=True)
            ]
            means = {stage: 100.0 * values / np.maximum(totals, 1e-9) for stage, values in means.items()}
            totals = np.full(len(groups), 100.0)
        _bars(figure, names, {stage: values for stage, values in means.items() if values.max() > SEEN * totals.max()})
        axes = figure.axes[0]
        axes.set_xlabel(f"% of the {unit} beside the name" if unlike else unit)
        return True

    return draw


def _bars(figure: Any, names: Sequence[str], parts: Mapping[str, Any]) -> None:
    """Stacked bars of so much of each stage."""
    figure.set_size_inches(WIDTH, 1.4 + 0.34 * len(names))
    axes = figure.subplots()
    left = np.zeros(len(names))
    for k, (stage, values) in enumerate(parts.items()):
        colour = STAGE_COLOURS.get(stage, COLOURS[-3 + k % 3])
        axes.barh(names, values, left=left, color=colour, height=0.66, label=stage)
        left = left + values
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    _thousands(axes.xaxis)
    _legend(figure, axes, columns=4)


def _mean(group: Group, part: str, stage: str) -> float:
    values = [states_of(row, stage) if part == "checks" else 1e3 * stage_seconds(row, stage) for row in group.rows]
    return float(np.mean(values)) if values else 0.0


def _scatter(groups: Sequence[Group], colours: Mapping[str, str]) -> Callable[[Any], bool]:
    def draw(figure: Any) -> bool:
        found = [(g, [row for row in g.done if row["clearance"] is not None and row["length"]]) for g in groups]
        found = [(group, rows) for group, rows in found if rows]
        if not found:
            return False
        axes = _lined(figure, len(found), tall=0.6)
        for k, (group, rows) in enumerate(found):
            for refused, marker, size in ((False, "osD^v<>ph*"[k % 10], 15), (True, "x", 24)):
                points = [(row["length"], 1e3 * row["clearance"]) for row in rows if rejected(row) is refused]
                if points:
                    x, y = zip(*points, strict=True)
                    filled = {"facecolors": _faint(colours[group.name])} if not refused else {}
                    label = group.name if not refused else None
                    axes.scatter(
                        x, y, s=size, marker=marker, color=colours[group.name], linewidths=1.0, label=label, **filled
                    )
            if all(rejected(row) for row in rows):  # else the legend would not name it
                axes.scatter([], [], s=24, marker="x", color=colours[group.name], linewidths=1.0, label=group.name)
        axes.axhline(0.0, color=INK, linewidth=0.8)
        heights = [1e3 * row["clearance"] for _, rows in found for row in rows]
        axes.set_yscale("symlog", linthresh=1.0)
        axes.set_ylim(min(0.0, 1.6 * min(heights)) - 0.1, 1.6 * max(0.5, *heights))
        axes.set_xlabel("length, rad")
        axes.set_ylabel("clearance, mm")
        _plain(axes.yaxis)
        _legend(figure, axes)
        return True

    return draw


# --- how


def _lined(figure: Any, count: int, tall: float = 0.0) -> Any:
    """Axes with room for a legend of so many entries under them."""
    figure.set_size_inches(WIDTH, 2.5 + tall + 0.2 * ((count + 1) // 2))
    return figure.subplots()


def _step(axes: Any, x: Sequence[float], y: Sequence[float], group: Group, colours: Mapping[str, str], k: int) -> None:
    style = DASHES[k % len(DASHES)]
    axes.step(x, y, where="post", color=colours[group.name], linestyle=style, linewidth=1.7, label=group.name)
    axes.set_ylim(0.0, 1.03)


def _legend(figure: Any, axes: Any, columns: int = 2) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, handlelength=2.2, columnspacing=1.2)


def _log(axes: Any) -> None:
    """A logarithmic x axis with plain numbers, more of them where it spans little."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axes.set_xscale("log")
    low, high = axes.get_xlim()
    decades = float(np.log10(high / low))
    subs = (1.0,) if decades > 2.5 else (1.0, 3.0) if decades > 1.4 else FEW
    axes.xaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_minor_formatter(NullFormatter())
    _plain(axes.xaxis)


FEW = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
"""Where numbers stand on a logarithmic axis that spans little more than a decade."""


def _plain(axis: Any) -> None:
    from matplotlib.ticker import FuncFormatter

    axis.set_major_formatter(FuncFormatter(_number))


def _thousands(axis: Any) -> None:
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(6))
    _plain(axis)


def _number(value: float, _: Any = None) -> str:
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:g}{letter}"
    return f"{value:g}"


def _faint(colour: str) -> str:
    return colour + "59"
