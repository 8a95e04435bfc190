"""The clearance along paths as an SVG plot."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from planner_service.certify import Certifier
from planner_service.files.writing import write_whole
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath

__all__ = ["OURS", "clearance_svg", "clearances_along", "write_clearance_plot"]

OURS = re.compile(rb"<svg|<\?xml")
"""The beginning of a plot's file."""

POINTS = 400
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 640, 280, 56, 12, 28, 40
COLOURS = ("#b0452c", "#1f6fb2", "#3b7a3b", "#7a4fa0")
MAX_CLEARANCE = 100.0
"""Millimetres; more clearance is drawn as this."""


def clearances_along(certifier: Certifier, path: JointPath) -> FloatArray:
    """Proven lower bounds of the clearance (metres) at evenly spaced points of a path."""
    limits = certifier.robot.limits
    s = path.length * (np.arange(POINTS) / (POINTS - 1))
    return certifier.clearances(np.minimum(np.maximum(path(s), limits.lower), limits.upper))


def write_clearance_plot(file: str, certifier: Certifier, paths: Mapping[str, JointPath]) -> None:
    """Plot the clearance along named paths into a file, which is written whole or not at all.

    Raises:
        InvalidFile: it cannot be written.
    """
    curves = {name: clearances_along(certifier, path) for name, path in paths.items()}
    write_whole(Path(file), clearance_svg(curves), OURS)


def clearance_svg(curves: Mapping[str, FloatArray]) -> str:
    """Clearances (metres) at evenly spaced points of paths as curves in one plot, from start to goal."""
    top = min(
        MAX_CLEARANCE,
        max([1.0, *(1000.0 * float(np.minimum(curve, MAX_CLEARANCE).max()) for curve in curves.values())]),
    )
    step = _step(top)
    levels = [step * k for k in range(math.floor(top / step) + 1)]
    parts = [_text(LEFT, TOP - 10, "clearance in mm, from start to goal", "start")]
    for level in levels:
        y = _y(level, top)
        parts.append(
            f'<line x1="{LEFT}" y1="{y:.1f}" x2="{WIDTH - RIGHT}" y2="{y:.1f}" stroke="#ccc" stroke-width="0.6"/>'
        )
        parts.append(_text(LEFT - 6, y + 4, f"{level:g}", "end"))
    for k, (name, curve) in enumerate(curves.items()):
        colour = COLOURS[k % len(COLOURS)]
        shares = np.arange(len(curve)) / max(1, len(curve) - 1)
        points = " ".join(f"{_x(s):.1f},{_y(1000.0 * c, top):.1f}" for s, c in zip(shares, curve, strict=True))
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.6"/>')
        label = f"{name}: at least {1000.0 * float(curve.min()):.1f} mm"
        parts.append(_text(LEFT + k * 270, HEIGHT - 12, label, "start", colour))
    box = f"0 0 {WIDTH} {HEIGHT}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" font-family="sans-serif" font-size="12">'
    return "\n".join([head, f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>', *parts, "</svg>", ""])


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
