"""Checks the evidence in a plan file: that what it claims of each motion follows from the trail of its proof.

    python verify.py plan.json

One file, numpy alone; nothing here searches. A trail names stretches of the curve, pairs of convex pieces, and at both
ends of each stretch a direction between the two. This file puts the pieces there, measures, and compares.

A unit direction n from b to a shows that two pieces are at least ``min n.a - max n.b`` apart, over all their points. If
from one end of a stretch to the other no point of the one moves by more than m against the other, then gaps g before
and h after leave at least ``min(g, h, (g + h - m) / 2)`` in between, and one of them alone at least ``g - m``
(Schwarzer, Saha and Latombe, IEEE T-RO 21(3), 2005).

How m is bounded: joint k of the chain that carries a piece turns it by an angle t_k, along arcs no longer than r_k t_k,
r_k being the largest distance of its points from axis k meanwhile. Only the joints beyond k change r_k, and these move
the piece by at most the sum of theirs, m_k; so ``r_k <= (r_k at one end + r_k at the other + m_k) / 2``, from the tool
inwards. Two pieces of the robot move against each other by the joints that carry only one of them.

A constraint has no trail: ``kept`` says how it is shown. Not checked: the timing along the curve; where in the hand an
object is taken; pairs that the file declares to be no concern, which are listed; and that the robot and the scene in
the file are those in the room: compare the digests.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import sys
import zlib
from collections.abc import Iterator
from functools import cache
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np

Array = Any
Json = Any

ROUNDING = 2e-8  # metres: directions are written to nine digits
SLACK = 1e-9  # of joints, places and constraints: rounding
MOST_BYTES, MOST_STRETCHES = 200_000_000, 200_000


class Invalid(Exception):
    """Why a file proves nothing."""


def require(holds: Any, why: str) -> None:
    if not np.all(holds):
        raise Invalid(why)


def unpacked(text: str, kind: str, columns: int, *, small: bool = True) -> Array:
    """A table (k, columns) from base64 of little-endian bytes, compressed if ``small``."""
    data = base64.b64decode(text, validate=True)
    data = zlib.decompressobj().decompress(data, MOST_BYTES) if small else data
    array = np.frombuffer(data, kind).reshape(-1, columns)
    require(np.isfinite(array), "a table holds a number that is not finite")
    return array


def digest(record: Json) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


# Frames (4, 4), the solids in them, and the bodies of a robot


def frame(R: Any, t: Any) -> Array:
    T = np.vstack([np.column_stack([R, t]), [0, 0, 0, 1]]).astype(float)
    require(np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)) < SLACK, "a frame that is no rotation")
    return T


def turned(axis: Any, sine: Any, versine: Any) -> Array:
    """Rotations (..., 3, 3) about a unit vector; about a shorter one if sine and versine are larger (Rodrigues)."""
    K = np.cross(np.eye(3), np.array(axis, float))
    return np.eye(3) + sine * K + versine * (K @ K)


def pose(record: Json) -> Array:
    w, *axis = np.array(record["quaternion_wxyz"], float) / np.linalg.norm(record["quaternion_wxyz"])
    return frame(turned(axis, 2 * w, 2.0), record["position"])


def matrix(rows: Json) -> Array:
    return frame(*np.split(np.array(rows, float)[:3], [3], axis=1))


class Piece(NamedTuple):
    """The hull of points, each with a ball around it and a disc square to an axis, in the frame of a body."""

    points: Array
    axis: Array
    ball: float
    disc: float

    @property
    def around(self) -> float:
        """The radius of a ball about the mean of its points that holds it."""
        far = np.linalg.norm(self.points - self.points.mean(axis=0), axis=1).max()
        return math.hypot(far, self.disc) + self.ball


def pieces(name: str, solid: Json, at: Array, boxes: Json) -> list[Piece]:
    """The convex pieces of a solid in the order in which a trail numbers them."""
    kind, length, r = solid["kind"], float(solid.get("length", 0.0)), float(solid.get("radius", 0.0))
    if kind == "compound":
        parts = [(part["shape"], at @ pose(part["pose"])) for part in solid["parts"]]
        return [piece for shape, T in parts for piece in pieces(name, shape, T, boxes)]
    if kind in ("cloud", "heights"):
        rows, (low, high) = unpacked(boxes[name], "<f8", 6).reshape(-1, 2, 3), cells(solid)
        left = np.ones(len(low), bool)
        for row in rows:
            left &= ((low < row[0] - SLACK) | (high > row[1] + SLACK)).any(axis=1)
        require(~left, f"{name}: the boxes of the evidence leave some of it out")
        hulls = [corners(*row) for row in rows]
    elif kind == "mesh":
        hulls = [unpacked(solid["vertices"], "<f8", 3, small=False)]
    else:
        require(kind in ("box", "sphere", "capsule", "cylinder") and r >= 0, f"{name}: no such solid: {kind}")
        half = np.array(solid["size"] if kind == "box" else [0, 0, length], float) / 2
        hulls = [corners(-half, half)]
    ball, disc = (0.0, r) if kind == "cylinder" else (r, 0.0)
    return [Piece(hull @ at[:3, :3].T + at[:3, 3], at[:3, 2], ball, disc) for hull in hulls]


def corners(low: Array, high: Array) -> Array:
    return np.unique([*product(*zip(low, high, strict=True))], axis=0)


def cells(solid: Json) -> tuple[Array, Array]:
    """Lower and upper corners (k, 3) of the cells of a cloud, or of the columns of a height field."""
    if solid["kind"] == "cloud":
        low, size = unpacked(solid["cells"], "<i8", 3, small=False), solid["resolution"]
        return low * size, (low + 1) * size
    tops, floor, size = unpacked(solid["heights"], "<f8", solid["columns"], small=False), solid["floor"], solid["cell"]
    at, tops = np.argwhere(tops > floor), tops[tops > floor]
    return np.column_stack([at * size, tops * 0 + floor]), np.column_stack([(at + 1) * size, tops])


class Body(NamedTuple):
    """What a joint moves: ``times`` q[column], about or along ``axis``; at rest its frame is ``at`` in the parent's."""

    parent: int
    at: Array
    axis: Any
    slides: bool
    column: int
    times: float = 1.0


