"""Looks for what is false in a plan or task file by dense sampling, with Pinocchio and Coal: a judge of the verifier.

It shares no formula with it: Pinocchio places the shapes, Coal measures distances, the curve is integrated numerically
and speeds are differences. What stands and what is held it works out from motion to motion. It finds no proof, only
objections: an empty list says that none was found at so many places.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Iterator
from functools import lru_cache
from itertools import combinations, pairwise
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from auditor.checker import hull_of

__all__ = ["no_path_objections", "objections"]

Array = Any
Json = Any

NEAR = 5e-6  # metres by which Coal's distances may err
MEANT = 1.1e-3  # metres that what is meant to touch may overlap
AWAY = 2e-5  # metres and radians by which frames may differ
FINE = 64  # steps of a blend


class Body(NamedTuple):
    owner: tuple[str, str]
    link: int
    geometry: Any
    at: Array
    radius: float


def matrix(record: Json) -> Array:
    if isinstance(record, dict):
        w, x, y, z = record["quaternion_wxyz"]
        return pin.SE3(
            pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(record["position"], float)
        ).homogeneous
    return np.array(record, float)


def solids(solid: Json, at: Array) -> Iterator[tuple[Any, Array]]:
    """Coal's shapes of a solid, and their frames."""
    kind = solid["kind"]
    if kind == "compound":
        for part in solid["parts"]:
            yield from solids(part["shape"], at @ matrix(part["pose"]))
    elif kind == "box":
        yield coal.Box(np.array(solid["size"], float)), at
    elif kind == "mesh":
        yield hull(solid["vertices"]), at
    elif kind == "cloud":
        size = solid["resolution"]
        for cell in occupied(solid):
            yield coal.Box(np.full(3, size)), at @ shifted((cell + 0.5) * size)
    elif kind == "heights":
        tops = np.frombuffer(base64.b64decode(solid["heights"]), "<f8").reshape(-1, solid["columns"])
        for (i, j), top in np.ndenumerate(tops):
            if top > solid["floor"]:
                middle = [(i + 0.5) * solid["cell"], (j + 0.5) * solid["cell"], (top + solid["floor"]) / 2]
                yield coal.Box(np.array([solid["cell"], solid["cell"], top - solid["floor"]])), at @ shifted(middle)
    elif kind == "sphere":
        yield coal.Sphere(solid["radius"]), at
    else:
        make = {"cylinder": coal.Cylinder, "capsule": coal.Capsule}[kind]
        yield make(solid["radius"], solid["length"]), at


def occupied(solid: Json) -> Array:
    """The cells (k, 3) of a cloud, counted in edges; each once."""
    if "packed" not in solid:
        return np.unique(np.frombuffer(base64.b64decode(solid["cells"]), "<i8").reshape(-1, 3), axis=0)
    steps = np.frombuffer(zlib.decompress(base64.b64decode(solid["packed"])), "<i4").reshape(3, -1)
    return np.unique(np.array([np.add.accumulate(row.astype(np.int64)) for row in steps]).T, axis=0)


@lru_cache(maxsize=256)
def hull(vertices: str) -> Any:
    return hull_of(np.frombuffer(base64.b64decode(vertices), "<f8").reshape(-1, 3))


def shifted(by: Any) -> Array:
    T = np.eye(4)
    T[:3, 3] = by
    return T


