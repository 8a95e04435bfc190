"""Plots over time: positions, velocities and accelerations as fractions of their limits, and proven clearance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.view.playback import Playback, Samples

__all__ = ["Plots"]

COLOURS = ("#1f6fb2", "#d9822b", "#3b8f4f", "#b0452c", "#7a4fa0", "#8c6d46", "#c65b9e")
LIMIT, NOW = "#999999", "#222222"
HEIGHT = 190
MAX_CLEARANCE = 0.1
"""Metres; more clearance is drawn as this."""

KINDS = {"position": "position (limits at -1 and 1)", "velocity": "velocity (fraction of limit)",
         "acceleration": "acceleration (fraction of limit)"}  # fmt: skip
CLEARANCE = "clearance in mm (without expected contacts)"


class Plots:
    """Four plots, one below the other.

    Args:
        gui: viser's panel.
        joints: Names of the n joints.
    """

    def __init__(self, gui: Any, joints: Sequence[str]) -> None:
        self._samples: Samples | None = None
        colours = [COLOURS[k % len(COLOURS)] for k in range(len(joints))]
        series = [_line(name, colour) for name, colour in zip(joints, colours, strict=True)]
        many = ({"label": "t"}, *series, _limit("lower limit"), _limit("upper limit"), _now())
        one = ({"label": "t"}, _line("clearance", COLOURS[0]), _limit("limit"), _now())
        self._none = gui.add_markdown("no motion yet")
        self._plots = {
            kind: self._added(gui, title, many, (-1.1, 1.1), legend=kind == "position") for kind, title in KINDS.items()
        }
        self._plots["clearance"] = self._added(gui, CLEARANCE, one, (-5.0, 1000.0 * MAX_CLEARANCE + 5.0), legend=False)

    @staticmethod
    def _added(gui: Any, title: str, series: Any, ends: tuple[float, float], *, legend: bool) -> Any:
        data = tuple(np.zeros(2) + (np.arange(2.0) if k == 0 else 0.0) for k in range(len(series)))
        return gui.add_uplot(
            data, series, title=title, height=HEIGHT + (60 if legend else 0), visible=False,
            scales={"x": {"time": False}, "y": {"auto": False, "range": ends}},
            legend={"show": legend, "live": False},
        )  # fmt: skip

    def show(self, playback: Playback | None) -> None:
        """Plot a playback; None clears the plots."""
        self._samples = None if playback is None else playback.samples
        self._none.visible = playback is None
        for plot in self._plots.values():
            plot.visible = playback is not None
        if playback is not None:
            self.mark(0.0)

    def mark(self, seconds: float) -> None:
        """Move the time mark."""
        samples = self._samples
        if samples is None:
            return
        row = int(np.argmin(np.abs(samples.t - seconds)))
        for kind in KINDS:
            self._plots[kind].data = _data(samples.t, getattr(samples, kind), (-1.0, 1.0), row, (-1.1, 1.1))
        room = 1000.0 * np.minimum(samples.clearance, MAX_CLEARANCE)
        self._plots["clearance"].data = _data(
            samples.t, room[:, None], (0.0,), row, (-5.0, 1000.0 * MAX_CLEARANCE + 5.0)
        )


def _line(label: str, colour: str) -> dict[str, Any]:
    return {"label": label, "stroke": colour, "width": 1.5, "points": {"show": False}}


def _limit(label: str) -> dict[str, Any]:
    return {"label": label, "stroke": LIMIT, "width": 1, "dash": (6.0, 4.0), "points": {"show": False}}


def _now() -> dict[str, Any]:
    return {"label": "now", "stroke": NOW, "width": 1, "points": {"show": False}}


def _data(
    t: FloatArray, values: FloatArray, limits: tuple[float, ...], row: int, ends: tuple[float, float]
) -> tuple[FloatArray, ...]:
    """Columns of a plot; the time mark is a vertical line drawn between two neighbouring samples."""
    now = np.full(len(t), np.nan)
    now[row], now[row - 1 if row else row + 1] = ends[1], ends[0]
    return (t, *np.ascontiguousarray(values.T), *(np.full(len(t), level) for level in limits), now)