def placed(bodies: list[Body], q: Array) -> list[Array]:
    """Frames (m, 4, 4) of all bodies at configurations q (m, n)."""
    out = [np.tile(np.eye(4), (len(q), 1, 1))]
    for body in bodies[1:]:
        T, x = np.tile(np.eye(4), (len(q), 1, 1)), q[:, body.column, None] * body.times
        if body.slides:
            T[:, :3, 3] = x * body.axis
        else:
            T[:, :3, :3] = turned(body.axis, np.sin(x)[:, None], 1 - np.cos(x)[:, None])
        out.append(out[body.parent] @ body.at @ T)
    return out


def chain(bodies: list[Body], body: int) -> list[int]:
    """Bodies from one inwards, without the base."""
    return [body, *chain(bodies, bodies[body].parent)] if body > 0 else []


class Curve:
    """Waypoints joined by lines; a corner with a blend of width d has instead, from d before to d after it, the tangent
    ``u + (v - u) f(y)``, ``f(y) = 1/2 + (5 y - y^5) / 8``, y from -1 to 1: a joint turns back on it at most once.

    ``places`` are such that between one and the next all joints move one way, on one line or blend.
    """

    def __init__(self, waypoints: Array, blends: Json):
        self.points, steps = waypoints, np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
        knots, d = np.cumsum([0.0, *steps]), np.array([*blends] or [0.0] * len(waypoints), float)
        fits = len(d) == len(knots) > 1 and (d >= 0).all() and not d[[0, -1]].any()
        require(fits and (d[1:] + d[:-1] <= steps * (1 + SLACK)).all(), "no curve, or blends that overlap")
        tangents = np.diff(waypoints, axis=0) / np.maximum(steps, 1e-300)[:, None]
        self.first, self.bends, self.length = tangents[0], np.diff(tangents, axis=0), knots[-1]
        self.corners, self.d, u = knots[1:-1], d[1:-1], tangents[:-1]
        low, high = -np.ones_like(u), np.ones_like(u)
        for _ in range(60):  # to where a joint turns back, if it does
            y = (low + high) / 2
            ahead = u * (u + self.bends * (0.5 + (5 * y - y**5) / 8)) > 0
            low, high = np.where(ahead, y, low), np.where(ahead, high, y)
        ends = [*knots, *(self.corners - self.d), *(self.corners + self.d)]
        self.places = np.unique([*ends, *(self.corners[:, None] + self.d[:, None] * low).ravel()])
        self.walked = np.cumsum(np.abs(np.diff(self.at(self.places), axis=0, prepend=waypoints[:1])), axis=0)

    def at(self, s: Array, order: int = 0) -> Array:
        """Configurations at places s (m,), or tangents there."""
        x = s[:, None] - self.corners
        y = np.clip(x / np.maximum(self.d, 1e-300), -1, 1)
        if order:
            return self.first + (0.5 + (5 * y - y**5) / 8) @ self.bends
        area = (y + 1) / 2 + (y**2 - 1) * 5 / 16 - (y**6 - 1) / 48  # the integral of f from -1 to y
        return self.points[0] + s[:, None] * self.first + (self.d * area + np.maximum(x - self.d, 0)) @ self.bends

    def travelled(self, s: Array) -> Array:
        """How far each joint has moved from the start to places s (m,), back and forth, (m, n)."""
        k = np.maximum(np.searchsorted(self.places, s, "right") - 1, 0)
        return self.walked[k] + np.abs(self.at(s) - self.at(self.places)[k])