class Arm:
    """Where the shapes of a file's robot are, by Pinocchio."""

    def __init__(self, robot: Json):
        self.robot, self.model = robot, pin.Model()
        for k, body in enumerate(robot["bodies"][1:], start=1):
            kind = pin.JointModelPrismaticUnaligned if body["prismatic"] else pin.JointModelRevoluteUnaligned
            place = pin.SE3(np.array(body["placement"], float))
            self.model.addJoint(body["parent"], kind(np.array(body["axis"], float)), place, str(k))
        self.data = self.model.createData()
        moved = robot["bodies"][1:]
        self.columns = [body["q_index"] for body in moved]
        self.times = np.array([body.get("multiplier", 1.0) for body in moved])

    def frames(self, q: Array) -> list[Array]:
        pin.forwardKinematics(self.model, self.data, self.times * np.asarray(q)[self.columns])
        return [self.data.oMi[k].homogeneous for k in range(self.model.njoints)]

    def tool(self, q: Array) -> Array:
        return self.frames(q)[self.robot["tool_body"]] @ matrix(self.robot["tool_placement"])

    def bodies(self, stand: Json, hold: Json, width: float) -> list[Body]:
        """All solids, the fingers at a width."""
        grip, found = self.robot["gripper"] or {"links": []}, list[Body]()
        fingers = iter(self.fingers(width))
        tool = matrix(self.robot["tool_placement"])
        rows = [
            (("link", shape["link"]), shape["body"], shape["shape"], matrix(shape["pose"]))
            if shape["link"] not in grip["links"]
            else (("link", shape["link"]), *next(fingers))
            for shape in self.robot["shapes"]
        ]
        rows += [
            (("object", it["name"]), self.robot["tool_body"], it["shape"], tool @ matrix(it["pose"])) for it in hold
        ]
        rows += [(("object", it["name"]), -1, it["shape"], matrix(it["pose"])) for it in stand]
        for owner, link, solid, at in rows:
            for geometry, frame in solids(solid, at):
                geometry.computeLocalAABB()
                middle = shifted(geometry.aabb_center)
                found.append(Body(owner, link, geometry, frame @ middle, float(geometry.aabb_radius)))
        return found

    def fingers(self, width: float) -> list[tuple[int, Json, Array]]:
        grip = self.robot["gripper"] or {"closed": []}
        kind = grip.get("kind", "parallel")
        if kind == "parallel":
            ways = zip(grip["closed"], grip.get("directions", []), strict=True)
            return [
                (it["body"], it["shape"], shifted(np.array(way) * width / 2) @ matrix(it["pose"])) for it, way in ways
            ]
        if kind == "vacuum":
            return [(it["body"], it["shape"], matrix(it["pose"])) for it in grip["closed"]]
        low, high = grip["positions"]
        if grip["lower"] < width < grip["upper"]:
            for _ in range(60):
                middle = (low + high) / 2
                low, high = (middle, high) if self._gap(middle) < width else (low, middle)
        else:
            low = high = grip["positions"][0 if width <= grip["lower"] else 1]
        return self._turned((low + high) / 2)

    def _turned(self, x: float) -> list[tuple[int, Json, Array]]:
        found = []
        for it, turns in zip(self.robot["gripper"]["closed"], self.robot["gripper"]["turns"], strict=True):
            T = matrix(it["pose"])
            for turn in reversed(turns):
                R = pin.AngleAxis(turn["ratio"] * x, np.array(turn["axis"], float)).matrix()
                T = shifted(turn["point"]) @ pin.SE3(R, np.zeros(3)).homogeneous @ shifted(-np.array(turn["point"])) @ T
            found.append((it["body"], it["shape"], T))
        return found

    def _gap(self, x: float) -> float:
        grip, across, gap = self.robot["gripper"], np.array(self.robot["gripper"]["across"], float), 0.0
        turned = list(zip(grip["closed"], self._turned(x), strict=True))
        for tip, n in zip(grip["tips"], (across, -across), strict=True):
            gap -= max(extent(g, T, n) for it, (_, s, at) in turned if it["link"] == tip for g, T in solids(s, at))
        return gap


def extent(geometry: Any, at: Array, n: Array) -> float:
    """How far one of Coal's shapes reaches along a direction: what is left to a plane far ahead."""
    result = coal.DistanceResult()
    ahead = coal.Halfspace(-n, -10.0)  # all that is 10 m ahead or more
    coal.distance(
        geometry, coal.Transform3s(at[:3, :3], at[:3, 3]), ahead, coal.Transform3s(), coal.DistanceRequest(), result
    )
    return 10.0 - float(result.min_distance)


