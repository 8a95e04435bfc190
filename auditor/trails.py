"""Checks the trail of a proof: that the clearance claimed of a motion follows from it.

A trail names stretches of the curve, pairs of convex pieces, and at both ends of each stretch a direction between the
two. A unit direction n from b to a shows a gap of ``min n.a - max n.b``, over all points of two pieces; where it is
negative, they overlap by no more than that. The largest such gap over all n is their distance, or minus the depth to
which they overlap. If no point of the one moves by more than w against the other, each gap changes by w at most, and so
does the largest. On a stretch along which points move by m in all (``World.levers``), gaps g before and h after leave
at a place that is u from the one end and m - u from the other at least ``max(g - u, h - m + u)``, so nowhere less than
``min(g, h, (g + h - m) / 2)``, and one of them alone at least ``g - m`` (Schwarzer, Saha and Latombe, IEEE T-RO 21(3),
2005); nothing in this needs gaps to be positive.

The second of a pair may be a bundle: pieces that stand and follow each other. The box around them, which is worked out
here, holds them all, so that a gap to it is one to each. A cell of a cloud is in one of the boxes that the evidence
cuts it into, which is verified, and so is that bundles and single pieces leave none of them and no stretch out.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import zlib
from collections.abc import Iterator
from itertools import groupby, product
from typing import Any, NamedTuple

import numpy as np

from auditor.schema import Invalid, require

Array = Any
Json = Any

ROUNDING = 2e-8  # metres: directions are written to nine digits
SLACK = 1e-9  # of joints, places and frames: rounding
LEAST_CLAIM = 1e-6  # metres: a gap that rounding cannot make up
MOST_BYTES, MOST_ENTRIES, MOST_WORK, MOST_BODIES = 100_000_000, 50_000_000, 200_000_000, 500
AT_ONCE = 2_000_000  # products of directions and points
LEAST_CELL = 1e-6  # metres
GRIDS = ("cloud", "heights")


def unpacked(text: str, kind: str, columns: int, *, small: bool = True) -> Array:
    """A table (k, columns) from base64 of little-endian bytes, compressed if ``small``."""
    data = base64.b64decode(text, validate=True)
    if small:
        unzip = zlib.decompressobj()
        data = unzip.decompress(data, MOST_BYTES)
        require(unzip.eof and not unzip.unused_data, "a table that is cut off, too long, or followed by something")
    array = np.frombuffer(data, kind).reshape(-1, columns)
    require(np.isfinite(array), "a table holds a number that is not finite")
    return array


def digest(record: Json) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def frame(record: Json) -> Array:
    """A frame (4, 4): rows of a matrix, or a position and a quaternion."""
    require(isinstance(record, dict) or [*record[3:]] in ([], [[0, 0, 0, 1]]), "a frame with another last row")
    if isinstance(record, dict):
        w, *axis = np.array(record["quaternion_wxyz"], float) / np.linalg.norm(record["quaternion_wxyz"])
        record = np.column_stack([turned(axis, 2 * w, 2.0), record["position"]])
    T = np.vstack([np.array(record, float)[:3], [0, 0, 0, 1]])
    turns = np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() < SLACK and np.linalg.det(T[:3, :3]) > 0
    require(turns, "a frame that is no rotation")
    return T


def turned(axis: Any, sine: Any, versine: Any) -> Array:
    """Rotations (..., 3, 3) about a unit vector; about a shorter one if sine and versine are larger (Rodrigues)."""
    K = np.cross(np.eye(3), np.array(axis, float))
    return np.eye(3) + sine * K + versine * (K @ K)


def pieces(name: str, solid: Json, at: Array, boxes: Json) -> list[Array]:
    """The convex pieces of a solid, in the order in which a trail numbers them: hulls of points with a disc and a ball
    around them. A row has a point, the axis to which the disc is square, and the radii of both."""
    kind, length, r = solid["kind"], float(solid.get("length", 0.0)), float(solid.get("radius", 0.0))
    if kind == "compound":
        parts = [(part["shape"], at @ frame(part["pose"])) for part in solid["parts"]]
        return [piece for shape, T in parts for piece in pieces(name, shape, T, boxes)]
    half = np.array(solid["size"] if kind == "box" else [0, 0, length], float) / 2
    require(min(*half, r, length) >= 0, f"{name}: a {kind} of negative size")
    spans = filled(name, solid, boxes[name]) if kind in GRIDS else np.array([[-half, half]])
    hulls = [np.unique([*product(*span.T)], axis=0) for span in spans]
    if kind == "mesh":
        hulls = [unpacked(solid["vertices"], "<f8", 3, small=False)]
    more = [*at[:3, 2], *((r, 0.0) if kind == "cylinder" else (0.0, r))]
    return [np.column_stack([hull @ at[:3, :3].T + at[:3, 3], np.tile(more, (len(hull), 1))]) for hull in hulls]


def filled(name: str, solid: Json, text: str) -> Array:
    """The boxes (k, 2, 3), lower and upper corners, that a cloud or a height field is cut into; Invalid unless each of
    its cells or columns is in one of them, and nothing else."""
    cloud, size = solid["kind"] == "cloud", solid.get("resolution", solid.get("cell"))
    require(size >= LEAST_CELL, f"{name}: cells of no size")
    boxes, axes = unpacked(text, "<f8", 6).reshape(-1, 2, 3), 3 if cloud else 2
    require(np.abs(boxes) < 1e9 * size, f"{name}: boxes far away")
    first, last = np.rint(boxes[:, :, :axes] / size).astype(np.int64).transpose(1, 0, 2)
    there = np.abs(np.stack([first, last], axis=1) * size - boxes[:, :, :axes]) <= SLACK
    require(there.all() and (first < last).all(), f"{name}: the boxes of the evidence are not made of its cells")
    cells, tops = (packed_cells(solid), None) if cloud else columns(solid)
    wrong, many = f"{name}: the boxes of the evidence leave some of it out, or hold more", (last - first).astype(float)
    require(many.prod(axis=1).sum() == len(cells), wrong)
    counts = (last - first).prod(axis=1)
    box, left = np.repeat(np.arange(len(boxes)), counts), np.arange(len(cells))
    left, inside = left - np.repeat(np.cumsum(counts) - counts, counts), np.empty((len(cells), axes), np.int64)
    for axis in range(axes):
        left, inside[:, axis] = np.divmod(left, (last - first)[box, axis])
    inside += first[box]
    found, own = np.lexsort(inside.T), np.lexsort(cells.T)
    require((inside[found] == cells[own]).all(), wrong)
    if tops is not None:
        level = (boxes[box[found], 1, 2] == tops[own]).all() and (boxes[:, 0, 2] == solid["floor"]).all()
        require(level, f"{name}: a box that is not as high as its columns")
    return boxes


def packed_cells(solid: Json) -> Array:
    """The cells (k, 3) of a cloud, counted in edges."""
    if "cells" in solid:  # as older versions wrote them
        return unpacked(solid["cells"], "<i8", 3, small=False)
    return np.cumsum(unpacked(solid["packed"], "<i4", 1).reshape(3, -1), axis=1, dtype=np.int64).T


def columns(solid: Json) -> tuple[Array, Array]:
    """The columns (k, 2) of a height field that are not empty, counted in edges, and their tops (k,)."""
    tops = unpacked(solid["heights"], "<f8", solid["columns"], small=False)
    there = tops > solid["floor"]
    return np.argwhere(there), tops[there]


def placed(bodies: Json, q: Array) -> Array:
    """Frames (bodies, m, 4, 4) at configurations q (m, n); a body's own one is ``at`` in its parent's when q is 0."""
    out = np.tile(np.eye(4), (len(bodies), len(q), 1, 1))
    for k, body in enumerate(bodies[1:], start=1):
        x = q[:, body["q_index"], None] * body["multiplier"]
        if body["prismatic"]:
            out[k, :, :3, 3] = x * body["axis"]
        else:
            out[k, :, :3, :3] = turned(body["axis"], np.sin(x)[:, None], 1 - np.cos(x)[:, None])
        out[k] = out[body["parent"]] @ body["at"] @ out[k]
    return out


def chain(bodies: Json, body: int) -> list[int]:
    """Bodies from one inwards, without the base."""
    return [body, *chain(bodies, bodies[body]["parent"])] if body > 0 else []


class Curve:
    """Waypoints joined by lines; a corner with a blend of width d has instead, from d before to d after it, the tangent
    ``u + (v - u) f(y)``, ``f(y) = 1/2 + (5 y - y^5) / 8``, y from -1 to 1."""

    def __init__(self, waypoints: Array, blends: Json):
        if len(waypoints) == 1:  # an arm that stays where it is
            waypoints, blends = np.vstack([waypoints, waypoints]), [*blends, 0.0]
        ways = np.diff(waypoints, axis=0)
        self.points, self.steps = waypoints, np.linalg.norm(ways, axis=1)
        knots, d = np.cumsum([0.0, *self.steps]), np.array([*blends] or [0.0] * len(waypoints), float)
        fits = len(d) == len(knots) > 1 and (d >= 0).all() and not d[[0, -1]].any()
        require(fits and (d[1:] + d[:-1] <= self.steps * (1 + SLACK)).all(), "no curve, or blends that overlap")
        self.tangents = ways / np.maximum(self.steps, 1e-300)[:, None]
        self.corners, self.d, self.length = knots[1:-1], d[1:-1], knots[-1]

    def at(self, s: Array, *, walked: bool = False) -> Array:
        """Configurations (m, n) at places s; or how far each joint has moved until there, at most, back and forth:
        ``abs(u + (v - u) f) <= abs(u) + (abs(v) - abs(u)) f``."""
        first, tangents = (0.0, np.abs(self.tangents)) if walked else (self.points[0], self.tangents)
        x = s[:, None] - self.corners
        y = np.clip(x / np.maximum(self.d, 1e-300), -1, 1)
        area = (y + 1) / 2 + (y**2 - 1) * 5 / 16 - (y**6 - 1) / 48  # the integral of f from -1 to y
        turns = (self.d * area + np.maximum(x - self.d, 0)) @ np.diff(tangents, axis=0)
        return first + s[:, None] * tangents[0] + turns


class Solid(NamedTuple):
    """The pieces ``first`` to ``end - 1``, on a body; ``home`` is the body that carries a finger."""

    kind: str
    name: str
    body: int
    home: int
    first: int
    end: int
    record: Json
    at: Array


class World:
    """The solids of a robot, of what it holds and of what stands around it; a trail numbers their pieces in this order.
    Fingers that have moved by x are a part of the body that carries them. Where they move ``alone``, that is one more
    joint, and they come after the robot's other shapes."""

    def __init__(self, robot: Json, stand: Json, hold: Json, allowed: Json, boxes: Json, x: float, alone: bool = False):
        self.x, self.alone, self.arm, self.column = x, alone, len(robot["bodies"]), len(robot["joint_names"])
        self.solids = list[Solid]()
        self.bodies = [{"multiplier": 1.0, **body, "at": frame(body["placement"])} for body in robot["bodies"]]
        none: Json = {"kind": "parallel", "links": [], "closed": [], "directions": [], "turns": [], "tips": []}
        self.grip = {**none, **(robot["gripper"] or {})}
        kind, many, tips = self.grip["kind"], len(self.grip["closed"]), self.grip["tips"]
        ways = {"parallel": (many, 0), "revolute": (0, many), "vacuum": (0, 0)}.get(kind)
        found = len(self.grip["directions"]), len(self.grip["turns"])
        require(ways == found, f"fingers that move otherwise than those of a {kind} gripper")
        tipped = len(tips) == 2 and {*tips} <= {it["link"] for it in self.grip["closed"]}
        require(kind != "revolute" or tipped, "a width between links that are no fingers")
        fingers = [*self.fingers()]
        for k, it in enumerate(self.bodies[1:], start=1):
            moved = 0 <= it["q_index"] < self.column + (k >= self.arm)
            there = 0 <= it["parent"] < k < MOST_BODIES and abs(np.linalg.norm(it["axis"]) - 1) < SLACK
            require(moved and there, f"body {k}: before its parent, or moved by no joint, or along no unit vector")
        self.tool = body, at = robot["tool_body"], frame(robot["tool_placement"])
        riding = [body, *(it["body"] for it in (*robot["shapes"], *robot.get("link_frames", ())))]
        require([0 <= k < self.arm for k in riding], "a link or a tool on a body that is not there")
        every = list[tuple[Any, ...]]()
        rest = placed(self.bodies, np.append(np.zeros(self.column), x)[None])[:, 0]
        for shape in sorted(robot["shapes"], key=lambda shape: alone and shape["link"] in self.grip["links"]):
            solid, body, home, at = shape["shape"], shape["body"], shape["body"], frame(shape["pose"])
            if shape["link"] in self.grip["links"]:
                require(fingers and fingers[0][0] == solid and fingers[0][2] == body, "fingers of other shapes")
                solid, body, home, at = fingers.pop(0)
                body, at = (body, at) if alone else (home, np.linalg.inv(rest[home]) @ rest[body] @ at)
            every.append(("link", shape["link"], solid, body, home, at))
        require(not fingers, "fingers that no link has")
        body, at = self.tool
        every += [("held", it["name"], it["shape"], body, body, at @ frame(it["pose"])) for it in hold]
        every += [("standing", it["name"], it["shape"], 0, 0, frame(it["pose"])) for it in stand]
        self.links, self.objects = {it["link"] for it in robot["shapes"]}, {it["name"] for it in (*stand, *hold)}
        require(len(self.objects) == len(stand) + len(hold), "two objects of one name")
        hulls, spans, counts = list[Array](), list[Array](), list[Array]()
        for kind, name, solid, body, home, at in every:
            require(0 <= home <= body < len(self.bodies), f"{name}: on a body that is not there")
            grid = kind == "standing" and solid["kind"] in GRIDS
            own = filled(name, solid, boxes[name]) if grid else pieces(name, solid, at, boxes)
            first = self.solids[-1].end if self.solids else 0
            self.solids.append(Solid(kind, self.label(kind, name), body, home, first, first + len(own), solid, at))
            hulls += [] if grid else own
            spans.append(own if grid else np.zeros((len(own), 2, 3)))
            counts.append(np.zeros(len(own), int) if grid else np.array([*map(len, own)]))
        contacts = [(("link", a), ("link", b)) for a, b in (each["links"] for each in robot["allowed_contacts"])]
        contacts += [(("held", it["name"]), ("link", link)) for it in hold for link in it["touch_links"]]
        labels = [(self.label(*one), self.label(*two)) for one, two in contacts]
        self.may_touch = {frozenset(pair) for pair in (*labels, *allowed)}
        self.of = np.repeat(np.arange(len(self.solids)), [it.end - it.first for it in self.solids])
        self.on = np.array([it.body for it in self.solids], int)[self.of]
        self.rides = next((it.first for it in self.solids if it.kind == "standing"), len(self.of))
        self.starts = np.cumsum([0, *np.concatenate([[], *counts])]).astype(int)
        rows = np.vstack([np.zeros((0, 8)), *hulls])
        self.points, self.axes, self.discs, self.balls = rows[:, :3], rows[:, 3:6], *rows[:, 6:].T
        self.turns = np.array([it.at[:3, :3] for it in self.solids]).reshape(-1, 3, 3)
        self.places = np.array([it.at[:3, 3] for it in self.solids]).reshape(-1, 3)
        self.spans = np.vstack([np.zeros((0, 2, 3)), *spans])

    def fingers(self) -> Iterator[tuple[Json, int, int, Array]]:
        """Solid, body, what carries it, and frame of each shape of a finger; adds bodies that one more joint moves."""
        for k, shape in enumerate(self.grip["closed"]):
            body, at, slides = shape["body"], np.array([0.0] * 3), self.grip["kind"] != "revolute"
            along = [{"axis": axis, "point": at, "ratio": 1.0} for axis in self.grip["directions"][k : k + 1]]
            for joint in along if slides else self.grip["turns"][k]:  # a cup has none
                step = frame(np.column_stack([np.eye(3), joint["point"] - at]))
                moves = {"axis": joint["axis"], "prismatic": slides, "multiplier": joint["ratio"]}
                self.bodies.append({"parent": body, "at": step, "q_index": self.column, **moves})
                body, at = len(self.bodies) - 1, np.array(joint["point"], float)
            yield shape["shape"], body, shape["body"], frame(np.column_stack([np.eye(3), -at])) @ frame(shape["pose"])

    def label(self, kind: str, name: str) -> str:
        """What a certificate calls a link or an object; a link that has no shape is called like no object."""
        others = self.objects if kind == "link" else self.links
        plain = name not in others and not name.endswith((" (link)", " (object)"))
        return name if plain else f"{name} ({'link' if kind == 'link' else 'object'})"

    def wanted(self) -> Iterator[tuple[Solid, Solid]]:
        """Those that must be apart: an obstacle from what a joint moves, parts of the robot that are on different
        bodies, and what is held from all of it; not two that are held, which cannot move against each other. If the
        gripper alone moves: what belongs to a finger."""
        for one, two in ((one, two) for k, one in enumerate(self.solids) for two in self.solids[k + 1 :]):
            if one.kind == "standing":
                return
            apart = one.home != two.home if two.kind == "link" else one.body != two.body
            apart |= two.kind == "held" != one.kind
            judged = one.name != two.name and frozenset((one.name, two.name)) not in self.may_touch
            if apart and judged and (not self.alone or max(one.body, two.body) >= self.arm):
                yield one, two

    def levers(self, first: int, end: int, other: int, most: Array) -> Array:
        """How far points of some pieces of a body move at most if each joint moves by 1, (n,); 0 for those that move
        another body alike; ``most`` is how far from 0 each joint may be.

        Lemma. Seen from the innermost body that carries both, or is one of them, no point of pieces ``first`` to
        ``end - 1`` moves farther on a curve than the sum over the joints of ``levers`` times how far each has moved,
        back and forth. So two pieces move against each other by no more than the sum of both sums.

        Proof. A piece is the hull of points p with a disc square to a unit vector a, of radius r, and a ball of radius
        b around them. Norms are convex, so that no point of a hull is farther from the body's origin than the farthest
        point of a disc, ``hypot(p.a, sqrt(p.p - (p.a)^2) + r)``, plus b: with p split along and across a, the disc
        adds to the part across alone, at most r. ``far`` is the largest of these over all points of all pieces. It is
        carried inwards: the origin of a body is, in its parent, ``|at|`` from the parent's, and one that slides by x
        is |x| more, x being the multiplier times at most ``most``; so ``far + |at| + |x|`` bounds the distance of the
        same points from the parent's origin. The axis of a joint goes through the origin of its body. So where q
        moves at the rate q', a turning joint moves the points, as seen from its body's parent, at no more than
        ``|multiplier q'| far``, and a sliding one at ``|multiplier q'|``. Rates of the joints up to the innermost body
        that carries both add up, those further in move both alike, and distances are integrals of rates."""
        k, out, alike = slice(self.starts[first], self.starts[end]), np.zeros(len(most)), chain(self.bodies, other)
        along = (self.points[k] * self.axes[k]).sum(axis=1)
        across = np.sqrt(np.maximum((self.points[k] ** 2).sum(axis=1) - along**2, 0)) + self.discs[k]
        far = (np.hypot(along, across) + self.balls[k]).max()
        for number in chain(self.bodies, self.on[first]):
            body = self.bodies[number]
            times, column = abs(body["multiplier"]), body["q_index"]
            if number not in alike:
                out[column] += times * (1.0 if body["prismatic"] else far)
            far += np.linalg.norm(body["at"][:3, 3]) + body["prismatic"] * times * most[column]
        return out

    def reach(self, k: Array, n: Array, T: Array) -> Array:
        """How far pieces k (m,) reach along unit vectors n (m, 3), their bodies being at T (m, 4, 4); (m,)."""
        own, out = (n[:, None] @ T[:, :3, :3])[:, 0], (n * T[:, :3, 3]).sum(1)
        cells, hulls = (np.flatnonzero((self.starts[k] == self.starts[k + 1]) == grid) for grid in (True, False))
        out[cells] += self.box_reach(self.of[k[cells]], self.spans[k[cells]], own[cells])
        order = hulls[np.argsort(k[hulls], kind="stable")]
        for on in np.split(order, np.flatnonzero(np.diff(k[order])) + 1) if len(order) else ():
            rows = slice(self.starts[k[on[0]]], self.starts[k[on[0]] + 1])
            for some in np.array_split(on, 1 + len(on) * (rows.stop - rows.start) // AT_ONCE):
                across = np.sqrt(np.maximum(1 - (own[some] @ self.axes[rows].T) ** 2, 0))
                out[some] += (own[some] @ self.points[rows].T + self.balls[rows] + self.discs[rows] * across).max(
                    axis=1
                )
        return out

    def box_reach(self, solid: Array, spans: Array, n: Array) -> Array:
        """How far boxes (m, 2, 3) in the axes of solids (m,) reach along vectors n (m, 3), (m,)."""
        own = (n[:, None] @ self.turns[solid])[:, 0]
        return (n * self.places[solid]).sum(1) + np.where(own > 0, own * spans[:, 1], own * spans[:, 0]).sum(1)

    def around(self, k: Array, turns: Array, places: Array) -> Array:
        """Boxes (m, 2, 3) around pieces k (m,) that stand, in frames of these turns (m, 3, 3) and places (m, 3)."""
        still = np.broadcast_to(np.eye(4), (len(k), 4, 4))
        ends = [[sign * self.reach(k, sign * turns[:, :, axis], still) for axis in range(3)] for sign in (-1, 1)]
        return np.array(ends).transpose(2, 0, 1) - (places[:, None] @ turns)

    def extents(self, solid: Solid, T: Array) -> tuple[Array, Array]:
        """Lower and upper corners (k, 3) of boxes around the pieces of a solid along the base's axes, its body at T."""
        k, frames = np.arange(solid.first, solid.end), np.tile(T, (solid.end - solid.first, 1, 1))
        low, high = (
            [sign * self.reach(k, np.tile(sign * n, (len(k), 1)), frames) for n in np.eye(3)] for sign in (-1, 1)
        )
        return np.transpose(low), np.transpose(high)

    def gaps(self, a: Array, b: Array, n: Array, at: Array) -> Array:
        """Gaps (m,) that unit vectors n (m, 3) show between pieces a and b (m,), ``at`` being frames (2, m, 4, 4) of
        their bodies."""
        return -self.reach(a, -n, at[0]) - self.reach(b, n, at[1])

    def stands(self, width: float) -> bool:
        """Whether fingers that are a part of what carries them leave this width between them."""
        grip, gap = self.grip, 2 * self.x
        if grip["kind"] == "revolute":
            if not grip["lower"] < width < grip["upper"]:
                return bool(abs(self.x - grip["positions"][width > grip["lower"]]) < SLACK)
            require(min(grip["positions"]) <= self.x <= max(grip["positions"]), "fingers beyond their range")
            gap = 0.0
            for tip, side in zip(grip["tips"], (1, -1), strict=True):
                those = [it for it in self.solids if it.name == self.label("link", tip)]
                k = np.concatenate([np.arange(it.first, it.end) for it in those])
                gap -= self.reach(
                    k, np.tile(side * np.array(grip["across"]), (len(k), 1)), np.tile(np.eye(4), (len(k), 1, 1))
                ).max()
        return not grip["closed"] or bool(abs(gap - width) < SLACK)


class Bundles:
    """Boxes around pieces that stand and follow each other in an order: in the base's axes, and in those of their solid
    if they are of one. Both hold all of the pieces."""

    def __init__(self, world: World, order: Array, begin: Array, end: Array):
        require((end - begin).sum() <= MOST_WORK, "more bundles than can be checked")
        self.world, k = world, order[world.rides :] if len(begin) else order[:0]
        of, none = world.of[k], np.zeros((len(k), 3))
        own, base = world.around(k, world.turns[of], world.places[of]), world.around(k, none[:, None] + np.eye(3), none)
        begin, end = begin - world.rides, end - world.rides
        changes = np.concatenate([[0], np.cumsum(np.diff(of) != 0)]) if len(of) else of
        self.one, self.solid = changes[begin] == changes[end - 1], of[begin]
        self.own, self.base = (self.joined(spans, begin, end) for spans in (own, base))

    @staticmethod
    def joined(spans: Array, begin: Array, end: Array) -> Array:
        runs, more = np.stack([begin, end], axis=1).ravel(), np.vstack([spans, spans[-1:]])
        if not len(runs):
            return np.zeros((0, 2, 3))
        ends = np.minimum.reduceat(more[:, 0], runs)[::2], np.maximum.reduceat(more[:, 1], runs)[::2]
        return np.stack(ends, axis=1)

    def reach(self, k: Array, n: Array) -> Array:
        """How far bundles k (m,) reach along unit vectors n (m, 3), at most, (m,)."""
        base, one = self.base[k], self.one[k]
        out = np.where(n > 0, n * base[:, 1], n * base[:, 0]).sum(1)
        out[one] = np.minimum(out[one], self.world.box_reach(self.solid[k[one]], self.own[k[one]], n[one]))
        return out


def shown(world: World, proof: Json, curve: Curve, begin: float, end: float) -> float:
    """The clearance that a trail shows between two places of a curve, metres; it must be what is claimed. A trail has
    places s on the curve, and rows of a pair, a place, a later place, and the directions there. The second of a pair is
    a run of pieces in the order of the world, those of the crowd last in an order of their own. On an exempt stretch
    with a depth, rows show that its pairs overlap by no more than that."""
    claimed = 1e9 if proof["clearance"] is None else float(proof["clearance"])
    require(claimed > max(float(proof["padding"]), LEAST_CLAIM) and proof["padding"] >= 0, "a claim that shows no gap")
    s, pairs = unpacked(proof["s"], "<f8", 1)[:, 0], unpacked(proof["pairs"], "<i4", 3).astype(int)
    wanted = [(one, [two for _, two in both]) for one, both in groupby(world.wanted(), key=lambda both: both[0])]
    if not wanted:
        require(proof["clearance"] is None, "a clearance of nothing")
        return math.inf
    require(len(s) > 1 and s[0] <= begin + SLACK and s[-1] >= end - SLACK, "it does not reach both ends")
    require((s >= -SLACK).all() and s[-1] <= curve.length + SLACK, "places beyond the curve")
    rows, n = np.split(unpacked(proof["rows"], "<i4", 9).astype(int), [3], axis=1)
    n, (number, left, right) = n.reshape(-1, 2, 3) / 2.0**30, rows.T
    length = np.linalg.norm(n, axis=2)
    require(np.minimum(length, np.abs(length - 1)) < 1e-6, "a direction that is no unit vector")
    order = (np.diff(s) >= 0).all() and (left >= 0).all() and (left < right).all() and (right < len(s)).all()
    require(order and (number >= 0).all() and (number < len(pairs)).all(), "places in disorder")
    order, (a, b, many) = ordered(world, proof), pairs.T
    there = (pairs >= (0, 0, 1)).all() and (a < world.rides).all() and (b + many <= len(order)).all()
    require(
        there and ((many == 1) | (b >= world.rides)).all(), "pieces that are not there, or that do not stand together"
    )
    work = max(len(s) * 16 * len(world.bodies), len(wanted) * len(world.solids))
    require(work <= MOST_WORK, "more than can be checked")
    bound = bounds(world, curve, s, order, pairs, (number, left, right), n, length)
    outside = (s[1:] <= begin + SLACK) | (s[:-1] >= end - SLACK) if end > begin else np.zeros(len(s) - 1, bool)
    a, b, many = pairs[number].T
    mine, least = (
        np.split(np.argsort(a, kind="stable"), np.searchsorted(np.sort(a), np.arange(1, world.rides))),
        math.inf,
    )
    for first, others in wanted:
        kinds, levels = needed(world, first, others, proof["exempt"], s, claimed - ROUNDING, outside)
        kind = kinds[world.of[order]]
        for piece in range(first.first, first.end):
            k = mine[piece]
            table = np.stack([b[k], b[k] + many[k], left[k], right[k]])
            least = min(least, covered(world, first, order, kind, levels, table, bound[k], s, claimed))
    return least


def ordered(world: World, proof: Json) -> Array:
    """The pieces in the order in which a trail numbers them: those of the crowd last, in its own order."""
    crowd = unpacked(proof["crowd"], "<i4", 1)[:, 0].astype(int) if "crowd" in proof else np.zeros(0, int)
    rest, once = np.ones(len(world.of), bool), len(np.unique(crowd)) == len(crowd)
    require(once and ((crowd >= world.rides) & (crowd < len(rest))).all(), "a crowd that does not stand, or twice")
    rest[crowd] = False
    return np.concatenate([np.flatnonzero(rest), crowd])


def bounds(
    world: World, curve: Curve, s: Array, order: Array, pairs: Array, rows: Any, n: Array, length: Array
) -> Array:
    """What each row shows of its pair on its stretch at least, (m,)."""
    (number, left, right), (a, b, many) = rows, pairs.T
    at, walked, most = placed(world.bodies, curve.at(s)), curve.at(s, walked=True), np.abs(curve.points).max(axis=0)
    alone, way = np.where(many == 1, order[b], -1), np.zeros((len(pairs), len(most)))
    bodies = np.stack([world.on[a], np.where(alone < 0, 0, world.on[alone])])
    for piece, other in ((a, bodies[1]), (alone, bodies[0])):
        moved = np.flatnonzero((piece >= 0) & (piece < world.rides))
        each, which = np.unique(np.stack([piece[moved], other[moved]]), axis=1, return_inverse=True)
        levers = [world.levers(k, k + 1, body, most) for k, body in each.T.tolist()]
        way[moved] += np.reshape(levers, (-1, len(most)))[which.ravel()]
    m, x = ((walked[right] - walked[left]) * way[number]).sum(1), n / np.maximum(length, 0.5)[..., None]
    runs, which = np.unique(pairs[alone < 0, 1:], axis=0, return_inverse=True)
    bundles, bundle = Bundles(world, order, runs[:, 0], runs.sum(axis=1)), np.zeros(len(pairs), int)
    bundle[alone < 0] = which.ravel()
    one, gaps = alone[number] >= 0, np.empty((2, len(number)))
    for k, place in enumerate((left, right)):
        gaps[k] = -world.reach(a[number], -x[:, k], at[bodies[0, number], place])
        gaps[k, one] -= world.reach(alone[number[one]], x[one, k], at[bodies[1, number[one]], place[one]])
        gaps[k, ~one] -= bundles.reach(bundle[number[~one]], x[~one, k])
    g, h = np.where(length.T > 0.5, gaps, -math.inf)
    return np.maximum(np.minimum(np.minimum(g, h), (g + h - m) / 2), np.maximum(g, h) - m)


def needed(
    world: World, first: Solid, others: list[Solid], exempt: Json, s: Array, level: float, outside: Array
) -> tuple[Array, Array]:
    """What has to be shown of a solid and others: a kind of each solid (k,), and for each kind what is needed between
    two places each (kinds, len(s) - 1); nothing of the first kind."""
    kinds, known = np.zeros(len(world.solids), int), dict[tuple[int, ...], int]()
    levels = list[Array]([np.full(len(s) - 1, -math.inf)])
    pairs = [{*map(frozenset, each["pairs"])} for each in exempt]
    for two in others:
        those = tuple(k for k, each in enumerate(pairs) if frozenset((first.name, two.name)) in each)
        if those not in known:
            known[those] = len(levels)
            need = np.where(outside, -math.inf, level)
            for each in (exempt[k] for k in those):
                on = (s[:-1] >= each["s_start"] - SLACK) & (s[1:] <= each["s_end"] + SLACK)
                deep = -math.inf if each.get("depth") is None else -each["depth"] - ROUNDING
                need[on] = np.minimum(need[on], deep)
            levels.append(need)
        kinds[world.of[two.first]] = known[those]
    return kinds, np.array(levels)


def covered(
    world: World,
    first: Solid,
    order: Array,
    kind: Array,
    levels: Array,
    table: Array,
    bound: Array,
    s: Array,
    claimed: float,
) -> float:
    """The least bound (m,) of rows that cover what is needed of one piece of a solid against all others; Invalid if
    something is left. ``table`` (4, m) has the runs and the stretches of the rows, first and end of each."""
    changes = [np.flatnonzero(np.diff(kind)) + 1, np.flatnonzero((levels[:, 1:] != levels[:, :-1]).any(axis=0)) + 1]
    cuts = [
        np.unique([0, size, *own, *table[2 * k : 2 * k + 2].ravel()])
        for k, (size, own) in enumerate(zip((len(order), len(s) - 1), changes, strict=True))
    ]
    require(math.prod(map(len, cuts)) <= MOST_ENTRIES, f"{first.name}: a trail of too many places")
    x, y = cuts
    at = [np.searchsorted(cuts[k // 2], table[k]) for k in range(4)]
    need = levels[kind[x[:-1]]][:, y[:-1]]
    for level in np.unique(need[need > -math.inf]):
        good, grid = bound >= level, np.zeros((len(x), len(y)), np.int32)
        for i, j, sign in ((0, 2, 1), (0, 3, -1), (1, 2, -1), (1, 3, 1)):
            np.add.at(grid, (at[i][good], at[j][good]), sign)
        left = np.argwhere((need == level) & (grid.cumsum(0).cumsum(1)[:-1, :-1] == 0))
        for i, j in left[:1]:
            two = world.solids[world.of[order[x[i]]]]
            here = (at[0] <= i) & (i < at[1]) & (at[2] <= j) & (j < at[3])
            best = bound[here].max(initial=-math.inf)
            what = f"{1e3 * best:.4f} mm are shown" if best > -math.inf else "nothing is shown"
            where = f"{first.name} x {two.name} from s = {s[y[j]]:.9g} to {s[y[j + 1]]:.9g}"
            raise Invalid(f"{where}: {what}, {1e3 * claimed:.4f} mm claimed")
    return float(bound[bound >= claimed - ROUNDING].min(initial=math.inf))