class Solid(NamedTuple):
    """The pieces ``first`` to ``end - 1``, on a body; ``home`` is the body that carries them while fingers stand."""

    name: str
    body: int
    home: int
    first: int
    end: int
    record: Json
    at: Array


class World:
    """The solids of a robot, of what it holds and of what stands around it; a trail numbers their pieces in this order.

    The fingers are moved by one more joint; a file says how far, and ``stands`` compares that with the width. In a
    trail of the gripper alone they come after the robot's other shapes.
    """

    def __init__(self, robot: Json, obstacles: Json, held: Json, allowed: Json, boxes: Json, *, alone: bool = False):
        self.alone, self.arm, self.column = alone, len(robot["bodies"]), len(robot["joint_names"])
        self.boxes, self.solids, self.pieces, self.bodies = boxes, list[Solid](), list[Piece](), list[Body]()
        for k, b in enumerate(robot["bodies"]):
            require(b["parent"] < max(k, 1) and (b["parent"] >= 0 or k == 0), "a body before its parent")
            moves = b["axis"], b["prismatic"], b["q_index"], b.get("multiplier", 1.0)
            self.bodies.append(Body(b["parent"], matrix(b["placement"]), *moves))
        self.grip = {"kind": "parallel", "links": [], "closed": [], **(robot["gripper"] or {})}
        hands = [*self.fingers()]
        require([abs(np.linalg.norm(b.axis) - 1) < SLACK for b in self.bodies[1:]], "an axis that is no unit vector")
        links, objects = {shape["link"] for shape in robot["shapes"]}, [item["name"] for item in (*obstacles, *held)]
        require(len(set(objects)) == len(objects), "two objects of one name")
        self.twice = links.intersection(objects)
        for shape in sorted(robot["shapes"], key=lambda shape: alone and shape["link"] in self.grip["links"]):
            at = shape["shape"], shape["body"], pose(shape["pose"])
            self.add("link", shape["link"], *(hands.pop(0) if shape["link"] in self.grip["links"] else at), at[1])
        self.held, (body, at) = len(self.pieces), (robot["tool_body"], matrix(robot["tool_placement"]))
        self.tool = body, at
        for item in held:
            self.add("object", item["name"], item["shape"], body, at @ pose(item["pose"]), body)
        self.riding = len(self.pieces)
        for item in obstacles:
            self.add("object", item["name"], item["shape"], 0, pose(item["pose"]), 0)
        contacts = [(("link", a), ("link", b)) for a, b in (each["links"] for each in robot["allowed_contacts"])]
        contacts += [(("object", item["name"]), ("link", link)) for item in held for link in item["touch_links"]]
        labels = [(self.label(*one), self.label(*two)) for one, two in contacts]
        self.may_touch = {frozenset(pair) for pair in (*labels, *allowed)}
        self.starts = np.cumsum([0, *(len(piece.points) for piece in self.pieces)])
        every = [(*point, *piece.axis, piece.ball, piece.disc) for piece in self.pieces for point in piece.points]
        self.points, self.axes, self.balls, self.discs = np.split(np.array(every).reshape(-1, 8), [3, 6, 7], axis=1)

    def fingers(self) -> Iterator[tuple[Json, int, Array]]:
        """Solid, body and frame in it of each shape of a finger; adds the bodies that the one more joint moves."""
        for k, shape in enumerate(self.grip["closed"]):
            body, at = shape["body"], np.zeros(3)
            if self.grip["kind"] == "revolute":
                joints = [(np.array(j["point"], float), j["axis"], False, j["ratio"]) for j in self.grip["turns"][k]]
            else:  # a cup moves along none
                joints = [(at, axis, True, 1.0) for axis in self.grip["directions"][k : k + 1]]
            for point, axis, slides, times in joints:
                self.bodies.append(Body(body, frame(np.eye(3), point - at), axis, slides, self.column, times))
                body, at = len(self.bodies) - 1, point
            yield shape["shape"], body, frame(np.eye(3), -at) @ pose(shape["pose"])

    def add(self, kind: str, name: str, solid: Json, body: int, at: Array, home: int) -> None:
        require(0 <= body < len(self.bodies), f"{name}: on a body that is not there")
        first, found = len(self.pieces), pieces(name, solid, at, self.boxes)
        self.pieces += found
        self.solids.append(Solid(self.label(kind, name), body, home, first, first + len(found), solid, at))

    def label(self, kind: str, name: str) -> str:
        plain = name not in self.twice and not name.endswith((" (link)", " (object)"))
        return name if plain else f"{name} ({kind})"

    def wanted(self) -> Iterator[tuple[Solid, Solid]]:
        """Those that must be apart: an obstacle from what a joint moves, parts of the robot that are on different
        bodies, and what is held from all of it. If the gripper alone moves: what belongs to a finger."""
        for one, two in combinations(self.solids, 2):
            apart = two.first >= self.held or one.home != two.home
            if two.first >= self.riding:
                apart = one.first < self.riding and (one.body if self.alone else one.home) > 0
            apart &= one.name != two.name and frozenset((one.name, two.name)) not in self.may_touch
            if apart and (not self.alone or max(one.body, two.body) >= self.arm):
                yield one, two

    def step(self, body: Body, curve: Curve) -> float:
        """How far a body's origin is from that of its parent at most."""
        slide = abs(body.times) * np.abs(curve.points[:, body.column]).max() if body.slides else 0.0
        return float(np.linalg.norm(body.at[:3, 3]) + slide)

    def reach(self, first: int, end: int, n: Array, T: Array) -> Array:
        """How far pieces of one body reach along unit vectors n (k, 3) if the body is at T (k, 4, 4), (k,)."""
        k, own = slice(self.starts[first], self.starts[end]), (n[:, None] @ T[:, :3, :3])[:, 0]
        reach = own @ self.points[k].T + self.balls[k, 0]
        if self.discs[k].any():
            reach += self.discs[k, 0] * np.sqrt(np.maximum(1 - (own @ self.axes[k].T) ** 2, 0))
        return reach.max(axis=1) + (n * T[:, :3, 3]).sum(1)

    def stands(self, x: float, width: float) -> bool:
        """Whether fingers that have moved by x leave this width between them."""
        grip, gap = self.grip, 2 * x
        if grip["kind"] == "revolute":
            (near, far), at = grip["positions"], placed(self.bodies, np.append(np.zeros(self.column), x)[None])
            if not grip["lower"] < width < grip["upper"]:
                return bool(abs(x - (near if width <= grip["lower"] else far)) < SLACK)
            tips = [[solid for solid in self.solids if solid.name == self.label("link", tip)] for tip in grip["tips"]]
            n = (at[tips[0][0].home][0, :3, :3] @ grip["across"])[None]
            gap = -sum(
                max(self.reach(tip.first, tip.end, sign * n, at[tip.body])[0] for tip in those)
                for sign, those in zip((1, -1), tips, strict=True)
            )
            gap = gap if min(near, far) <= x <= max(near, far) else math.nan
        return not grip["closed"] or bool(abs(gap - width) < SLACK)