def curve(path: Json, count: int) -> tuple[Array, Array]:
    """Places s (m,) along a path and configurations there (m, n)."""
    points, blends = np.array(path["waypoints"], float), np.array(path["blends"], float)
    if not len(blends):
        blends = np.zeros(len(points))
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    knots = np.concatenate([[0.0], np.cumsum(lengths)])
    tangents = steps / np.where(lengths > 0, lengths, 1.0)[:, None]
    places = [np.linspace(0.0, knots[-1], count), knots]
    places += [np.linspace(k - d, k + d, FINE + 1) for k, d in zip(knots, blends, strict=True) if d > 0]
    s = np.unique(np.clip(np.concatenate(places), 0.0, knots[-1]))
    middle = (s[1:] + s[:-1]) / 2

    def slope(at: Array) -> Array:
        piece = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(tangents) - 1)
        out = tangents[piece].copy()
        for k in range(1, len(points) - 1):
            if blends[k] > 0:
                y = (at - knots[k]) / blends[k]
                on = np.abs(y) < 1
                f = 0.5 + (5 * y[on] - y[on] ** 5) / 8
                out[on] = tangents[k - 1] + (tangents[k] - tangents[k - 1]) * f[:, None]
        return out

    h = np.diff(s)[:, None]
    gauss = h * math.sqrt(3 / 5) / 2
    rate = (5 * slope(middle - gauss[:, 0]) + 8 * slope(middle) + 5 * slope(middle + gauss[:, 0])) / 18
    return s, points[0] + np.concatenate([np.zeros((1, points.shape[1])), np.cumsum(h * rate, axis=0)])


def objections(document: Json, samples: int = 200) -> list[str]:
    """What was found to be false in a plan or task file."""
    return list(_objections(document, samples))


def _objections(document: Json, samples: int) -> Iterator[str]:
    robot, request, arm = document["robot"], document["request"], Arm(document["robot"])
    plan = {"name": "motion", "gripper_width": robot["gripper_width"], "scene": None, "gripper": None}
    segments = document["segments"] if "segments" in document else [plan | {"result": document["result"]}]
    stand = {it["name"]: it for it in document["scene"]["obstacles"]}
    hold, width, before = document["scene"]["attached"], robot["gripper_width"], None
    for number, segment in enumerate(segments):
        name, result = segment["name"], segment["result"]
        s, Q = curve(result["path"], samples)
        moves, claimed = (it["part"] or (0.0, s[-1]) for it in (result["trajectory"], result["certificate"]))
        begin, stop = (np.array([np.interp(at, s, column) for column in Q.T]) for at in moves)
        if moves[0] < claimed[0] - 1e-6 or moves[1] > claimed[1] + 1e-6:
            yield f"{name}: moves where nothing is claimed"
        if before is not None and np.abs(begin - before).max() > AWAY:
            yield f"{name}: jumps at its start"
        wide = segment["gripper_width"] if robot["gripper"] else width
        if before is not None:
            now = (segment["scene"] or {"attached": hold})["attached"]
            there, tool = dict(stand), arm.tool(before)
            for it in now:
                if it not in hold:
                    was = there.pop(it["name"], None)
                    if was is None or was["shape"] != it["shape"]:
                        yield f"{name}: {it['name']} is held and did not stand there"
                    elif np.abs(tool @ matrix(it["pose"]) - matrix(was["pose"])).max() > AWAY:
                        yield f"{name}: {it['name']} is held elsewhere than it was taken"
            for it in hold:
                if it not in now:
                    there[it["name"]] = {**it, "pose": (tool @ matrix(it["pose"])).tolist()}
        else:
            now, there = hold, stand
        if number == 0 and segment["scene"] and segment["scene"]["attached"] != hold:
            yield f"{name}: holds something else at the start"
        if segment["scene"]:
            first = {it["name"]: it for it in document["scene"]["obstacles"]}
            told = {it if isinstance(it, str) else it["name"]: it for it in segment["scene"]["obstacles"]}
            if told.keys() != there.keys():
                yield f"{name}: says that other things stand there"
            for key in told.keys() & there.keys():
                it = first.get(key, {"shape": None}) if isinstance(told[key], str) else told[key]
                if (
                    it["shape"] != there[key]["shape"]
                    or np.abs(matrix(it["pose"]) - matrix(there[key]["pose"])).max() > AWAY
                ):
                    yield f"{name}: says that {key} is elsewhere or something else"
        if wide != width:
            grip = (segment["gripper"] or {"certificate": result["certificate"]})["certificate"]
            taken = {("object", it["name"]) for it in (*now, *hold) if it not in hold or it not in now}
            fingers = {("link", link) for link in robot["gripper"]["links"]}
            for part in np.linspace(width, wide, 5):
                bodies = arm.bodies(list(stand.values()), hold, float(part))
                still = [0.0], begin[None]
                yield from touching(arm, bodies, *still, document, hold, grip, f"gripper before {name}", fingers, taken)
        stand, hold, width, before = there, now, wide, stop
        bodies = arm.bodies(list(stand.values()), hold, width)
        yield from touching(arm, bodies, s, Q, document, hold, result["certificate"], name)
        yield from beyond(robot, request, result, Q, name)
        asked = [*result.get("constraints", []), *((request or {}).get("constraints", []))]
        asked += [each for it in hold for each in it.get("constraints", [])]
        yield from unkept(arm, asked, Q, name)
    if request is not None and "segments" not in document:
        yield from elsewhere(arm, request, segments[0]["result"], begin, stop)


