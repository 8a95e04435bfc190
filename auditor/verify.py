"""Checks the evidence in a plan file: that what it claims of each motion follows from the trail of its proof.

    python verify.py plan.json

One file, numpy alone; nothing here searches. A trail names stretches of the curve, pairs of convex pieces, and at the
ends of each stretch a direction between the two. This file puts the pieces there, measures, and compares.

A unit direction n from b to a shows that two pieces are at least ``min n.a - max n.b`` apart, over all their points. If
from one end of a stretch to the other no point of the one moves by more than m against the other, then gaps g before
and h after leave at least ``min(g, h, (g + h - m) / 2)`` in between, and one of them alone at least ``g - m``
(Schwarzer, Saha and Latombe, IEEE T-RO 21(3), 2005).

How m is bounded: joint k of the chain that carries a piece turns it by an angle t_k, along arcs no longer than r_k t_k,
r_k being the largest distance of its points from axis k meanwhile. Only the joints beyond k change r_k, and these move
the piece by at most the sum of theirs, m_k; so ``r_k <= (r_k at one end + r_k at the other + m_k) / 2``, from the tool
inwards. Two pieces of the robot move against each other by the joints that carry only one of them.

Not checked: the timing along the curve; pairs that the file declares to be no concern, which are listed; and that the
robot and the scene in the file are those in the room: compare the digests.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import sys
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

__all__ = ["Invalid", "main", "verify"]

Array = Any
Json = Any
Frame = tuple[Array, Array]  # a rotation (3, 3) and an origin (3,)

ROUNDING = 1e-8  # metres: directions are written to nine digits
SLACK = 1e-9  # of joints, places and constraints: rounding
UNIT = 2.0**30  # a direction's length in a table
MOST_BYTES, MOST_STRETCHES = 200_000_000, 200_000
STILL: Frame = (np.eye(3), np.zeros(3))


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


def joined(a: Frame, b: Frame) -> Frame:
    return a[0] @ b[0], a[0] @ b[1] + a[1]


def pose(record: Json) -> Frame:
    w, x, y, z = q = np.array(record["quaternion_wxyz"], float) / np.linalg.norm(record["quaternion_wxyz"])
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    require(np.isfinite(q), "a quaternion of length 0")
    return np.eye(3) + 2 * (w * K + K @ K), np.array(record["position"], float)


# Solids


class Piece:
    """The hull of points, each with a ball around it and a disc square to an axis, in the frame of what carries it."""

    def __init__(self, points: Array, ball: float = 0.0, disc: float = 0.0, axis: Any = (0, 0, 1), at: Frame = STILL):
        self.points, self.ball, self.disc, self.axis = points @ at[0].T + at[1], ball, disc, at[0] @ np.array(axis)
        self.centre = self.points.mean(axis=0)
        self.radius = math.hypot(np.linalg.norm(self.points - self.centre, axis=1).max(), disc) + ball

    def extent(self, n: Array) -> Array:
        """How far it reaches along directions (k, 3) of any length."""
        far = (n @ self.points.T).max(axis=1) + self.ball * np.linalg.norm(n, axis=1)
        return far + self.disc * np.linalg.norm(np.cross(n, self.axis), axis=1) if self.disc else far


def corners(low: Array, high: Array) -> Array:
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])


def pieces(name: str, solid: Json, at: Frame, boxes: Json) -> list[Piece]:
    """The convex pieces of a solid in the order in which a trail numbers them."""
    kind, r = solid["kind"], float(solid.get("radius", 0.0))
    require(r >= 0, f"{name}: a negative radius")
    ends = np.array([[0, 0, -0.5], [0, 0, 0.5]]) * float(solid.get("length", 0.0))
    if kind == "compound":
        parts = [(part["shape"], joined(at, pose(part["pose"]))) for part in solid["parts"]]
        return [piece for shape, frame in parts for piece in pieces(name, shape, frame, boxes)]
    if kind in ("cloud", "heights"):
        rows = unpacked(boxes[name], "<f8", 6)
        require(held(solid, rows), f"{name}: the boxes of the evidence leave some of it out")
        return [Piece(corners(row[:3], row[3:]), at=at) for row in rows]
    if kind == "mesh":
        return [Piece(unpacked(solid["vertices"], "<f8", 3, small=False), at=at)]
    if kind == "box":
        return [Piece(corners(-0.5 * np.array(solid["size"]), 0.5 * np.array(solid["size"])), at=at)]
    require(kind in ("sphere", "capsule", "cylinder"), f"{name}: a solid of unknown kind {kind}")
    return [Piece(ends, **{"disc" if kind == "cylinder" else "ball": r}, at=at)]


def held(solid: Json, rows: Array) -> bool:
    """Whether boxes hold every cell of a cloud, or every column of a height field."""
    low: Array
    size: Array
    if solid["kind"] == "cloud":
        low = unpacked(solid["cells"], "<i8", 3, small=False).astype(float)
        high, size = low + 1, np.full(3, float(solid["resolution"]))
    else:
        heights = unpacked(solid["heights"], "<f8", solid["columns"], small=False)
        at, tops = np.argwhere(heights > solid["floor"]), heights[heights > solid["floor"]]
        low = np.column_stack([at, np.full(len(at), solid["floor"])])
        high, size = np.column_stack([at + 1, tops]), np.array([solid["cell"], solid["cell"], 1.0])
    left = np.ones(len(low), bool)
    for row in rows:
        left &= ~((row[:3] / size <= low + SLACK).all(1) & (row[3:] / size >= high - SLACK).all(1))
    return not left.any()


# The robot, and the curve in joint space


class Body:
    """What a joint moves: ``times`` q[column], about or along ``axis``; at rest its frame is ``at`` in the parent's."""

    def __init__(self, parent: int, at: Frame, axis: Any, slides: bool, column: int, times: float = 1.0):
        self.parent, self.at, self.axis, self.slides = parent, at, np.array(axis, float), slides
        self.column, self.times, (x, y, z) = column, times, axis
        require(parent < 0 or abs(np.linalg.norm(self.axis) - 1) < SLACK, "an axis that is no unit vector")
        require(np.abs(at[0] @ at[0].T - np.eye(3)) < SLACK, "a placement that is no rotation")
        self.K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def placed(bodies: list[Body], q: Array) -> list[Frame]:
    """Rotations (m, 3, 3) and origins (m, 3) of all bodies at configurations q (m, n)."""
    out: list[Frame] = [(np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3)))]
    for body in bodies[1:]:
        (R, t), x = out[body.parent], (q[:, body.column] * body.times)[:, None]
        R, t = R @ body.at[0], t + R @ body.at[1]
        if body.slides:
            t = t + (R @ body.axis) * x
        else:  # Rodrigues
            R = R @ (np.eye(3) + np.sin(x)[:, None] * body.K + (1 - np.cos(x))[:, None] * (body.K @ body.K))
        out.append((R, t))
    return out