# Whether a trail proves it


def shown(world: World, proof: Json, curve: Curve, begin: float, end: float) -> float:
    """The clearance that a trail shows between two places of a curve, metres; it must be what is claimed.

    It has places s on the curve, and rows (pair, place, a later place, direction, direction).
    """
    claimed = 1e9 if proof["clearance"] is None else float(proof["clearance"])
    require(claimed > float(proof["padding"]) >= 0, "a clearance that is no more than the padding")
    s, pairs = unpacked(proof["s"], "<f8", 1)[:, 0], unpacked(proof["pairs"], "<i4", 3).astype(int)
    reaches = len(s) > 1 and abs(s[0] - begin) < SLACK and abs(s[-1] - end) < SLACK
    require(reaches, "the trail does not reach from end to end")
    rows, n = np.split(unpacked(proof["rows"], "<i4", 9).astype(int), [3], axis=1)
    n = n.reshape(-1, 2, 3) / 2.0**30
    length = np.linalg.norm(n, axis=2)
    require(np.minimum(length, np.abs(length - 1)) < 1e-6, "a direction that is no unit vector")
    ordered = (np.diff(s) >= 0).all() and (rows[:, 1] >= 0).all() and (rows[:, 1] < rows[:, 2]).all()
    require(ordered, "places in disorder")
    at, moved, n = placed(world.bodies, curve.at(s)), curve.travelled(s), n / np.maximum(length, 0.5)[:, :, None]
    of = [solid for solid in world.solids for _ in range(solid.first, solid.end)]

    @cache
    def radii(piece: int, body: int) -> Array:
        """How far points of a piece are from the axis of a body, at most, at every place.

        With c from the axis to the centre, square to it, and w from there to a point, what of c + w is across the axis
        has a square of at most c.c + 2 c.w + w.w.
        """
        it, T, B = world.pieces[piece], at[of[piece].body], at[body]
        z, centre = B[:, :3, :3] @ world.bodies[body].axis, T[:, :3, :3] @ it.points.mean(axis=0) + T[:, :3, 3]
        c = centre - B[:, :3, 3]
        c -= (c * z).sum(1)[:, None] * z
        far = np.linalg.norm(c, axis=1)
        u = c / np.maximum(far, 1e-300)[:, None]
        return np.sqrt(far**2 + 2 * far * (world.reach(piece, piece + 1, u, T) - (u * centre).sum(1)) + it.around**2)

    def motion(piece: int, other: int, left: Array, right: Array) -> Array:
        """How far points of a piece move from places to others by the joints that do not move the other piece.

        However the joints stand, no point is farther from the next axis than ``far``: steps along the chain, added up.
        """
        it, solid, m = world.pieces[piece], of[piece], np.zeros(len(left))
        start = solid.body if world.alone else solid.home
        middle = np.linalg.inv(at[start][0]) @ at[solid.body][0] @ np.append(it.points.mean(axis=0), 1)
        far = np.linalg.norm(middle[:3]) + it.around
        for k in chain(world.bodies, start):
            body = world.bodies[k]
            if k not in chain(world.bodies, of[other].body):
                t = abs(body.times) * (moved[right, body.column] - moved[left, body.column])
                r = np.minimum((radii(piece, k)[left] + radii(piece, k)[right] + m) / 2, far)
                m = m + t * (1.0 if body.slides else r)
            far += world.step(body, curve)
        return m

    least, (one, two, count), faults = math.inf, pairs.T, list[tuple[float, str]]()
    for first, second in world.wanted():
        apart = np.full((first.end - first.first, second.end - second.first, len(s) - 1), -math.inf)
        inside = (one >= first.first) & (one < first.end) & (two >= second.first) & (two + count <= second.end)
        for number in np.flatnonzero(inside & (count > 0) & ((count == 1) | (second.first >= world.riding))):
            (a, b, many), on = pairs[number], np.flatnonzero(rows[:, 0] == number)
            left, right = rows[on, 1:].T
            m, gaps = motion(a, b, left, right) + motion(b, a, left, right), list[Array]()
            for k, place in enumerate((left, right)):
                A, B, x = at[first.body][place], at[second.body][place], n[on, k]
                gap = -world.reach(a, a + 1, -x, A) - world.reach(b, b + many, x, B)
                gaps.append(np.where(length[on, k] > 0.5, gap, -math.inf))
            g, h = gaps
            bound = np.maximum(np.minimum(np.minimum(g, h), (g + h - m) / 2), np.maximum(g, h) - m)
            for low, high, gap in zip(left, right, bound, strict=True):
                part = apart[a - first.first, b - second.first : b - second.first + many, low:high]
                np.maximum(part, gap, out=part)
        sure = apart.min(axis=(0, 1), initial=math.inf)
        for each in proof["exempt"]:
            if {first.name, second.name} in map(set, each["pairs"]):
                sure[(s[:-1] >= each["s_start"] - SLACK) & (s[1:] <= each["s_end"] + SLACK)] = math.inf
        least = min(least, sure.min())
        for k in np.flatnonzero(~(sure >= claimed - ROUNDING))[:1]:
            where = f"{first.name} x {second.name} from s = {s[k]:.9g} to {s[k + 1]:.9g}"
            found = f"{sure[k] * 1e3:.4f} mm are shown" if sure[k] > -math.inf else "nothing is shown"
            faults.append((s[k], f"{where}: {found}, {claimed * 1e3:.4f} mm claimed"))
    require(not faults, min(faults, default=(0.0, ""))[1])
    return float(least)