def touching(
    arm: Arm,
    bodies: list[Body],
    s: Any,
    Q: Array,
    document: Json,
    hold: Json,
    certificate: Json,
    name: str,
    fingers: Any = None,
    taken: Any = (),
) -> Iterator[str]:
    """Pairs that are nearer than a certificate claims, or touch deeper than is meant where they are exempt."""
    robot, part = document["robot"], certificate["part"]
    claimed = certificate["clearance"]
    names = {kind: {body.owner[1] for body in bodies if body.owner[0] == kind} for kind in ("link", "object")}
    label = {
        body.owner: body.owner[1] + (f" ({body.owner[0]})" if body.owner[1] in names["link"] & names["object"] else "")
        for body in bodies
    }
    may = {frozenset((("link", a), ("link", b))) for a, b in (each["links"] for each in robot["allowed_contacts"])}
    may |= {frozenset((("object", it["name"]), ("link", link))) for it in hold for link in it["touch_links"]}
    held = {("object", it["name"]) for it in hold}
    lower = np.array([b.radius for b in bodies])
    pairs = list[tuple[int, int]]()
    for i, j in combinations(range(len(bodies)), 2):
        a, b = bodies[i], bodies[j]
        if a.owner == b.owner or frozenset((a.owner, b.owner)) in may or (a.owner in held and b.owner in held):
            continue
        if a.link == b.link and (a.owner in held) == (b.owner in held):
            continue
        if max(a.link, b.link) <= 0:
            continue
        if fingers is not None and not {a.owner, b.owner} & fingers:
            continue
        if sorted((label[a.owner], label[b.owner])) in [sorted(pair) for pair in document["allowed"]]:
            continue
        pairs.append((i, j))
    if not pairs:
        return
    near = 1e9 if claimed is None else claimed
    ij = np.array(pairs)
    places = np.array([body.link for body in bodies])
    at = np.array([body.at for body in bodies])
    seen = set[tuple[str, str]]()
    for k, q in zip(s, Q, strict=True):
        if part is not None and not part[0] - 1e-9 <= k <= part[1] + 1e-9:
            continue
        frames = np.array([*arm.frames(q), np.eye(4)])[places] @ at  # the last is the world's
        middle = frames[:, :3, 3]
        apart = np.linalg.norm(middle[ij[:, 0]] - middle[ij[:, 1]], axis=1) - lower[ij].sum(axis=1)
        for i, j in ij[apart < min(near, 1.0)].tolist():
            a, b = bodies[i], bodies[j]
            both = (label[a.owner], label[b.owner])
            if both in seen:
                continue
            depth = None
            for each in certificate["exempt"]:
                if each["s_start"] - 1e-9 <= k <= each["s_end"] + 1e-9 and set(both) in map(set, each["pairs"]):
                    depth = max(depth or 0.0, MEANT if each.get("depth") is None else each["depth"] + NEAR)
            if fingers is not None and {a.owner, b.owner} & set(taken):
                depth = MEANT
            gap = distance(a, frames[i], b, frames[j])
            if gap < (near - NEAR if depth is None else -depth):
                seen.add(both)
                most = f"{1e3 * near:.3f} mm claimed" if depth is None else f"{1e3 * depth:.3f} mm deep at most"
                yield f"{name}: {both[0]} x {both[1]}: {1e3 * gap:.3f} mm at s = {k:.6g}, {most}"


