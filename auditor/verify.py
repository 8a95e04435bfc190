"""Checks the evidence in a plan file: that what it claims of each motion follows from the trail of its proof.

    python verify.py plan.json

One file, numpy alone; nothing here searches. A trail names stretches of the curve, pairs of convex pieces, and at both
ends of each stretch a direction between the two. This file puts the pieces there, measures, and compares.

A unit direction n from b to a shows that two pieces are at least ``min n.a - max n.b`` apart, over all their points. If
from one end of a stretch to the other no point of the one moves by more than m against the other, then gaps g before
and h after leave at least ``min(g, h, (g + h - m) / 2)`` in between, and one of them alone at least ``g - m``
(Schwarzer, Saha and Latombe, IEEE T-RO 21(3), 2005).

How m is bounded: a joint that turns by t moves no point farther than r t, r being how far from its axis the point can
ever be: steps along the chain, added up. Two pieces of the robot move against each other by joints that carry only one.

Constraints are judged by verify_constraints.py beside this file: ``python -m auditor plan.json`` runs both. Not checked
are the timing along the curve; where in the hand an object is taken; pairs that the file declares to be no concern,
which are listed; and that the robot and the scene in the file are those in the room: compare the digests.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import sys
import zlib
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np

Array = Any
Json = Any

ROUNDING = 2e-8  # metres: directions are written to nine digits
SLACK = 1e-9  # of joints, places and frames: rounding
MOST_BYTES = 200_000_000


class Invalid(Exception):
    """Why a file proves nothing, in words; and of a trail all that is not shown: s, gap, s, and two names."""


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


def frame(record: Json) -> Array:
    """A frame (4, 4): rows of a matrix, or a position and a quaternion."""
    if isinstance(record, dict):
        w, *axis = np.array(record["quaternion_wxyz"], float) / np.linalg.norm(record["quaternion_wxyz"])
        record = np.column_stack([turned(axis, 2 * w, 2.0), record["position"]])
    T = np.vstack([np.array(record, float)[:3], [0, 0, 0, 1]])
    require(np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)) < SLACK, "a frame that is no rotation")
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
    require(kind in ("box", "sphere", "capsule", "cylinder", "mesh", "cloud", "heights") and r >= 0, f"a {kind}, {r}")
    half = np.array(solid["size"] if kind == "box" else [0, 0, length], float) / 2
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
        self.points, steps = waypoints, np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
        knots, d = np.cumsum([0.0, *steps]), np.array([*blends] or [0.0] * len(waypoints), float)
        fits = len(d) == len(knots) > 1 and (d >= 0).all() and not d[[0, -1]].any()
        require(fits and (d[1:] + d[:-1] <= steps * (1 + SLACK)).all(), "no curve, or blends that overlap")
        self.tangents = np.diff(waypoints, axis=0) / np.maximum(steps, 1e-300)[:, None]
        self.corners, self.d, self.length = knots[1:-1], d[1:-1], knots[-1]

    def at(self, s: Array, *, walked: bool = False) -> Array:
        """Configurations (m, n) at places s; or how far each joint has moved until there, at most, back and forth:
        ``abs(u + (v - u) f) <= abs(u) + (abs(v) - abs(u)) f``."""
        first, tangents = (0.0, np.abs(self.tangents)) if walked else (self.points[0], self.tangents)
        x = s[:, None] - self.corners
        y = np.clip(x / np.maximum(self.d, 1e-300), -1, 1)
        area = (y + 1) / 2 + (y**2 - 1) * 5 / 16 - (y**6 - 1) / 48  # the integral of f from -1 to y
        return (
            first + s[:, None] * tangents[0] + (self.d * area + np.maximum(x - self.d, 0)) @ np.diff(tangents, axis=0)
        )


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
        self.grip = {"kind": "parallel", "links": [], "closed": [], **(robot["gripper"] or {})}
        fingers = [*self.fingers()]
        require([0 <= b["parent"] < k for k, b in enumerate(self.bodies) if k], "a body before its parent")
        require([abs(np.linalg.norm(b["axis"]) - 1) < SLACK for b in self.bodies[1:]], "an axis that is no unit vector")
        rest, every = placed(self.bodies, np.append(np.zeros(self.column), x)[None])[:, 0], list[tuple[Any, ...]]()
        for shape in sorted(robot["shapes"], key=lambda shape: alone and shape["link"] in self.grip["links"]):
            solid, body, home, at = shape["shape"], shape["body"], shape["body"], frame(shape["pose"])
            if shape["link"] in self.grip["links"]:
                solid, body, home, at = fingers.pop(0)
                body, at = (body, at) if alone else (home, np.linalg.inv(rest[home]) @ rest[body] @ at)
            every.append(("link", shape["link"], solid, body, home, at))
        self.tool = body, at = robot["tool_body"], frame(robot["tool_placement"])
        every += [("held", it["name"], it["shape"], body, body, at @ frame(it["pose"])) for it in hold]
        every += [("standing", it["name"], it["shape"], 0, 0, frame(it["pose"])) for it in stand]
        links, objects = {shape["link"] for shape in robot["shapes"]}, [it["name"] for it in (*stand, *hold)]
        require(len(set(objects)) == len(objects), "two objects of one name")
        self.twice = links.intersection(objects)
        for kind, name, solid, body, home, at in every:
            require(0 <= home <= body < len(self.bodies), f"{name}: on a body that is not there")
            found, first = pieces(name, solid, at, boxes), len(self.pieces)
            self.solids.append(Solid(kind, self.label(kind, name), body, home, first, first + len(found), solid, at))
            self.pieces += found
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
        plain = name not in self.twice and not name.endswith((" (link)", " (object)"))
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
        another body alike. None is farther from an axis than from the body's origin, and from there along the chain."""
        k, out, alike = slice(self.starts[first], self.starts[end]), np.zeros(len(most)), chain(self.bodies, other)
        middle = self.points[k].mean(axis=0)
        around = np.sqrt(((self.points[k] - middle) ** 2).sum(1).max())
        far = np.linalg.norm(middle) + math.hypot(around, self.discs[k].max()) + self.balls[k].max()
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
        for begin, stop in {*zip(first.tolist(), end.tolist(), strict=True)}:
            on, k = (first == begin) & (end == stop), slice(self.starts[begin], self.starts[stop])
            across = np.sqrt(np.maximum(1 - (own[on] @ self.axes[k].T) ** 2, 0))
            out[on] += (own[on] @ self.points[k].T + self.balls[k] + self.discs[k] * across).max(axis=1)
        return out

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
    places s on the curve, and rows of a pair, a place, a later place, and the directions there."""
    claimed = 1e9 if proof["clearance"] is None else float(proof["clearance"])
    require(claimed > float(proof["padding"]) >= 0, "a clearance that is no more than the padding")
    s, pairs = unpacked(proof["s"], "<f8", 1)[:, 0], unpacked(proof["pairs"], "<i4", 3).astype(int)
    require(len(s) > 1 and abs(s[0] - begin) < SLACK and abs(s[-1] - end) < SLACK, "it does not reach both ends")
    rows, n = np.split(unpacked(proof["rows"], "<i4", 9).astype(int), [3], axis=1)
    n, (number, left, right) = n.reshape(-1, 2, 3) / 2.0**30, rows.T
    length = np.linalg.norm(n, axis=2)
    require(np.minimum(length, np.abs(length - 1)) < 1e-6, "a direction that is no unit vector")
    require((np.diff(s) >= 0).all() and (left >= 0).all() and (left < right).all(), "places in disorder")
    require(pairs >= (0, 0, 1), "pieces that are not there")
    at, walked, most = placed(world.bodies, curve.at(s)), curve.at(s, walked=True), np.abs(curve.points).max(axis=0)
    levers = cache(lambda first, end, other: world.levers(first, end, other, most))
    way = [levers(a, a + 1, world.on[b]) + levers(b, b + many, world.on[a]) for a, b, many in pairs.tolist()]
    a, b, many = pairs[number].T
    m, gaps = ((walked[right] - walked[left]) * np.array(way)[number]).sum(1), list[Array]()
    for k, place in enumerate((left, right)):
        x = n[:, k] / np.maximum(length[:, k], 0.5)[:, None]
        gap = -world.reach(a, a + 1, -x, at[world.on[a], place]) - world.reach(b, b + many, x, at[world.on[b], place])
        gaps.append(np.where(length[:, k] > 0.5, gap, -math.inf))
    g, h = gaps
    bound = np.maximum(np.minimum(np.minimum(g, h), (g + h - m) / 2), np.maximum(g, h) - m)
    least, faults, found = math.inf, list[tuple[Any, ...]](), defaultdict[tuple[int, int], Any](list)
    for i, j, *row in zip(*(column.tolist() for column in (a, b, many, left, right, bound)), strict=True):
        found[world.of[i].first, world.of[j].first].append((i, j, *row))
    for first, second in world.wanted():
        apart = np.full((first.end - first.first, second.end - second.first, len(s) - 1), -math.inf)
        for i, j, count, low, high, gap in found[first.first, second.first]:
            part = apart[i - first.first, j - second.first :][:count, low:high]
            np.maximum(part, gap, out=part)
        sure = apart.min(axis=(0, 1), initial=math.inf)
        for each in proof["exempt"]:
            if {first.name, second.name} in map(set, each["pairs"]):
                sure[(s[:-1] >= each["s_start"] - SLACK) & (s[1:] <= each["s_end"] + SLACK)] = math.inf
        least = min(least, sure.min())
        for k in np.flatnonzero(~(sure >= claimed - ROUNDING)).tolist():
            faults.append((s[k], sure[k], s[k + 1], first.name, second.name))
    if faults:
        low, gap, high, *pair = min(faults)
        what = f"{1e3 * gap:.4f} mm are shown" if gap > -math.inf else "nothing is shown"
        where = f"{' x '.join(pair)} from s = {low:.9g} to {high:.9g}"
        raise Invalid(f"{where}: {what}, {1e3 * claimed:.4f} mm claimed", faults)
    return float(least)


def motions(document: Json) -> Iterator[tuple[Any, ...]]:
    """Each motion of a plan or a task, and before it that of the gripper alone, if there is one: its number and name,
    waypoints, result (None if alone), widths of the gripper before and after, what stands there and what is held."""
    robot, scene, known = document["robot"], document["scene"], None
    first, before = {item["name"]: item for item in scene["obstacles"]}, robot["gripper_width"]
    for number, segment in enumerate(document.get("segments") or [{"name": "motion", "result": document["result"]}]):
        scene = segment.get("scene") or scene
        now = [first[item] if isinstance(item, str) else item for item in scene["obstacles"]], scene["attached"]
        points, width = np.array(segment["result"]["path"]["waypoints"], float), segment.get("gripper_width")
        width, known = robot["gripper_width"] if width is None else width, known or now
        if robot["gripper"] and before != width:
            yield number, f"gripper before {segment['name']}", points[[0, 0]], None, [before, width], *known
        yield number, segment["name"], points, segment["result"], [width, width], *now
        before, known = width, now


def verify(document: Json, kept: Any = None) -> Iterator[str]:
    """What a plan file's evidence shows, line by line; Invalid if that is not all that the file claims. ``kept``, from
    verify_constraints.py, raises it, too, unless a constraint is shown to hold."""
    robot, section, allowed = document["robot"], document["sections"]["evidence"], document["allowed"]
    require(document["version"] == 3, "a file of another version")
    require(section["version"] == 3, f"evidence of version {section['version']}, which is not read: write it anew")
    for part in ("robot", "scene"):
        require(section[part] == digest(document[part]), f"the evidence is for another {part}")
        yield f"{part} {section[part]}"
    every, ends, stood = [*motions(document)], None, None
    require(len(every) == len(section["proofs"]), "other motions than the evidence is for")
    scene, endless = [*every[0][5:]], np.array(robot.get("continuous") or [False])
    lower, upper = (np.array(robot["limits"][side], float) for side in ("lower", "upper"))
    for proof, (number, name, points, result, widths, *now) in zip(section["proofs"], every, strict=True):
        require((points >= lower - SLACK) & (points <= upper + SLACK) | endless, f"{name}: a joint leaves its limits")
        require(ends is None or np.abs(points[0] - ends) < SLACK, f"{name}: begins elsewhere")
        had, has = ({it["name"]: it["shape"] for it in (*stand, *hold)} for stand, hold in (scene, now))
        moved = any(old != new for old in scene[0] for new in now[0] if old["name"] == new["name"])
        require(had == has and not moved, f"{name}: the scene changes by more than what is taken or left")
        require(proof["motion"] == number and proof["gripper"] == widths, f"{name}: the evidence is for another")
        (x, last), alone = proof["moved"], result is None
        world = World(robot, now[0], now[1], allowed, section["boxes"], last, alone)
        hands = [World(robot, (), (), (), {}, at) for at in (x, last)] if alone else [world, world]
        fits = (alone or x == last) and stood in (None, x) and all(map(World.stands, hands, widths))
        require(fits, f"{name}: fingers elsewhere")
        joints = np.column_stack([points, np.linspace(x, last, len(points))])
        curve = Curve(joints, [] if alone else result["path"]["blends"])
        begin, end = proof["part"] or (0.0, curve.length)
        require(0 <= begin <= end <= curve.length + SLACK, f"{name}: a part that is not on the path")
        claim, having = (proof, []) if alone else (result["certificate"], [result, document["request"] or {}, *now[1]])
        same = all(claim[key] == proof[key] for key in ("clearance", "padding", "exempt", "part"))
        require(same, f"{name}: the certificate claims something else")
        constraints = [constraint for each in having for constraint in each.get("constraints", ())]
        require(kept or not constraints, f"{name}: has constraints, which python -m auditor judges")
        try:
            least = shown(world, proof, curve, begin, end)
            for constraint in constraints:
                kept(world, robot, constraint, curve, begin, end)
        except (Invalid, LookupError, ValueError) as why:
            raise Invalid(f"{name}: {why.args[0]}") from why
        part = f" from s = {begin:.6g} to {end:.6g} alone" if proof["part"] else ""
        yield f"{name}: {1e3 * least:.4f} mm{part}" + f", {len(constraints)} constraints kept" * bool(constraints)
        yield from (f"  not judged: {each}" for each in proof["exempt"])
        yield from (f"  not judged: {each['name']}, which is held, with {each['touch_links']}" for each in now[1])
        yield from (f"  not judged: {a['name']} x {b['name']}, held together" for a, b in combinations(now[1], 2))
        scene, ends, stood = now, points[-1], last
    yield from (f"never judged: {contact['links']} ({contact['reason']})" for contact in robot["allowed_contacts"])
    yield from (f"never judged: {pair} (allowed by the author)" for pair in allowed)


def main(arguments: list[str], judge: Any = verify) -> int:
    """Print what a file shows, then VALID or INVALID; 0 or 1."""
    try:
        with open(arguments[0], "rb") as file:
            print(*judge(json.loads(file.read(MOST_BYTES))), "VALID", sep="\n")
        return 0
    except Exception as error:  # whatever a file is made of: it proves nothing
        known = "" if isinstance(error, Invalid) else f"not a plan file with evidence: {type(error).__name__}, "
        print(f"INVALID: {known}{error}")
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