def kept(world: World, robot: Json, constraint: Json, curve: Curve, begin: float, end: float) -> None:
    """Show that a constraint holds between two places of a curve.

    It is written as functions of s that must not be negative. On a stretch of length h such a function, A and B at its
    ends, is at least ``(1 - t) A + t B - M t (1 - t) h^2 / 2`` at the share t of it, M bounding the second derivative;
    a stretch on which that may be negative is cut in half. With v and a the sums of speeds and accelerations of the
    joints between the two frames, M is v^2 + a for a direction, thrice that for three, and for a point r (v^2 + a), r
    being the farthest that it can be from these joints; where one slides, 2 v v' + a' are added.

    The turn psi about z follows from ``cos psi (1 + Q_zz) = Q_xx + Q_yy``.
    """
    cuts = np.array([begin, *curve.places[(curve.places > begin) & (curve.places < end)], end])
    if constraint["kind"] == "joint range":
        q = curve.at(cuts)[:, robot["joint_names"].index(constraint["joint"])]
        inside = (q >= constraint["lower"] - SLACK) & (q <= constraint["upper"] + SLACK)
        require(inside, f"{constraint['joint']} is not kept in its range")
        return
    frames = {each["link"]: (each["body"], pose(each["pose"])) for each in robot.get("link_frames", [])}
    b, tool = world.tool if constraint["link"] is None else frames[constraint["link"]]
    c, base = (0, np.eye(4)) if constraint["relative_to"] is None else frames[constraint["relative_to"]]
    tool, base = tool @ pose(constraint["tool"]), base @ pose(constraint["frame"])
    turning, sliding = np.zeros((2, len(curve.first)))
    far = np.linalg.norm(tool[:3, 3]) + np.linalg.norm(base[:3, 3])
    for body in (world.bodies[k] for k in set(chain(world.bodies, b)) ^ set(chain(world.bodies, c))):
        (sliding if body.slides else turning)[body.column] += abs(body.times)
        far += world.step(body, curve)
    edges = [(1, k, -edge) for k, edge in enumerate(constraint["lower"]) if edge is not None]
    edges += [(-1, k, edge) for k, edge in enumerate(constraint["upper"]) if edge is not None]
    angles = [(name, constraint[name]) for name in ("tilt", "turn") if constraint[name] not in (None, math.pi)]
    require([0 < angle < math.pi for _, angle in angles], f"{constraint['name']}: no such angle")
    steep = {name: max(math.sin(min(angle, math.pi / 2)), 1e-6) for name, angle in angles}
    bends_of = [(far, 1)] * len(edges) + [({"tilt": 1, "turn": 3}[name] / steep[name], 0) for name, _ in angles]
    weights, points = np.array(bends_of).reshape(-1, 2).T[:, :, None]

    def values(s: Array) -> Array:
        """What must not be negative, (k, m): of points, of the tilt and of the turn."""
        bodies = placed(world.bodies, curve.at(s))
        T = (np.linalg.inv(bodies[c] @ base) @ bodies[b] @ tool).transpose(1, 2, 0)
        cosines = {"tilt": (T[2, 2], 1), "turn": (T[0, 0] + T[1, 1], 1 + T[2, 2])}
        aside = [(cosines[name][0] - math.cos(angle) * cosines[name][1]) / steep[name] for name, angle in angles]
        return np.array([*(sign * T[k, 3] + edge for sign, k, edge in edges), *aside]).reshape(-1, len(s))

    left, right, looked = cuts[:-1], cuts[1:], 0
    while len(left):
        A, B, h, middle, looked = values(left), values(right), right - left, (left + right) / 2, looked + len(left)
        where = f"{constraint['name']} is not kept from s = {left[0]:.9g} to {right[-1]:.9g}"
        require(looked < MOST_STRETCHES and (A > -2 * SLACK).all() and (B > -2 * SLACK).all(), where)
        bends = (np.abs(middle[:, None] - curve.corners) < curve.d) * 0.625 / np.maximum(curve.d, 1e-300)
        bends = bends @ np.abs(curve.bends)  # at most abs(q''); f' is at most 0.625
        speeds = np.abs(curve.at(middle, 1)) + bends * h[:, None] / 2
        v, slides = speeds @ turning, 2 * (speeds @ turning) * (speeds @ sliding) + bends @ sliding
        E = (weights * (v**2 + bends @ turning) + points * slides) * h**2 / 2
        t = np.clip(0.5 - (B - A) / np.maximum(2 * E, 1e-300), 0, 1)
        cut = ((1 - t) * A + t * B - E * t * (1 - t) <= -2 * SLACK).any(axis=0)
        left, right = np.concatenate([left[cut], middle[cut]]), np.concatenate([middle[cut], right[cut]])


