"""Checks that a plan keeps its constraints, wherever on its curve.

A constraint has no trail: it follows from the curve. It is written as numbers that must not be negative: each is a sum
of entries of the frame T of the tool in its region and of joint values, times weights. The turn psi about z follows
from ``cos psi (1 + T_zz) = T_xx + T_yy``.

On a stretch of length h such a number, A and B at its ends, is at least ``(1 - t) A + t B - M t (1 - t) h^2 / 2`` at
the share t of it, M bounding the second derivative. A stretch on which that may be negative is cut in half.

With v and a the sums of the speeds and of the accelerations of the joints between the two frames, the second derivative
of a direction is at most ``v^2 + a``, and that of a point ``r (v^2 + a)``, r being the farthest that it can be from
these joints; where one slides, at v', ``2 v v' + a'`` are added. A joint accelerates on blends alone, by at most
``0.625 abs(v - u) / d``; that times h is the most by which its speed differs from the average on a stretch.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from auditor.schema import require
from auditor.trails import SLACK, Curve, World, chain, frame, placed

Array = Any
Json = Any

MOST_STRETCHES = 200_000


def kept(world: World, robot: Json, constraint: Json, curve: Curve, begin: float, end: float) -> None:
    """Show that a constraint holds between two places of a curve."""
    name, terms = constraint.get("name") or constraint["joint"], list[tuple[dict[int, float], float]]()
    (b, tool), (c, base) = world.tool, (0, np.eye(4))
    if constraint["kind"] == "joint range":
        column = 16 + robot["joint_names"].index(constraint["joint"])
        limits, angles = [(column, constraint["lower"] + SLACK, constraint["upper"] - SLACK)], []
    else:
        frames = {each["link"]: (each["body"], frame(each["pose"])) for each in robot.get("link_frames", [])}
        b, tool = world.tool if constraint["link"] is None else frames[constraint["link"]]
        c, base = (0, base) if constraint["relative_to"] is None else frames[constraint["relative_to"]]
        tool, base = tool @ frame(constraint["tool"]), base @ frame(constraint["frame"])
        edges = enumerate(zip(constraint["lower"], constraint["upper"], strict=True))
        limits = [(4 * k + 3, low, high) for k, (low, high) in edges]
        angles = [(kind, constraint[kind]) for kind in ("tilt", "turn") if constraint[kind] not in (None, math.pi)]
    require([0 < angle < math.pi for _, angle in angles], f"{name}: no such angle")
    for k, low, high in limits:
        terms += [({k: sign}, -sign * edge) for sign, edge in ((1.0, low), (-1.0, high)) if edge is not None]
    for kind, angle in angles:
        steep, cosine = max(math.sin(min(angle, math.pi / 2)), 1e-6), math.cos(angle)
        entries = {10: 1.0} if kind == "tilt" else {0: 1.0, 5: 1.0, 10: -cosine}
        terms.append(({k: x / steep for k, x in entries.items()}, -cosine / steep))
    W, more = np.zeros((len(terms), 17 + world.column)), np.array([added for _, added in terms])
    for row, (entries, _) in zip(W, terms, strict=True):
        row[[*entries]] = [*entries.values()]
    turning, sliding = np.zeros((2, 1 + world.column))
    far, most = np.linalg.norm(tool[:3, 3]) + np.linalg.norm(base[:3, 3]), np.abs(curve.points).max(axis=0)
    for body in (world.bodies[k] for k in set(chain(world.bodies, b)) ^ set(chain(world.bodies, c))):
        column, times = body["q_index"], abs(body["multiplier"])
        (sliding if body["prismatic"] else turning)[column] += times
        far += np.linalg.norm(body["at"][:3, 3]) + body["prismatic"] * times * most[column]
    points, alike = np.abs(W[:, [3, 7, 11]]).sum(1), np.abs(W[:, [0, 1, 2, 4, 5, 6, 8, 9, 10]]).sum(1)

    def values(s: Array) -> Array:
        """What must not be negative, (k, m)."""
        q = curve.at(s)
        at = placed(world.bodies, q)
        T = np.linalg.inv(at[c] @ base) @ at[b] @ tool
        return W @ np.hstack([T.reshape(-1, 16), q]).T + more[:, None]

    places = np.unique([0.0, *(curve.corners - curve.d), *(curve.corners + curve.d), curve.length])
    cuts = np.array([begin, *places[(places > begin) & (places < end)], end])
    left, right, looked = cuts[:-1], cuts[1:], 0
    while len(left):
        A, B, h, middle, looked = values(left), values(right), right - left, (left + right) / 2, looked + len(left)
        where = f"{name} is not kept from s = {left[0]:.9g} to {right[-1]:.9g}"
        require(looked < MOST_STRETCHES and (A > -2 * SLACK).all() and (B > -2 * SLACK).all(), where)
        on = (np.abs(middle[:, None] - curve.corners) < curve.d) * 0.625 / np.maximum(curve.d, 1e-300)
        bends = on @ np.abs(np.diff(curve.tangents, axis=0))
        speeds = np.abs(curve.at(right) - curve.at(left)) / np.maximum(h, 1e-300)[:, None] + bends * h[:, None]
        v, slides = speeds @ turning, 2 * (speeds @ turning) * (speeds @ sliding) + bends @ sliding
        swing = v**2 + bends @ turning
        M = np.outer(alike + far * points, swing) + np.outer(points, slides) + np.abs(W[:, 16:]) @ bends.T
        E = M * h**2 / 2
        t = np.clip(0.5 - (B - A) / np.maximum(2 * E, 1e-300), 0, 1)
        cut = ((1 - t) * A + t * B - E * t * (1 - t) <= -2 * SLACK).any(axis=0)
        left, right = np.concatenate([left[cut], middle[cut]]), np.concatenate([middle[cut], right[cut]])
