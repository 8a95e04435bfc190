"""The timeline: the steps of a task, its motions one after another, and under them clearance and speed of the tool."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.planning.task_result import StepReport
from planner_service.view.playback import Playback, Span
from planner_service.view.updates import update

__all__ = ["Timeline", "steps_html", "timeline_html"]

WIDTH, HEIGHT = 1000, 100
"""Units of a curve's drawing, which is stretched to the width of the panel."""

BAR, CURVE = 20, 40
"""Pixels of the motions' names, and of a curve."""

HIGH = f"height:var(--curve, {CURVE}px)"
COLOURS = ("#c9dcf2", "#d9e8cf", "#f2ddc4", "#e2d5ee", "#d3e6e6")
"""Of the motions, by turns."""

FULL = 0.7
"""Of the height of its curve that the highest speed has: its text is above."""

WAITING = "#f2c879"

INK, FAINT, NOW = "#1f6fb2", "#868e96", "#d6336c"
MAX_CLEARANCE = 0.1
"""Metres; more clearance is drawn as this."""

LOW = 0.005
"""Metres of clearance below which the curve is marked."""

MAX_STEPS = 40
"""Of a task, that are drawn."""

WORKED, TRIED_AGAIN, BLOCKED, UNTRIED = "#d9e8cf", "#f2ddc4", "#f3c1c1", "#e9ecef"
"""Colours of steps that worked, that worked after others had failed, of which none worked, and that nobody came to."""

CHIP = "font-size:10px;line-height:16px;padding:0 4px;border-radius:3px;color:#343a40;white-space:nowrap"
LINE = f"line-height:{BAR}px"
TEXT = "position:absolute;left:4px;top:2px;font-size:10px;line-height:1.1;color:#495057"


class Timeline:
    """A drawing without controls, to be read below the slider of the clock.

    Args:
        gui: viser's controls.
    """

    def __init__(self, gui: Any) -> None:
        self._steps = gui.add_html("", visible=False)
        self._drawing = gui.add_html("", visible=False)
        self._now = gui.add_html("", visible=False)
        self._duration, self._bars = 0.0, 1

    def show(self, playback: Playback | None, steps: Sequence[StepReport] = ()) -> None:
        """Draw the motions of a playback, None for nothing, and how the steps of a task fared."""
        update(self._steps, content=steps_html(steps), visible=bool(steps))
        if playback is not None:
            self._duration, self._bars = playback.duration, max(1, len(playback.rows))
            update(self._drawing, content=timeline_html(playback))
            self.mark(0.0)
        update(self._drawing, visible=playback is not None)
        update(self._now, visible=playback is not None)

    def mark(self, seconds: float | None) -> None:
        """Mark the time shown; None for no mark."""
        share = 0.0 if seconds is None or self._duration <= 0.0 else min(max(seconds / self._duration, 0.0), 1.0)
        tall = f"calc({BAR * self._bars}px + 2 * var(--curve, {CURVE}px))"
        line = f"position:absolute;bottom:0;height:{tall};left:{100.0 * share:.2f}%;border-left:1.5px solid {NOW}"
        mark = "" if seconds is None else f'<div style="{line}"></div>'
        update(
            self._now,
            content=f'<div class="timeline" style="position:relative;height:0;margin:0 12px 6px">{mark}</div>',
        )


def timeline_html(playback: Playback) -> str:
    """The drawing as HTML; every name in it is escaped, as names come from files."""
    samples = playback.samples
    duration = playback.duration or 1.0
    room = np.minimum(samples.clearance, MAX_CLEARANCE) / MAX_CLEARANCE
    top = float(samples.speed.max(initial=0.0))
    least = float(samples.clearance.min(initial=math.inf))
    clear = "nothing near" if math.isinf(least) else f"{math.floor(max(least, 0.0) * 1e4) / 10:.1f} mm at least"
    shares = samples.t / duration
    curves = (
        _curve(shares, np.maximum(room, 0.0), f"clearance, {clear}", LOW / MAX_CLEARANCE),
        _curve(shares, FULL * samples.speed / (top or 1.0), f"speed of the tool, {top:.2f} m/s at most", None),
    )
    if playback.rows:
        bar = "".join(_row(name, spans, duration) for name, spans in playback.rows)
    else:
        bar = _bar([(clip.name, (clip.end - clip.begin) / duration) for clip in playback.clips])
    return f'<div class="timeline" style="margin:4px 12px 0">{bar}{"".join(curves)}</div>'