def distance(a: Body, A: Array, b: Body, B: Array) -> float:
    """Signed, by Coal; frames are of the middles of the boxes around both."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.enable_signed_distance = True
    at = [coal.Transform3s(T[:3, :3], T[:3, 3] - T[:3, :3] @ body.geometry.aabb_center) for body, T in ((a, A), (b, B))]
    coal.distance(a.geometry, at[0], b.geometry, at[1], request, result)
    return float(result.min_distance)


def beyond(robot: Json, request: Json, result: Json, Q: Array, name: str) -> Iterator[str]:
    """Limits of joints that are left, and speeds and accelerations that are exceeded, by differences."""
    endless = np.array(robot.get("continuous") or [False] * Q.shape[1])
    limits = {key: np.array(value, float) for key, value in robot["limits"].items()}
    low, high = np.where(endless, -1000.0, limits["lower"]), np.where(endless, 1000.0, limits["upper"])
    if (low - 1e-6 > Q).any() or (high + 1e-6 < Q).any():
        yield f"{name}: a joint leaves its limits"
    law = result["trajectory"]
    h, c = np.array(law["durations"], float), np.array(law["coefficients"], float).reshape(-1, 4)
    if not len(h):
        if result["path"]["length"] > 1e-9:
            yield f"{name}: has no time"
        return
    s, path = curve(result["path"], 20_000)
    knots = np.concatenate([[0.0], np.cumsum(h)])
    total = knots[-1]
    if abs(total - law["duration"]) > 1e-6 * (1 + total):
        yield f"{name}: takes another time than it says"
    step = min(1e-3, total / 200)
    t = np.arange(0.0, total, step)
    piece = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(h) - 1)
    x = t - knots[piece]
    at = (c[piece] * x[:, None] ** np.arange(4)).sum(axis=1)
    begin, end = law["part"] or (0.0, s[-1])
    ends = (c * h[:, None] ** np.arange(4)).sum(axis=1)
    if abs(at[0] - begin) > 1e-6 or abs(ends[-1] - end) > 1e-6 or np.abs(ends[:-1] - c[1:, 0]).max(initial=0) > 1e-6:
        yield f"{name}: s(t) jumps or does not run from end to end"
    if (np.diff(at) < -1e-6).any():
        yield f"{name}: s(t) turns back"
    if law["part"] is None and abs(c[0, 1]) > 1e-5:
        yield f"{name}: begins at speed"
    if abs(c[-1, 1:] @ (np.arange(1, 4) * h[-1] ** np.arange(3))) > 1e-5:
        yield f"{name}: ends at speed"
    q = np.column_stack([np.interp(at, s, column) for column in path.T])
    v = np.diff(q, axis=0) / step
    scales = (1.0, 1.0)
    if request is not None and not (law["part"] is not None and c[0, 1] > 0):
        scales = (request["velocity_scale"], request["acceleration_scale"])
    if (np.abs(v) > scales[0] * limits["velocity"] * 1.001 + 1e-4).any():
        yield f"{name}: a joint is too fast"
    many = max(1, round(0.01 / step))
    if len(v) > 2 * many:
        a = (v[many:] - v[:-many]) / (many * step)
        if (np.abs(a) > scales[1] * limits["acceleration"] * 1.02 + 0.05).any():
            yield f"{name}: a joint accelerates too much"


def unkept(arm: Arm, asked: Json, Q: Array, name: str) -> Iterator[str]:
    """Constraints that do not hold somewhere."""
    robot = arm.robot
    frames = {it["link"]: (it["body"], matrix(it["pose"])) for it in robot.get("link_frames", [])}
    for each in asked:
        if each["kind"] == "joint range":
            column = Q[:, robot["joint_names"].index(each["joint"])]
            if column.min() < each["lower"] - 1e-6 or column.max() > each["upper"] + 1e-6:
                yield f"{name}: {each['joint']} leaves its range"
            continue
        own = (robot["tool_body"], matrix(robot["tool_placement"])) if each["link"] is None else frames[each["link"]]
        base = (0, np.eye(4)) if each["relative_to"] is None else frames[each["relative_to"]]
        for q in Q[:: max(1, len(Q) // 60)]:
            at = arm.frames(q)
            region = at[base[0]] @ base[1] @ matrix(each["frame"])
            T = np.linalg.inv(region) @ at[own[0]] @ own[1] @ matrix(each["tool"])
            low = [-math.inf if x is None else x - 1e-6 for x in each["lower"]]
            high = [math.inf if x is None else x + 1e-6 for x in each["upper"]]
            tilt = math.acos(min(1.0, max(-1.0, T[2, 2])))
            turn = abs(math.atan2(T[1, 0] - T[0, 1], T[0, 0] + T[1, 1]))
            if (T[:3, 3] < low).any() or (T[:3, 3] > high).any():
                yield f"{name}: {each['name']} is left"
                break
            if tilt > (math.pi if each["tilt"] is None else each["tilt"] + 1e-5):
                yield f"{name}: {each['name']} tilts too far"
                break
            if each["turn"] is not None and turn > each["turn"] + 1e-5:
                yield f"{name}: {each['name']} turns too far"
                break


def elsewhere(arm: Arm, request: Json, result: Json, begin: Array, stop: Array) -> Iterator[str]:
    """Ends of a motion, which may be on the way along its path, that are not those of the request."""
    near, turns = request["start_tolerance"] + AWAY, np.array(arm.robot.get("continuous") or [False] * len(begin))

    def off(q: Json, end: Array) -> float:
        far = np.abs(np.array(q, float) - end)
        return float(np.where(turns, np.minimum(far % (2 * math.pi), 2 * math.pi - far % (2 * math.pi)), far).max())

    if result["trajectory"]["part"] is None and off(request["start"], begin) > near:
        yield "begins elsewhere than asked"
    index = result["goal_index"]
    if index is None:
        return
    goal = request["goals"][index]
    if "joints" in goal and off(goal["joints"], stop) > near:
        yield "ends elsewhere than asked"
    posed = "pose" in goal and goal["room"] is None
    if posed and np.abs(arm.tool(stop) - matrix(goal["pose"])).max() > 10 * AWAY:
        yield "the tool ends elsewhere than asked"


def no_path_objections(document: Json, walls: int = 60, ways: int = 40) -> list[str]:
    """What was found to be false in a proof of no path: walls that do not collide, straight ways that are free."""
    robot, chance = document["robot"], np.random.default_rng(0)
    arm, k = Arm(robot), len(document["joints"])
    bodies = arm.bodies(document["scene"]["obstacles"], document["scene"]["attached"], robot["gripper_width"])
    columns = [robot["joint_names"].index(name) for name in document["joints"]]
    lower, upper = (np.array(robot["limits"][side], float) for side in ("lower", "upper"))
    low, high = np.array(document["range"], float)
    table = np.frombuffer(zlib.decompress(base64.b64decode(document["walls"])), "<i8").reshape(-1, 2 * k + 1)
    places, found = np.array([body.link for body in bodies]), list[str]()
    at = np.array([body.at for body in bodies])

    def frames(q: Array) -> Array:
        return np.array([*arm.frames(q), np.eye(4)])[places] @ at

    for row in table[chance.integers(0, len(table), walls)] if len(table) else ():
        corners = row[: 2 * k].reshape(2, k) / document["divisions"]
        q = chance.uniform(lower, upper)
        q[columns] = low + (high - low) * chance.uniform(*corners)
        pair, T = document["pairs"][int(row[-1])], frames(q)
        named = [[i for i, body in enumerate(bodies) if body.owner[1] == name.split(" (")[0]] for name in pair]
        gaps = [distance(bodies[i], T[i], bodies[j], T[j]) for i in named[0] for j in named[1] if i != j]
        if min(gaps, default=1.0) > NEAR:
            found.append(f"{pair} do not touch in a wall")
            break
    claim: Json = {"clearance": 1e-4, "part": None, "exempt": []}
    for goal in document["goals"]:
        for _ in range(ways):
            points = np.array([document["start"], chance.uniform(lower, upper), goal], float)
            points = points if chance.random() < 0.9 else points[[0, 2]]
            Q = np.vstack([np.linspace(a, b, 60) for a, b in pairwise(points)])
            if not list(
                touching(arm, bodies, np.zeros(len(Q)), Q, document, document["scene"]["attached"], claim, "way")
            ):
                found.append(f"a way from {document['start']} to {goal} is free")
                break
    return found