def chain(bodies: list[Body], body: int) -> list[int]:
    """Bodies from one inwards, without the base."""
    return [body, *chain(bodies, bodies[body].parent)] if body > 0 else []


class Curve:
    """Waypoints joined by lines; a corner with a blend of width d has instead, from d before to d after it, the tangent
    ``u + (v - u) f(y)``, ``f(y) = 1/2 + (5 y - y^5) / 8``, y from -1 to 1: a joint turns back on it at most once."""

    def __init__(self, waypoints: Any, blends: Any):
        self.points = np.array(waypoints, float)
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        self.tangents = np.diff(self.points, axis=0) / np.maximum(steps, 1e-300)[:, None]
        self.knots, self.d = np.cumsum([0.0, *steps]), np.array([*blends] or np.zeros(len(steps) + 1), float)
        self.length = self.knots[-1]
        require(
            self.d.shape == self.knots.shape and len(steps) and (self.d >= 0).all(), "no curve: waypoints and blends"
        )
        require((self.d[1:] + self.d[:-1] <= steps * (1 + SLACK)).all() and not self.d[[0, -1]].any(), "blends overlap")
        self.rounded: Array = np.flatnonzero(self.d)
        self.breaks = np.unique([self.knots - self.d, self.knots + self.d])
        places = [np.sort([*self.knots[self.d == 0], *self.turns(j)]) for j in range(self.points.shape[1])]
        at = [self.at(s)[:, j] for j, s in enumerate(places)]
        self.walked = [(s, q, np.cumsum(np.abs(np.diff(q, prepend=q[0])))) for s, q in zip(places, at, strict=True)]

    def turns(self, joint: int) -> Iterator[float]:
        """Where on its blends a joint turns back."""
        for k in self.rounded:
            (u, v), low, high = self.tangents[k - 1 : k + 1, joint], -1.0, 1.0
            for _ in range(60 if u * v < 0 else 0):
                y = (low + high) / 2
                low, high = (y, high) if 0.5 + (5 * y - y**5) / 8 < u / (u - v) else (low, y)
            if u * v < 0:
                yield self.knots[k] + low * self.d[k]

    def at(self, s: Array) -> Array:
        """Configurations at places s (m,)."""
        line = np.clip(np.searchsorted(self.knots, s, "right") - 1, 0, len(self.tangents) - 1)
        q = self.points[line] + self.tangents[line] * (s - self.knots[line])[:, None]
        for k in self.rounded:
            on, d, (u, v) = np.abs(s - self.knots[k]) < self.d[k], self.d[k], self.tangents[k - 1 : k + 1]
            y = ((s[on] - self.knots[k]) / d)[:, None]
            area = (y + 1) / 2 + (y**2 - 1) * 5 / 16 - (y**6 - 1) / 48  # the integral of f from -1 to y
            q[on] = self.points[k] - d * u + d * (u * (y + 1 - area) + v * area)
        return q

    def travelled(self, s: Array) -> Array:
        """How far each joint has moved from the start to places s (m,), back and forth, (m, n)."""
        q, out = self.at(s), np.zeros((len(s), len(self.walked)))
        for j, (places, there, walked) in enumerate(self.walked):
            k = np.maximum(np.searchsorted(places, s, "right") - 1, 0)
            out[:, j] = walked[k] + np.abs(q[:, j] - there[k])
        return out

    def rates(self, s: Array) -> tuple[Array, Array]:
        """Bounds of abs(dq/ds) and abs(d2q/ds2) on the pieces between breaks on which s (m,) are, (m, n) each."""
        line = np.clip(np.searchsorted(self.knots, s, "right") - 1, 0, len(self.tangents) - 1)
        speeds, bends = np.abs(self.tangents[line]), np.zeros((len(s), self.points.shape[1]))
        for k in self.rounded:
            on, (u, v) = np.abs(s - self.knots[k]) < self.d[k], self.tangents[k - 1 : k + 1]
            speeds[on], bends[on] = np.maximum(np.abs(u), np.abs(v)), np.abs(v - u) * 0.625 / self.d[k]
        return speeds, bends