# The file


def motions(document: Json) -> Iterator[tuple[str, Json, float, Json, Json]]:
    """Each motion of a plan or a task: name, result, width of the gripper, obstacles, what is held."""
    scene, alone = document["scene"], {"name": "motion", "scene": None, "gripper_width": None}
    first = {item["name"]: item for item in scene["obstacles"]}
    for segment in document.get("segments") or [{**alone, "result": document["result"]}]:
        scene = segment["scene"] or scene
        obstacles = [first[item] if isinstance(item, str) else item for item in scene["obstacles"]]
        width = segment["gripper_width"]
        width = document["robot"]["gripper_width"] if width is None else width
        yield segment["name"], segment["result"], width, obstacles, scene["attached"]


def verify(document: Json) -> Iterator[str]:
    """What a plan file's evidence shows, line by line; Invalid if that is not all that the file claims."""
    robot, section, allowed = document["robot"], document["sections"]["evidence"], document["allowed"]
    require(document["version"] == 3 and section["version"] == 2, "another version")
    for part in ("robot", "scene"):
        require(section[part] == digest(document[part]), f"the evidence is for another {part}")
        yield f"{part} {section[part]}"
    proofs, before, ends, whole = [*section["proofs"]], robot["gripper_width"], None, [*motions(document)]
    scene, endless, stood = [*whole[0][3:]], np.array(robot.get("continuous") or [False]), None
    lower, upper = (np.array(robot["limits"][name], float) for name in ("lower", "upper"))
    for number, (name, result, width, *after) in enumerate(whole):
        points, claim = np.array(result["path"]["waypoints"], float), result["certificate"]
        inside = (points >= lower - SLACK) & (points <= upper + SLACK) | endless
        require(inside, f"{name}: a joint leaves its limits")
        require(ends is None or np.abs(points[0] - ends) < SLACK, f"{name}: begins elsewhere")
        was, now = ({item["name"]: item["shape"] for item in (*stand, *hold)} for stand, hold in (scene, after))
        moved = any(old != new for old in scene[0] for new in after[0] if old["name"] == new["name"])
        require(was == now and not moved, f"{name}: the scene changes by more than what is taken or left")
        for alone in (True, False) if robot["gripper"] and before != width else (False,):
            proof, words = proofs.pop(0), "gripper before " * alone + name
            widths, (stand, hold) = [before if alone else width, width], scene if alone else after
            require(proof["motion"] == number and proof["gripper"] == widths, f"{words}: the evidence is for another")
            world, fingers = World(robot, stand, hold, allowed, section["boxes"], alone=alone), proof["moved"]
            fits = (alone or fingers[0] == fingers[1]) and stood in (None, fingers[0])
            require(fits and all(map(world.stands, fingers, widths)), f"{words}: fingers elsewhere")
            q, stood = points[[0, 0]] if alone else points, fingers[1]
            moves = np.linspace(*fingers, len(q))[:, None]
            curve = Curve(np.hstack([q, moves]), [] if alone else result["path"]["blends"])
            begin, end = proof["part"] or (0.0, curve.length)
            require(0 <= begin <= end <= curve.length + SLACK, f"{words}: a part that is not on the path")
            constraints = []
            try:
                least = shown(world, proof, curve, begin, end)
                if not alone:
                    same = all(claim[key] == proof[key] for key in ("clearance", "padding", "exempt", "part"))
                    require(same, "the certificate claims something else")
                    carried = [each for item in after[1] for each in item.get("constraints", ())]
                    asked = (document["request"] or {}).get("constraints", ())
                    constraints = [*result.get("constraints", ()), *asked, *carried]
                for constraint in constraints:
                    kept(world, robot, constraint, curve, begin, end)
            except Invalid as why:
                raise Invalid(f"{words}: {why}") from None
            yield f"{words}: {1e3 * least:.4f} mm" + f", {len(constraints)} constraints kept" * bool(constraints)
            if proof["part"]:
                yield f"  judged from s = {begin:.6g} to {end:.6g} alone"
            for each in proof["exempt"]:
                where = f"from s = {each['s_start']:.6g} to {each['s_end']:.6g}"
                yield f"  not judged {where}: {each['pairs']} ({each['reason']})"
            for item in hold:
                yield f"  not judged: {item['name']}, which is held, with {item['touch_links']}"
        before, scene, ends = width, after, points[-1]
    require(not proofs, "proofs of motions that are not in the file")
    body = {shape["link"]: shape["body"] for shape in robot["shapes"]}
    for contact in robot["allowed_contacts"]:
        a, b = (body.get(link, -1) for link in contact["links"])
        beside = a >= 0 <= b and (a == b or robot["bodies"][a]["parent"] == b or robot["bodies"][b]["parent"] == a)
        yield f"never judged: {contact['links']} ({'neighbours' if beside else contact['reason']})"
    yield from (f"never judged: {pair} (allowed by the author)" for pair in allowed)


def main(arguments: list[str], others: Json = ()) -> int:
    """Print what a file's evidence shows, then VALID or INVALID; 0 or 1. Files of other formats have other judges."""
    try:
        with open(arguments[0], "rb") as file:
            document = json.loads(file.read(MOST_BYTES))
        for line in dict(others).get(document.get("format"), verify)(document):
            print(line)
        print("VALID")
        return 0
    except Invalid as why:
        print(f"INVALID: {why}")
    except Exception as error:  # whatever a file is made of: it proves nothing
        print(f"INVALID: not a plan file with evidence ({type(error).__name__}: {error})")
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
