"""Checks the trail of a proof: that the clearance claimed of a motion follows from it.

A trail names stretches of the curve, pairs of convex pieces, and at both ends of each stretch a direction between the
two. A unit direction n from b to a shows a gap of ``min n.a - max n.b``, over all points of two pieces; where it is
negative, they overlap by no more than that. The largest such gap over all n is their distance, or minus the depth to
which they overlap. If no point of the one moves by more than w against the other, each gap changes by w at most, and so
does the largest. On a stretch along which points move by m in all (``World.levers``), gaps g before and h after leave
at a place that is u from the one end and m - u from the other at least ``max(g - u, h - m + u)``, so nowhere less than
``min(g, h, (g + h - m) / 2)``, and one of them alone at least ``g - m`` (Schwarzer, Saha and Latombe, IEEE T-RO 21(3),
2005); nothing in this needs gaps to be positive.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import zlib
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from itertools import combinations, product
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


def unpacked(text: str, kind: str, columns: int, *, small: bool = True) -> Array:
    """A table (k, columns) from base64 of little-endian bytes, compressed if ``small``."""
    data = base64.b64decode(text, validate=True)
    data = zlib.decompressobj().decompress(data, MOST_BYTES) if small else data
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
    positive = min(*half, r, length, solid.get("resolution", 1), solid.get("cell", 1)) >= 0
    require(positive, f"{name}: a {kind} of negative size")
    spans = np.array([[-half, half]])
    if kind in ("cloud", "heights"):
        spans, (low, high) = unpacked(boxes[name], "<f8", 6).reshape(-1, 2, 3), cells(solid)
        left = np.ones(len(low), bool)
        for span in spans:
            left &= ((low < span[0] - SLACK) | (high > span[1] + SLACK)).any(axis=1)
        require(~left, f"{name}: the boxes of the evidence leave some of it out")
    hulls = [np.unique([*product(*span.T)], axis=0) for span in spans]
    if kind == "mesh":
        hulls = [unpacked(solid["vertices"], "<f8", 3, small=False)]
    more = [*at[:3, 2], *((r, 0.0) if kind == "cylinder" else (0.0, r))]
    return [np.column_stack([hull @ at[:3, :3].T + at[:3, 3], np.tile(more, (len(hull), 1))]) for hull in hulls]


def cells(solid: Json) -> tuple[Array, Array]:
    """Lower and upper corners (k, 3) of the cells of a cloud, or of the columns of a height field."""
    if solid["kind"] == "cloud":
        low, size = unpacked(solid["cells"], "<i8", 3, small=False), solid["resolution"]
        return low * size, (low + 1) * size
    tops, floor, size = unpacked(solid["heights"], "<f8", solid["columns"], small=False), solid["floor"], solid["cell"]
    at, tops = np.argwhere(tops > floor), tops[tops > floor]
    return np.column_stack([at * size, tops * 0 + floor]), np.column_stack([(at + 1) * size, tops])


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
        self.solids, self.pieces = list[Solid](), list[Array]()
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
        for kind, name, solid, body, home, at in every:
            require(0 <= home <= body < len(self.bodies), f"{name}: on a body that is not there")
            own, first = pieces(name, solid, at, boxes), len(self.pieces)
            self.solids.append(Solid(kind, self.label(kind, name), body, home, first, first + len(own), solid, at))
            self.pieces += own
        contacts = [(("link", a), ("link", b)) for a, b in (each["links"] for each in robot["allowed_contacts"])]
        contacts += [(("held", it["name"]), ("link", link)) for it in hold for link in it["touch_links"]]
        labels = [(self.label(*one), self.label(*two)) for one, two in contacts]
        self.may_touch = {frozenset(pair) for pair in (*labels, *allowed)}
        self.of = [it for it in self.solids for _ in range(it.first, it.end)]
        self.on = np.array([it.body for it in self.of])
        self.starts = np.cumsum([0, *map(len, self.pieces)])
        rows = np.vstack([np.zeros((0, 8)), *self.pieces])
        self.points, self.axes, self.discs, self.balls = rows[:, :3], rows[:, 3:6], *rows[:, 6:].T

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
        for one, two in combinations(self.solids, 2):
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

    def reach(self, first: Array, end: Array, n: Array, T: Array) -> Array:
        """How far pieces ``first`` to ``end - 1`` reach along unit vectors n (m, 3), their body being at T, (m,)."""
        own, out = (n[:, None] @ T[:, :3, :3])[:, 0], (n * T[:, :3, 3]).sum(1)
        order = np.lexsort((end, first))
        cuts = np.flatnonzero(np.diff(first[order]) | np.diff(end[order])) + 1
        for on in np.split(order, cuts) if len(order) else ():
            k = slice(self.starts[first[on[0]]], self.starts[end[on[0]]])
            for some in np.array_split(on, 1 + len(on) * (k.stop - k.start) // AT_ONCE):
                across = np.sqrt(np.maximum(1 - (own[some] @ self.axes[k].T) ** 2, 0))
                out[some] += (own[some] @ self.points[k].T + self.balls[k] + self.discs[k] * across).max(axis=1)
        return out

    def gaps(self, a: Array, b: Array, many: Any, n: Array, at: Array) -> Array:
        """Gaps (m,) that unit vectors n (m, 3) show between pieces a and b to b + many - 1 (m,), ``at`` being frames
        (2, m, 4, 4) of their bodies."""
        return -self.reach(a, a + 1, -n, at[0]) - self.reach(b, b + many, n, at[1])

    def stands(self, width: float) -> bool:
        """Whether fingers that are a part of what carries them leave this width between them."""
        grip, gap = self.grip, 2 * self.x
        if grip["kind"] == "revolute":
            if not grip["lower"] < width < grip["upper"]:
                return bool(abs(self.x - grip["positions"][width > grip["lower"]]) < SLACK)
            require(min(grip["positions"]) <= self.x <= max(grip["positions"]), "fingers beyond their range")
            gap = 0.0
            for tip, side in zip(grip["tips"], (1, -1), strict=True):
                tips = [np.array([[it.first], [it.end]]) for it in self.solids if it.name == self.label("link", tip)]
                gap -= max(self.reach(a, b, side * np.array([grip["across"]]), np.eye(4)[None])[0] for a, b in tips)
        return not grip["closed"] or bool(abs(gap - width) < SLACK)


def shown(world: World, proof: Json, curve: Curve, begin: float, end: float) -> float:
    """The clearance that a trail shows between two places of a curve, metres; it must be what is claimed. A trail has
    places s on the curve, and rows of a pair, a place, a later place, and the directions there. On an exempt stretch
    with a depth, it shows that its pairs overlap by no more than that."""
    claimed = 1e9 if proof["clearance"] is None else float(proof["clearance"])
    require(claimed > max(float(proof["padding"]), LEAST_CLAIM) and proof["padding"] >= 0, "a claim that shows no gap")
    s, pairs = unpacked(proof["s"], "<f8", 1)[:, 0], unpacked(proof["pairs"], "<i4", 3).astype(int)
    wanted, least = [*world.wanted()], math.inf
    if not wanted:
        require(proof["clearance"] is None, "a clearance of nothing")
        return least
    require(len(s) > 1 and s[0] <= begin + SLACK and s[-1] >= end - SLACK, "it does not reach both ends")
    require((s >= -SLACK).all() and s[-1] <= curve.length + SLACK, "places beyond the curve")
    rows, n = np.split(unpacked(proof["rows"], "<i4", 9).astype(int), [3], axis=1)
    n, (number, left, right) = n.reshape(-1, 2, 3) / 2.0**30, rows.T
    length = np.linalg.norm(n, axis=2)
    require(np.minimum(length, np.abs(length - 1)) < 1e-6, "a direction that is no unit vector")
    order = (np.diff(s) >= 0).all() and (left >= 0).all() and (left < right).all() and (right < len(s)).all()
    require(order and (number >= 0).all() and (number < len(pairs)).all(), "places in disorder")
    a, b, many = pairs.T
    there = (pairs >= (0, 0, 1)).all() and (a < len(world.of)).all() and (b + many <= len(world.of)).all()
    require(there, "pieces that are not there")
    require([world.of[i].first == world.of[j].first for i, j in zip(b, b + many - 1, strict=True)], "pieces of several")
    work = max(len(s) * 16 * len(world.bodies), len(world.solids) ** 2)
    require(work <= MOST_WORK, "more than can be checked")
    at, walked, most = placed(world.bodies, curve.at(s)), curve.at(s, walked=True), np.abs(curve.points).max(axis=0)
    levers = cache(lambda first, end, other: world.levers(first, end, other, most))
    way = [levers(i, i + 1, world.on[j]) + levers(j, j + more, world.on[i]) for i, j, more in pairs.tolist()]
    m, x = ((walked[right] - walked[left]) * np.array(way)[number]).sum(1), n / np.maximum(length, 0.5)[..., None]
    a, b, many = pairs[number].T
    bodies = world.on[np.stack([a, b])]
    gaps = [world.gaps(a, b, many, x[:, k], at[bodies, place]) for k, place in enumerate((left, right))]
    g, h = np.where(length.T > 0.5, gaps, -math.inf)
    bound = np.maximum(np.minimum(np.minimum(g, h), (g + h - m) / 2), np.maximum(g, h) - m)
    found = defaultdict[tuple[int, int], Any](list)
    for row, (i, j) in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
        found[world.of[i].first, world.of[j].first].append(row)
    outside = (s[1:] <= begin + SLACK) | (s[:-1] >= end - SLACK) if end > begin else np.zeros(len(s) - 1, bool)
    for first, second in wanted:
        pair, shape = {first.name, second.name}, (first.end - first.first, second.end - second.first, len(s) - 1)
        require(math.prod(shape) <= MOST_ENTRIES, f"{pair}: a trail of too many places")
        apart = np.full(shape, -math.inf)
        for row in found[first.first, second.first]:
            part = apart[a[row] - first.first, b[row] - second.first :][: many[row], left[row] : right[row]]
            np.maximum(part, bound[row], out=part)
        sure = apart.min(axis=(0, 1), initial=math.inf)
        sure[outside] = math.inf
        for each in (each for each in proof["exempt"] if pair in map(set, each["pairs"])):
            on = (s[:-1] >= each["s_start"] - SLACK) & (s[1:] <= each["s_end"] + SLACK)
            deep = -math.inf if each.get("depth") is None else -each["depth"] - ROUNDING
            sure[on & (sure >= deep)] = math.inf
        least = min(least, float(sure.min()))
        for k in np.flatnonzero(~(sure >= claimed - ROUNDING)):
            what = f"{1e3 * sure[k]:.4f} mm are shown" if sure[k] > -math.inf else "nothing is shown"
            where = f"{first.name} x {second.name} from s = {s[k]:.9g} to {s[k + 1]:.9g}"
            raise Invalid(f"{where}: {what}, {1e3 * claimed:.4f} mm claimed")
    return least