# What is to be proven, and whether a trail proves it


class World:
    """The pieces of a robot, of what it holds and of what stands around it, numbered as a trail numbers them.

    Args:
        width: Of the gripper; if None, its fingers come last and are moved by one more joint.
    """

    def __init__(self, robot: Json, obstacles: Json, attached: Json, allowed: Json, boxes: Json, width: float | None):
        self.bodies, grip = [], robot["gripper"]
        for record in robot["bodies"]:
            T, times = np.array(record["placement"], float), record.get("multiplier", 1.0)
            at = T[:3, :3], T[:3, 3]
            self.bodies.append(
                Body(record["parent"], at, record["axis"], record["prismatic"], record["q_index"], times)
            )
        parents = [body.parent for body in self.bodies]
        require(all(0 <= parent < k for k, parent in enumerate(parents[1:], start=1)), "a body before its parent")
        self.boxes, self.arm, self.column = boxes, len(self.bodies), len(robot["joint_names"])
        self.pieces, self.owner, self.body, self.home = list[Piece](), list[tuple[str, str]](), list[int](), list[int]()
        links, names = {shape["link"] for shape in robot["shapes"]}, {item["name"] for item in (*obstacles, *attached)}
        require(len(names) == len(obstacles) + len(attached), "two objects of one name")
        self.twice, fingers = links & names, set(grip["links"]) if grip else set()
        hands = self.hands = list(self.fingers(grip)) if grip else []
        if grip and width is not None:
            x = self.opened(grip, width)
            hands = [
                (shape["body"], self.standing(hand, shape["body"], x))
                for shape, hand in zip(grip["closed"], hands, strict=True)
            ]
        closed = iter(zip(grip["closed"] if grip else [], hands, strict=True))
        for shape in sorted(robot["shapes"], key=lambda shape: width is None and shape["link"] in fingers):
            home, hand = shape["body"], (shape["body"], pose(shape["pose"]))
            if shape["link"] in fingers:
                shape, hand = next(closed)
            self.add(("link", shape["link"]), shape["shape"], hand, home)
        T, self.held = np.array(robot["tool_placement"], float), len(self.pieces)
        self.tool = robot["tool_body"], (T[:3, :3], T[:3, 3])
        for item in attached:
            hand = self.tool[0], joined(self.tool[1], pose(item["pose"]))
            self.add(("object", item["name"]), item["shape"], hand, self.tool[0])
        self.riding = len(self.pieces)
        for item in obstacles:
            self.add(("object", item["name"]), item["shape"], (0, pose(item["pose"])), -1)
        contacts = [(("link", a), ("link", b)) for a, b in (each["links"] for each in robot["allowed_contacts"])]
        contacts += [(("object", item["name"]), ("link", link)) for item in attached for link in item["touch_links"]]
        self.may_touch = {frozenset(map(self.label, pair)) for pair in contacts} | set(map(frozenset, allowed))
        self.points = np.concatenate([piece.points for piece in self.pieces])
        self.starts = np.cumsum([0, *(len(piece.points) for piece in self.pieces)])
        self.flat = np.array([not piece.ball and not piece.disc for piece in self.pieces])
        self.limits = np.append(np.abs([robot["limits"]["lower"], robot["limits"]["upper"]]).max(axis=0), 100.0)

    def fingers(self, grip: Json) -> Iterator[tuple[int, Frame]]:
        """Fingers as bodies that one more joint moves; of each closed shape its body, and its frame in that."""
        for k, shape in enumerate(grip["closed"]):
            (R, t), body, at = pose(shape["pose"]), shape["body"], STILL[1]
            if grip.get("kind", "parallel") == "parallel":
                self.bodies.append(Body(body, STILL, grip["directions"][k], True, self.column))
                body = len(self.bodies) - 1
            for turn in grip["turns"][k] if grip.get("turns") else ():
                frame, at = (np.eye(3), np.array(turn["point"], float) - at), np.array(turn["point"], float)
                self.bodies.append(Body(body, frame, turn["axis"], False, self.column, turn["ratio"]))
                body = len(self.bodies) - 1
            yield body, (R, t - at)

    def standing(self, hand: tuple[int, Frame], home: int, x: float) -> Frame:
        """The frame of a finger shape in the body that carries its finger, which has moved by x."""
        frames = [(R[0], t[0]) for R, t in placed(self.bodies, np.append(np.zeros(self.column), x)[None])]
        back = frames[home][0].T, -frames[home][0].T @ frames[home][1]
        return joined(back, joined(frames[hand[0]], hand[1]))

    def opened(self, grip: Json, width: float) -> float:
        """How far fingers have moved at a width: half of it, or, by bisection, the angle of their leader."""
        if grip.get("kind", "parallel") != "revolute" or not grip["lower"] < width < grip["upper"]:
            near, far = grip.get("positions", [0.0, 0.0])
            return (
                width / 2
                if grip.get("kind", "parallel") != "revolute"
                else float(near if width <= grip["lower"] else far)
            )
        (near, far), n = grip["positions"], np.array([grip["across"]], float)
        for _ in range(60):
            middle, reach = 0.5 * (near + far), [-math.inf, -math.inf]
            for shape, hand in zip(grip["closed"], self.hands, strict=True):
                for side, tip in enumerate(grip["tips"]):
                    if shape["link"] == tip:
                        parts = pieces(tip, shape["shape"], self.standing(hand, shape["body"], middle), {})
                        reach[side] = max(reach[side], *(part.extent(n - 2 * n * side)[0] for part in parts))
            near, far = (middle, far) if -sum(reach) < width else (near, middle)
        return float(0.5 * (near + far))

    def add(self, owner: tuple[str, str], solid: Json, hand: tuple[int, Frame], home: int) -> None:
        require(0 <= hand[0] < len(self.bodies), f"{owner[1]}: on a body that is not there")
        for piece in pieces(owner[1], solid, hand[1], self.boxes):
            self.pieces.append(piece)
            self.owner.append(owner)
            self.body.append(hand[0])
            self.home.append(home)

    def label(self, owner: tuple[str, str]) -> str:
        plain = owner[1] not in self.twice and not owner[1].endswith((" (link)", " (object)"))
        return owner[1] if plain else f"{owner[1]} ({owner[0]})"

    def wanted(self) -> Iterator[tuple[str, str, range, range]]:
        """Owners and pieces that must be apart: an obstacle from what a joint moves, parts of the robot that are on
        different bodies, and what is held from all of it. If the gripper alone moves: what belongs to a finger."""
        kinds = [
            (owner, home, k >= self.held) for k, (owner, home) in enumerate(zip(self.owner, self.home, strict=True))
        ]
        starts = [k for k in range(len(kinds)) if k == 0 or kinds[k] != kinds[k - 1]]
        runs = [range(k, end) for k, end in zip(starts, [*starts[1:], len(kinds)], strict=True)]
        gripper = any(body >= self.arm for body in self.body)
        for k, one in enumerate(runs):
            for two in runs[k + 1 :]:
                (i, j), names = (one[0], two[0]), (self.label(self.owner[one[0]]), self.label(self.owner[two[0]]))
                carried = self.held <= i < self.riding or self.held <= j < self.riding
                apart = (
                    self.home[i] > 0 and i < self.riding
                    if j >= self.riding
                    else self.home[i] != self.home[j] or carried
                )
                still = gripper and max(self.body[i], self.body[j]) < self.arm
                if apart and not still and names[0] != names[1] and frozenset(names) not in self.may_touch:
                    yield (*names, one, two)


