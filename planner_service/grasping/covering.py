"""A choice of few grasps that covers many: the best first, and none that is nearly one of those before it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose

__all__ = ["ALIKE_METRES", "ALIKE_RADIANS", "COARSER", "MAX_GRASPS", "MOST", "covering", "unlike"]

ALIKE_METRES, ALIKE_RADIANS = 0.01, math.radians(20.0)
"""Two grasps are alike if their distance over the first and their turn over the second are together below 1."""

MOST, MAX_GRASPS = 64, 1_000
"""Grasps that are chosen if nobody says how many, and at most."""

COARSER = 1.2
"""Factor by which both grow where more grasps are left than are wanted."""


def unlike(poses: FloatArray, pose: FloatArray) -> FloatArray:
    """How unlike a pose (7,) poses (k, 7) are, positions before quaternions; from 1 on they are not alike, (k,)."""
    away = np.sqrt(((poses[:, :3] - pose[:3]) ** 2).sum(axis=1))
    same = np.abs((poses[:, 3:] * pose[3:]).sum(axis=1))
    chord = np.sqrt(np.maximum(2.0 - 2.0 * same, 0.0))  # 2 sin(turn / 4), so that no arc cosine is needed
    return np.asarray(away / ALIKE_METRES + chord / (2.0 * math.sin(ALIKE_RADIANS / 4.0)))


def covering(poses: Sequence[Pose], most: int, fits: Callable[[int], bool]) -> tuple[Pose, ...]:
    """At most ``most`` of poses that come best first: each other one that fits is like one that is chosen before it.

    Args:
        fits: Whether a pose, by its number, is to be considered; asked once for each that is not like a chosen one.
    """
    rows = np.array([(*pose.position, *pose.quaternion) for pose in poses]).reshape(-1, 7)
    coarseness, known, before = 1.0, dict[int, bool](), list[int]()

    def apart(number: int, others: list[int], least: float) -> bool:
        return not others or float(unlike(rows[others], rows[number]).min()) >= least

    while True:
        kept: list[int] = []
        for number in range(len(rows)):
            if not apart(number, kept, coarseness):
                continue
            if number not in known:
                known[number] = fits(number)
            if known[number]:
                kept.append(number)
                if len(kept) > most:
                    break
        if len(kept) <= most:
            break
        before, coarseness = kept, coarseness * COARSER
    for number in before:  # there may be room for some more that are less unlike
        if len(kept) < most and number not in kept and apart(number, kept, coarseness / COARSER):
            kept.append(number)
    return tuple(poses[number] for number in sorted(kept))