def steps_html(steps: Sequence[StepReport]) -> str:
    """The steps of a task as HTML, each in the colour of how it fared; of many those alone that failed once or more."""
    shown = steps if len(steps) <= MAX_STEPS else [step for step in steps if step.failed][:MAX_STEPS]
    chips = [_chip(step) for step in shown]
    more = len(steps) - len(shown)
    chips += [f'<span style="{CHIP}">and {more} more</span>'] if more else []
    return f'<div class="steps" style="display:flex;flex-wrap:wrap;gap:2px;margin:4px 12px 8px">{"".join(chips)}</div>'


def _chip(step: StepReport) -> str:
    if not step.tried:
        colour = UNTRIED
    else:
        colour = BLOCKED if step.failed == step.tried else TRIED_AGAIN if step.failed else WORKED
    count = f" {step.tried - step.failed}/{step.tried}" if step.failed else ""
    told, tip = html.escape(f"{step.step}{count}", quote=True), html.escape(str(step), quote=True)
    return f'<span title="{tip}" style="{CHIP};background:{colour}">{told}</span>'


def _bar(motions: Sequence[tuple[str, float]]) -> str:
    """The motions' names, each as wide as it takes long."""
    style = f"overflow:hidden;white-space:nowrap;text-overflow:ellipsis;padding:0 3px;box-sizing:border-box;{LINE}"
    blocks = []
    for k, (name, share) in enumerate(motions):
        text = html.escape(name, quote=True)
        look = f"width:{100.0 * share:.2f}%;background:{COLOURS[k % len(COLOURS)]};{style}"
        blocks.append(f'<div title="{text}" style="{look}">{text}</div>')
    return f'<div style="display:flex;height:{BAR}px;font-size:10px;color:#343a40">{"".join(blocks)}</div>'


def _row(name: str, spans: Sequence[Span], duration: float) -> str:
    """When an arm moves, and when it waits."""
    told = html.escape(name, quote=True)
    blocks = "".join(
        f'<div title="{told} {"waits" if span.waits else "moves"} from {span.begin:.2f} to {span.end:.2f} s" style="'
        f"position:absolute;top:1px;bottom:1px;left:{100.0 * span.begin / duration:.2f}%;"
        f"width:{100.0 * (span.end - span.begin) / duration:.2f}%;"
        f'background:{WAITING if span.waits else COLOURS[0]}"></div>'
        for span in spans
    )
    look = f"position:relative;height:{BAR}px;overflow:hidden;font-size:10px;color:#343a40;{LINE}"
    return f'<div style="{look}">{blocks}<span style="position:absolute;left:4px">{told}</span></div>'


def _curve(shares: FloatArray, values: FloatArray, text: str, low: float | None) -> str:
    """A curve of values from 0 to 1 over shares of the time, with a line below which values are marked."""
    points = " ".join(f"{WIDTH * x:.1f},{HEIGHT * (1.0 - y):.1f}" for x, y in zip(shares, values, strict=True))
    level = "" if low is None else (
        f'<line x1="0" x2="{WIDTH}" y1="{HEIGHT * (1.0 - low):.1f}" y2="{HEIGHT * (1.0 - low):.1f}" stroke="{NOW}"'
        ' stroke-width="1" stroke-dasharray="4 4" vector-effect="non-scaling-stroke"/>'
    )  # fmt: skip
    return (
        f'<div style="position:relative;{HIGH};border-bottom:1px solid {FAINT}">'
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" preserveAspectRatio="none" width="100%"'
        f' style="display:block;{HIGH}"><polyline points="{points}" fill="none" stroke="{INK}" stroke-width="1.5"'
        f' vector-effect="non-scaling-stroke"/>{level}</svg><span style="{TEXT}">{html.escape(text)}</span></div>'
    )