class Trail:
    """The trail of one proof: places s on the curve, and rows (pair, place, place, direction, direction)."""

    def __init__(self, world: World, proof: Json, curve: Curve, stand: Array | None = None):
        self.world, self.proof, self.s = world, proof, unpacked(proof["s"], "<f8", 1)[:, 0]
        self.pairs, rows = unpacked(proof["pairs"], "<i4", 3).astype(int), unpacked(proof["rows"], "<i4", 9).astype(int)
        self.rows, self.n, (first, second, count) = rows[:, :3], rows[:, 3:].reshape(-1, 2, 3) / UNIT, self.pairs.T
        require(
            (np.diff(self.s) > 0) & (self.s[:-1] >= -SLACK) & (self.s[1:] <= curve.length + SLACK), "places in disorder"
        )
        require((first >= 0) & (first < second) & (first < world.riding) & (count > 0), "a pair of no pieces")
        require(
            ((count == 1) | (second >= world.riding)) & (second + count <= len(world.pieces)), "a pair of no pieces"
        )
        require((self.rows >= 0) & (self.rows < [len(self.pairs), *[len(self.s)] * 2]), "a row that refers to nothing")
        require(self.rows[:, 1] <= self.rows[:, 2], "a stretch that runs backwards")
        length = np.linalg.norm(self.n, axis=2)
        require(np.minimum(length, np.abs(length - 1)) < 1e-6, "a direction that is no unit vector")
        self.shown = length > 0.5
        self.n, q, moved = (
            self.n / np.where(self.shown, length, 1)[:, :, None],
            curve.at(self.s),
            curve.travelled(self.s),
        )
        if stand is not None:  # the arm stands, and the curve is the gripper's
            q, moved = (np.column_stack([np.repeat(x, len(q), 0), y]) for x, y in ((stand, q), (0 * stand, moved)))
        elif world.arm < len(world.bodies):
            q, moved = (np.column_stack([x, np.zeros(len(q))]) for x in (q, moved))
        self.at, self.moved, self.known = placed(world.bodies, q), moved, dict[tuple[int, int], Array]()

    def extents(self, first: int, count: int, n: Array, node: Array) -> Array:
        """How far pieces that follow each other reach along directions n (k, 3) at places (k,), from the base."""
        world = self.world
        if first >= world.riding and world.flat[first : first + count].all():
            return (n @ world.points[world.starts[first] : world.starts[first + count]].T).max(axis=1)
        R, t = (x[node] for x in self.at[world.body[first]])
        local = np.einsum("kij,ki->kj", R, n)
        return np.max([world.pieces[k].extent(local) for k in range(first, first + count)], axis=0) + (n * t).sum(1)

    def radii(self, piece: int, body: int) -> Array:
        """How far points of a piece are from the axis of a body, at most, at every place.

        With c from the axis to the centre, square to it, and w from there to a point, what of c + w is across the axis
        has a square of at most c.c + 2 c.w + w.w.
        """
        if (piece, body) not in self.known:
            it, (R, t), (B, o) = self.world.pieces[piece], self.at[self.world.body[piece]], self.at[body]
            z, x = B @ self.world.bodies[body].axis, R @ it.centre + t - o
            c = x - (x * z).sum(1)[:, None] * z
            local = np.einsum("kij,ki->kj", R, c)
            self.known[piece, body] = np.sqrt(
                (c * c).sum(1) + 2 * (it.extent(local) - local @ it.centre) + it.radius**2
            )
        return self.known[piece, body]

    def motion(self, piece: int, other: int, left: Array, right: Array) -> Array:
        """How far points of a piece move from places to others by the joints that do not move the other piece."""
        world, m = self.world, np.zeros(len(left))
        both = set(chain(world.bodies, world.body[other]))
        far = np.linalg.norm(world.pieces[piece].centre) + world.pieces[piece].radius  # from the next axis, in any case
        for k in chain(world.bodies, world.body[piece]):
            body = world.bodies[k]
            if k not in both:
                r = np.minimum((self.radii(piece, k)[left] + self.radii(piece, k)[right] + m) / 2, far)
                t = abs(body.times) * (self.moved[right, body.column] - self.moved[left, body.column])
                m = m + (t if body.slides else r * t)
            far += np.linalg.norm(body.at[1]) + body.slides * abs(body.times) * world.limits[body.column]
        return m

    def bounds(self) -> Array:
        """What each row proves, in metres."""
        out = np.full(len(self.rows), -np.inf)
        for number, (first, second, count) in enumerate(self.pairs.tolist()):
            on = np.flatnonzero(self.rows[:, 0] == number)
            left, right = self.rows[on, 1:].T
            m = self.motion(first, second, left, right)
            m = m + self.motion(second, first, left, right) if second < self.world.riding else m
            g, h = (
                np.where(shown, -self.extents(first, 1, -n, node) - self.extents(second, count, n, node), -np.inf)
                for node, n, shown in zip((left, right), self.n[on].swapaxes(0, 1), self.shown[on].T, strict=True)
            )
            out[on] = np.maximum(np.minimum(np.minimum(g, h), (g + h - m) / 2), np.maximum(g, h) - m)
        return out

    def check(self, begin: float, end: float) -> float:
        """The clearance that is shown between two places, metres."""
        claimed = math.inf if self.proof["clearance"] is None else float(self.proof["clearance"])
        require(claimed > float(self.proof["padding"]) >= 0, "a clearance that is no more than the padding")
        world, bounds, starts, stops = self.world, self.bounds(), self.s[:-1], self.s[1:]
        bad = np.flatnonzero(~(bounds >= min(claimed, 1e9) - ROUNDING))
        for k in bad[np.argsort(self.s[self.rows[bad, 1]], kind="stable")]:
            one, two = (world.label(world.owner[x]) for x in self.pairs[self.rows[k, 0], :2])
            low, high = self.s[self.rows[k, 1:]]
            why = f"{bounds[k] * 1e3:.4f} mm are shown, {claimed * 1e3:.4f} mm claimed"
            raise Invalid(f"{one} x {two} from s = {low:.6g} to {high:.6g}: {why}")
        if end <= begin:  # a point
            starts = stops = self.s
        exempt = [(each["s_start"], each["s_end"], set(map(frozenset, each["pairs"]))) for each in self.proof["exempt"]]
        rows = np.column_stack([self.pairs[self.rows[:, 0]], self.rows[:, 1:]])
        for one, two, first, second in world.wanted():
            left = (stops > begin) & (starts < end) if end > begin else np.ones(len(starts), bool)
            whole = len(self.s) > 0 and self.s[0] <= begin + SLACK and self.s[-1] >= end - SLACK
            for low, high, names in exempt:
                if frozenset((one, two)) in names:
                    left &= ~((starts >= low - SLACK) & (stops <= high + SLACK))
                    whole = whole or (low <= begin + SLACK and high >= end - SLACK)
            require(whole, f"{one} x {two}: the trail does not reach from end to end")
            for a in first:
                shown = np.zeros((len(starts), len(second)), bool)
                for _, b, count, low, high in rows[rows[:, 0] == a].tolist():
                    shown[
                        low : max(high, low + (end <= begin)), max(b - second[0], 0) : max(b + count - second[0], 0)
                    ] = 1
                missing = np.flatnonzero(left & ~shown.all(axis=1))
                require(not len(missing), f"{one} x {two}: nothing is shown from s = {starts[missing[:1]]}")
        return float(bounds.min(initial=math.inf))


