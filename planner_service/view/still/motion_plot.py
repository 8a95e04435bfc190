"""The clearance along paths, and the torques of a motion, as an SVG plot."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from planner_service.certify import Certifier
from planner_service.files.writing import write_whole
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.timing.torque_limits import TorqueSamples

__all__ = ["OURS", "clearances_along", "plot_svg", "write_plot"]

OURS = re.compile(rb"<svg|<\?xml")
"""The beginning of a plot's file."""

POINTS = 400
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 640, 280, 56, 12, 28, 40
COLOURS = ("#b0452c", "#1f6fb2", "#3b7a3b", "#7a4fa0", "#d9822b", "#8c6d46", "#c65b9e")
MAX_CLEARANCE = 100.0
"""Millimetres; more clearance is drawn as this."""


def clearances_along(certifier: Certifier, path: JointPath) -> FloatArray:
    """Proven lower bounds of the clearance (metres) at evenly spaced points of a path."""
    s = path.length * (np.arange(POINTS) / (POINTS - 1))
    return certifier.clearances(np.clip(path(s), *certifier.robot.bounds))


def write_plot(
    file: str, certifier: Certifier, paths: Mapping[str, JointPath], torques: TorqueSamples | None = None
) -> None:
    """Plot the clearance along named paths, and torques, into a file, which is written whole or not at all.

    Raises:
        InvalidFile: it cannot be written.
    """
    curves = {name: clearances_along(certifier, path) for name, path in paths.items()}
    write_whole(Path(file), plot_svg(curves, certifier.robot.joint_names, torques), OURS)


def plot_svg(curves: Mapping[str, FloatArray], joints: Sequence[str] = (), torques: TorqueSamples | None = None) -> str:
    """Clearances (metres) at evenly spaced points of paths as curves from start to goal; below them torques over time.

    Args:
        joints: Names of the joints whose torques are given.
    """
    panels = [_clearances(curves), *([] if torques is None else [_torques(joints, torques)])]
    box = f"0 0 {WIDTH} {HEIGHT * len(panels)}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" font-family="sans-serif" font-size="12">'
    parts = [head, f'<rect width="{WIDTH}" height="{HEIGHT * len(panels)}" fill="white"/>', *panels[0]]
    for panel in panels[1:]:
        parts += [f'<g transform="translate(0 {HEIGHT})">', *panel, "</g>"]
    return "\n".join([*parts, "</svg>", ""])


def _clearances(curves: Mapping[str, FloatArray]) -> list[str]:
    top = min(
        MAX_CLEARANCE,
        max([1.0, *(1000.0 * float(np.minimum(curve, MAX_CLEARANCE).max()) for curve in curves.values())]),
    )
    step = _step(top)
    levels = [step * k for k in range(math.floor(top / step) + 1)]
    parts = [_text(LEFT, TOP - 10, "clearance in mm, from start to goal", "start")]
    for level in levels:
        parts += _level(_y(level, top), f"{level:g}")
    for k, (name, curve) in enumerate(curves.items()):
        colour = COLOURS[k % len(COLOURS)]
        shares = np.arange(len(curve)) / max(1, len(curve) - 1)
        points = " ".join(f"{_x(s):.1f},{_y(1000.0 * c, top):.1f}" for s, c in zip(shares, curve, strict=True))
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.6"/>')
        label = f"{name}: at least {1000.0 * float(curve.min()):.1f} mm"
        parts.append(_text(LEFT + k * 270, HEIGHT - 12, label, "start", colour))
    return parts


def _torques(joints: Sequence[str], torques: TorqueSamples) -> list[str]:
    """Torques of each joint as shares of its limit, from -1 to 1."""
    parts = [_text(LEFT, TOP - 10, f"torque / limit over {torques.times[-1]:.2f} s", "start")]
    for level in (-1.0, -0.5, 0.0, 0.5, 1.0):
        parts += _level(_y(level + 1.0, 2.0), f"{level:g}")
    rows = np.linspace(0, len(torques.times) - 1, min(POINTS, len(torques.times))).round().astype(np.intp)
    times = torques.times[rows] / max(float(torques.times[-1]), 1e-9)
    shares = (torques.moving + torques.holding)[rows]
    gap = (WIDTH - LEFT - RIGHT) / len(joints)
    for k, name in enumerate(joints):
        points = " ".join(
            f"{_x(t):.1f},{_y(share + 1.0, 2.0):.1f}" for t, share in zip(times, shares[:, k], strict=True)
        )
        colour = COLOURS[k % len(COLOURS)]
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.4"/>')
        parts.append(_text(LEFT + k * gap, HEIGHT - 12, name[: int(gap / 7.0)], "start", colour))
    return parts


def _level(y: float, label: str) -> list[str]:
    line = f'<line x1="{LEFT}" y1="{y:.1f}" x2="{WIDTH - RIGHT}" y2="{y:.1f}" stroke="#ccc" stroke-width="0.6"/>'
    return [line, _text(LEFT - 6, y + 4, label, "end")]


def _step(top: float) -> float:
    """Millimetres between grid lines: 1, 2 or 5 times a power of ten, for about five lines."""
    power = 10.0 ** math.floor(math.log10(top / 5.0))
    return next(power * k for k in (1.0, 2.0, 5.0, 10.0) if power * k * 5.0 >= top)


def _x(share: float) -> float:
    return LEFT + share * (WIDTH - LEFT - RIGHT)


def _y(millimetres: float, top: float) -> float:
    inside = min(max(millimetres, 0.0), top) / top
    return HEIGHT - BOTTOM - inside * (HEIGHT - TOP - BOTTOM)


def _text(x: float, y: float, text: str, anchor: str, colour: str = "#333") -> str:
    safe = text.replace("&", "&amp;").replace("<", "&lt;")
    return f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}" fill="{colour}">{safe}</text>'
