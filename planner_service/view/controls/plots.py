"""Plots over time: positions, velocities and accelerations as fractions of their limits, proven clearance, and how much
of their tolerances constraints use.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.view.playback import Playback

__all__ = ["Plots"]

COLOURS = ("#1f6fb2", "#d9822b", "#3b8f4f", "#b0452c", "#7a4fa0", "#8c6d46", "#c65b9e")
LIMIT, NOW = "#999999", "#222222"
HEIGHT = 190
MAX_CLEARANCE = 0.1
"""Metres; more clearance is drawn as this."""

KINDS = {"position": "position (limits at -1 and 1)", "velocity": "velocity (fraction of limit)",
         "acceleration": "acceleration (fraction of limit)"}  # fmt: skip
CLEARANCE = "clearance in mm (without expected contacts)"
CONSTRAINTS = "constraints (bounds at -1 and 1)"


class Plots:
    """Four plots, one below the other, and one more for a motion with constraints.

    Args:
        gui: viser's panel.
        tab: The tab of the panel that they are in.
        joints: Names of the n joints.
    """

    def __init__(self, gui: Any, tab: Any, joints: Sequence[str]) -> None:
        self._gui, self._tab = gui, tab
        self._playback: Playback | None = None
        with tab:
            self._add(joints)
        self._constraints: Any = None

    def _add(self, joints: Sequence[str]) -> None:
        gui, many = self._gui, _series(joints)
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
        self._playback = playback
        self._none.visible = playback is None
        for plot in self._plots.values():
            plot.visible = playback is not None
        if self._constraints is not None:
            self._constraints.remove()
            self._constraints = None
        if playback is not None:
            if playback.used:  # the others have the same curves for each motion
                with self._tab:
                    series = _series(tuple(playback.used))
                    self._constraints = self._added(self._gui, CONSTRAINTS, series, (-1.1, 1.1), legend=True)
                    self._constraints.visible = True
            self.mark(0.0)

    def mark(self, seconds: float) -> None:
        """Move the time mark."""
        playback = self._playback
        if playback is None:
            return
        samples = playback.samples
        row = int(np.argmin(np.abs(samples.t - seconds)))
        for kind in KINDS:
            self._plots[kind].data = _data(samples.t, getattr(samples, kind), (-1.0, 1.0), row, (-1.1, 1.1))
        room = 1000.0 * np.minimum(samples.clearance, MAX_CLEARANCE)
        self._plots["clearance"].data = _data(
            samples.t, room[:, None], (0.0,), row, (-5.0, 1000.0 * MAX_CLEARANCE + 5.0)
        )
        if self._constraints is not None:
            used = np.stack(list(playback.used.values()), axis=1)
            self._constraints.data = _data(samples.t, used, (-1.0, 1.0), row, (-1.1, 1.1))


def _series(names: Sequence[str]) -> tuple[dict[str, Any], ...]:
    """One curve for each name, two limits and the time mark."""
    curves = [_line(name, COLOURS[k % len(COLOURS)]) for k, name in enumerate(names)]
    return ({"label": "t"}, *curves, _limit("lower limit"), _limit("upper limit"), _now())


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