def kept(world: World, robot: Json, constraint: Json, curve: Curve, begin: float, end: float) -> None:
    """Show that a constraint holds between two places of a curve.

    It is written as functions of s that must not be negative. On a stretch of length h such a function, A and B at its
    ends, is at least ``(1 - t) A + t B - M t (1 - t) h^2 / 2`` at the share t of it, M bounding the second derivative;
    a stretch on which that may be negative is cut in half. With v and a the sums of speeds and accelerations of the
    joints between the two frames, M is v^2 + a for a direction, v^2 / 4 + a / 2 for a quaternion, and for a point
    r (v^2 + a), r being the farthest that it can be from these joints; where one slides, 2 v v' + a' are added.
    """
    cuts = np.unique(np.clip([begin, end, *curve.breaks], begin, end))
    if constraint["kind"] == "joint range":
        j = robot["joint_names"].index(constraint["joint"])
        q = curve.at(np.clip([*cuts, *curve.walked[j][0]], begin, end))[:, j]
        inside = (q >= constraint["lower"] - SLACK) & (q <= constraint["upper"] + SLACK)
        require(inside, f"{constraint['joint']} is not kept in its range")
        return
    frames = {each["link"]: (each["body"], pose(each["pose"])) for each in robot.get("link_frames", [])}
    (b, tool), (c, base) = (
        (body, joined(at, pose(constraint[own])))
        for link, other, own in (("link", world.tool, "tool"), ("relative_to", (0, STILL), "frame"))
        for body, at in [other if constraint[link] is None else frames[constraint[link]]]
    )
    turning, sliding, far = (
        np.zeros(len(world.limits)),
        np.zeros(len(world.limits)),
        np.linalg.norm(tool[1]) + np.linalg.norm(base[1]),
    )
    for body in (world.bodies[k] for k in set(chain(world.bodies, b)) ^ set(chain(world.bodies, c))):
        (sliding if body.slides else turning)[body.column] += abs(body.times)
        far += np.linalg.norm(body.at[1]) + body.slides * abs(body.times) * world.limits[body.column]
    lower, upper, tilt, turn = (constraint[name] for name in ("lower", "upper", "tilt", "turn"))
    half = math.pi / 2 if turn is None else min(turn / 2, math.pi / 2)

    def values(s: Array) -> tuple[Array, Array]:
        """What must not be negative, (k, m), and the part of the quaternion that turns about z, (2, m)."""
        bodies = placed(world.bodies, np.column_stack([curve.at(s), np.zeros(len(s))]))
        (A, p), (B, o) = (joined(bodies[k], at) for k, at in ((b, tool), (c, base)))
        x, Q = np.einsum("kij,ki->jk", B, p - o), B.swapaxes(1, 2) @ A
        found = [*(x[k] - edge for k, edge in enumerate(lower) if edge is not None)]
        found += [*(edge - x[k] for k, edge in enumerate(upper) if edge is not None)]
        found += [] if tilt is None else [Q[:, 2, 2] - math.cos(tilt)]
        w, z = (np.sqrt(np.maximum(1 + Q[:, 2, 2] + i * (Q[:, 0, 0] + Q[:, 1, 1]), 0)) / 2 for i in (1, -1))
        return np.array(found).reshape(-1, len(s)), np.array([w, np.copysign(z, Q[:, 1, 0] - Q[:, 0, 1])])

    left, right, looked = (cuts[:-1], cuts[1:], 0) if len(cuts) > 1 else (cuts, cuts, 0)
    points = sum(edge is not None for edge in (*lower, *upper))
    while len(left):
        looked += len(left)
        require(looked < MOST_STRETCHES, f"{constraint['name']} is not shown to be kept near s = {left[0]:.6g}")
        (A, q), (B, p), h, (speeds, bends) = (
            values(left),
            values(right),
            right - left,
            curve.rates(0.5 * (left + right)),
        )
        n = speeds.shape[1]
        v, a, v_slide, a_slide = speeds @ turning[:n], bends @ turning[:n], speeds @ sliding[:n], bends @ sliding[:n]
        M = np.array([far * (v * v + a) + 2 * v * v_slide + a_slide] * points + [v * v + a] * (len(A) - points))
        sure = np.ones(len(left), bool)
        if half < math.pi / 2:  # of the angle 2 atan2(z, w), by both its bounds
            sure = h * v / 2 < np.sqrt((q * q).sum(0))  # then the nearer of the two signs is the same branch
            p = p * np.where((p * q).sum(0) < 0, -1, 1)
            sides = np.array([[math.sin(half), math.cos(half)], [math.sin(half), -math.cos(half)]])
            A, B, M = np.vstack([A, sides @ q]), np.vstack([B, sides @ p]), np.vstack([*M, *[v * v / 4 + a / 2] * 2])
        E = M.reshape(len(A), -1) * h * h / 2
        t = np.clip(0.5 - (B - A) / np.maximum(2 * E, 1e-300), 0, 1)
        low = (1 - t) * A + t * B - E * t * (1 - t)
        require(
            np.minimum(A, B) > -2 * SLACK, f"{constraint['name']} is not kept from s = {left[0]:.6g} to {right[-1]:.6g}"
        )
        cut = ~(sure & (low > -2 * SLACK).all(axis=0))
        middle = 0.5 * (left + right)[cut]
        left, right = np.concatenate([left[cut], middle]), np.concatenate([middle, right[cut]])


# The file


def motions(document: Json) -> Iterator[tuple[str, Json, float, Json, Json]]:
    """Each motion of a plan or a task: name, result, width of the gripper, obstacles, what is held."""
    width, scene = document["robot"]["gripper_width"], document["scene"]
    if document["format"] == "planner-service/plan":
        yield "motion", document["result"], width, scene["obstacles"], scene["attached"]
        return
    first, obstacles, attached = (
        {item["name"]: item for item in scene["obstacles"]},
        scene["obstacles"],
        scene["attached"],
    )
    for segment in document["segments"]:
        if segment["scene"] is not None:
            obstacles = [first[item] if isinstance(item, str) else item for item in segment["scene"]["obstacles"]]
            attached = segment["scene"]["attached"]
        own = segment["gripper_width"]
        yield segment["name"], segment["result"], width if own is None else own, obstacles, attached


def verify(document: Json) -> Iterator[str]:
    """What a plan file's evidence shows, line by line; Invalid if that is not all that the file claims."""
    robot, section, allowed = document["robot"], document["sections"]["evidence"], document["allowed"]
    require(document["version"] == 3 and section["version"] == 1, "another version")
    for part in ("robot", "scene"):
        require(section[part] == digest(document[part]), f"the evidence is for another {part}")
        yield f"{part} {section[part]}"
    proofs, before, ends, whole = [*section["proofs"]], robot["gripper_width"], None, [*motions(document)]
    require(len(whole) > 0, "no motion")
    scene, endless = [*whole[0][3:]], np.array(robot.get("continuous") or [False])
    for number, (name, result, width, *after) in enumerate(whole):
        curve, claim = Curve(result["path"]["waypoints"], result["path"]["blends"]), result["certificate"]
        require(ends is None or np.abs(curve.points[0] - ends) < SLACK, f"{name}: begins elsewhere")
        ends = curve.points[-1]
        was, now = ({item["name"]: item["shape"] for item in (*stand, *hold)} for stand, hold in (scene, after))
        moved = [old["name"] for old in scene[0] for new in after[0] if old["name"] == new["name"] and old != new]
        require(was == now and not moved, f"{name}: the scene changes by more than what is taken or left")
        inside = (curve.points >= np.array(robot["limits"]["lower"]) - SLACK).all(0) | endless
        inside &= (curve.points <= np.array(robot["limits"]["upper"]) + SLACK).all(0) | endless
        require(inside, f"{name}: a joint leaves its limits")
        for fingers in (True, False) if robot["gripper"] and before != width else (False,):
            proof = proofs.pop(0)
            claims = proof["motion"] == number and proof["gripper"] == [before if fingers else width, width]
            require(claims, f"{name}: the evidence is for something else")
            stood, holding = scene if fingers else after
            world = World(robot, stood, holding, allowed, section["boxes"], None if fingers else width)
            line, stand = curve, None
            if fingers:
                line = Curve([[world.opened(robot["gripper"], x)] for x in (before, width)], [])
                stand = curve.at(np.zeros(1))
            begin, end = proof["part"] or (0.0, line.length)
            require(0 <= begin <= end <= line.length + SLACK, f"{name}: a part that is not on the path")
            try:
                least, constraints = Trail(world, proof, line, stand).check(begin, end), []
                if not fingers:
                    same = all(claim[key] == proof[key] for key in ("clearance", "padding", "exempt", "part"))
                    require(same, "the certificate claims something else")
                    carried = [each for item in after[1] for each in item.get("constraints", ())]
                    asked = (document["request"] or {}).get("constraints", ())
                    constraints = [*result.get("constraints", ()), *asked, *carried]
                for constraint in constraints:
                    kept(world, robot, constraint, curve, begin, end)
            except Invalid as why:
                raise Invalid(f"{'gripper before ' * fingers}{name}: {why}") from None
            words = f", {len(constraints)} constraints kept" if constraints else ""
            yield f"{'gripper before ' * fingers}{name}: {1e3 * least:.4f} mm{words}"
            if proof["part"]:
                yield f"  judged from s = {begin:.6g} to {end:.6g} alone"
            for each in proof["exempt"]:
                where = f"from s = {each['s_start']:.6g} to {each['s_end']:.6g}"
                yield f"  not judged {where}: {each['pairs']} ({each['reason']})"
        before, scene = width, after
    require(not proofs, "proofs of motions that are not in the file")
    body = {shape["link"]: shape["body"] for shape in robot["shapes"]}
    for contact in robot["allowed_contacts"]:
        a, b = (body.get(link, -1) for link in contact["links"])
        beside = a >= 0 <= b and (a == b or robot["bodies"][a]["parent"] == b or robot["bodies"][b]["parent"] == a)
        yield f"never judged: {contact['links']} ({'neighbours' if beside else contact['reason']})"
    yield from (f"never judged: {pair} (allowed by the author)" for pair in allowed)


def main(arguments: list[str]) -> int:
    """Print what a file's evidence shows, then VALID or INVALID; 0 or 1."""
    try:
        with open(arguments[0], "rb") as file:
            for line in verify(json.loads(file.read(MOST_BYTES))):
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
