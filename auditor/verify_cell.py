"""Checks the evidence in the plan of a cell: each motion by itself, and each two arms over both of their clocks.

The arms of a cell are put together as one robot, whose pieces trails number. Each motion has a trail as a plan has, for
what it moves, beside all that stands all the time; what another motion moves is left out there.

Lemma (lateness). Arm i begins at b_i and takes T_i seconds; at time t, late by l_i(t), it is where its motion is at
``clip(t - b_i - l_i(t), 0, T_i)``. If all l are in [0, d], two arms are always at a pair (clip(x), clip(y)) with
``x - y`` in [L, H], ``L = b_j - b_i - d`` and ``H = b_j - b_i + d``, for x - y = b_j - b_i + l_j - l_i. These pairs are
the points (x, y) of the rectangle of both motions with x - y in [L, H]; and on its sides (0, y) for y <= -L, (x, 0) for
x <= H, (T_i, y) for y >= T_i - H, and (x, T_j) for x >= T_j + L; and the corners (0, 0) and (T_i, T_j). Proof: clip one
or both; on the side x = 0 it is x' <= 0, so that y >= x' - H and y <= x' - L with any such x', and x' = 0 gives the
largest; likewise on the others. So rectangles that hold all of these points hold all pairs that occur.

Lemma (rectangle). On a stretch of arm i's motion and one of arm j's, s in the middle of each, a direction n shows a
gap g of two pieces there. No point of the one moves from the middle to anywhere on its stretch by more than the sum of
``World.levers`` times how far each joint moves on the farther half of it. So n shows g less both sums at every pair of
places of the two stretches, whichever they are. s(t) is monotone (time_law.py), so that stretches of time are stretches
of s.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np

from auditor.schema import Invalid, check_file, require
from auditor.time_law import NEAR, cubic, in_time
from auditor.trails import (
    LEAST_CLAIM,
    MOST_ENTRIES,
    MOST_WORK,
    ROUNDING,
    SLACK,
    Curve,
    Solid,
    World,
    chain,
    digest,
    frame,
    placed,
    shown,
    unpacked,
)
from auditor.verify import MOST_TURNED, Motion, close, excused, reached, tool_at
from auditor.verify_constraints import kept

__all__ = ["verify"]

Array = Any
Json = Any

SEEN = (
    "clearance of each motion and of each two arms for all delays up to what is claimed, limits of joints, their "
    "speeds and accelerations, s(t), where arms stand, start and goals of motions that have a request, tools that end "
    "at other arms' tools, constraints"
)
UNSEEN = (
    "padding away from the ends, torques, jerk, the speed of the tool, hashes, dilation, reports of counts, times, "
    "peaks and margins"
)
MOST_ARMS = 4


class Arm(NamedTuple):
    """An arm in the whole: its joints there, its tool, its ways out of named poses, these, and what it holds."""

    name: str
    columns: list[int]
    tool: tuple[int, Array]
    retreats: Json
    named_poses: Json
    carried: Json


class Cell(World):
    """The whole; ``judged`` says which pairs a proof is about: which of the arms that move may move the two."""

    judged: frozenset[str] = frozenset()
    movers: dict[int, frozenset[str]]

    def wanted(self) -> Iterator[tuple[Solid, Solid]]:
        for one, two in super().wanted():
            if self.movers[one.body] | self.movers[two.body] <= self.judged:
                yield one, two


class Moving(NamedTuple):
    """A motion of some arms: its curve in the whole, and s(t) as cubics c (k, 4) of durations h (k,)."""

    arms: list[str]
    start: float
    curve: Curve
    h: Array
    c: Array

    @property
    def duration(self) -> float:
        return float(self.h.sum())

    def s(self, t: Array) -> Array:
        """s at times (m,)."""
        if not len(self.h):
            return np.zeros(len(t))
        ends = np.cumsum(self.h)
        k = np.minimum(np.searchsorted(ends, t, "right"), len(ends) - 1)
        return np.clip(cubic(self.c[k], t - (ends - self.h)[k]), 0.0, self.curve.length)


def verify(document: Json) -> Iterator[str]:
    """What the evidence of a cell's plan shows, line by line; Invalid if that is not all that the file claims."""
    check_file(document)
    section, robots, scene = document["sections"]["evidence"], document["robots"], document["scene"]
    require(document["version"] == 1 and section["version"] == 1, "a file or evidence of another version")
    require(section["robots"] == [digest(robot) for robot in robots], "the evidence is for other robots")
    require(section["scene"] == digest(scene), "the evidence is for another scene")
    require(not scene["attached"], "something that is carried by no arm")
    yield from (f"robot {k}: {robot}" for k, robot in enumerate(section["robots"]))
    yield f"scene {section['scene']}"
    whole, arms = together(document, section["moved"])
    for each in document["arms"]:
        place = json.dumps(each["base"]) if "base" in each else f"joints {each['joints']}"
        yield f"{each['name']}: robot {each['robot']}, {place}"
        for it in each.get("carried", ()):
            yield f"{each['name']}: holds {it['name']}, not judged with {it['touch_links']}"
    n, still = len(whole["joint_names"]), np.array(document["still"], float)
    require(len(still) == n, "places of other joints")
    lower, upper = limits_of(whole)
    require((still >= lower - SLACK) & (still <= upper + SLACK), "an arm stands outside its limits")
    moved = [name for clock in document["clocks"] for name in clock["arms"]]
    require(bool(moved) and all(clock["arms"] for clock in document["clocks"]), "no motion, or one of no arm")
    require(len({*moved}) == len(moved) and {*moved} <= arms.keys(), "an arm that is not there, or moves twice")
    world = Cell(whole, scene["obstacles"], [], [], section["boxes"], 0.0)
    world.movers = {
        body: frozenset(
            name
            for name in moved
            for k in chain(world.bodies, body)
            if world.bodies[k]["q_index"] in arms[name].columns
        )
        for body in range(len(world.bodies))
    }
    require([len(those) < 2 for those in world.movers.values()], "arms that carry each other")
    require(len(section["proofs"]) == len(document["clocks"]), "other motions than the evidence is for")
    moving = []
    for clock, proof in zip(document["clocks"], section["proofs"], strict=True):
        name = " and ".join(clock["arms"])
        try:
            motion, lines = alone(document, whole, world, arms, still, clock, proof)
        except (Invalid, LookupError, ValueError) as why:
            raise Invalid(f"{name}: {why.args[0]}") from why
        moving.append(motion)
        yield f"{name}: from {motion.start:.6g} s, {lines[0]}"
        yield from (f"  {line}" for line in lines[1:])
    late = math.inf if document["tolerates"] is None else float(document["tolerates"])
    require(late >= 0, "a delay below 0")
    yield from both(document, section, world, arms, still, moving, late)
    yield from at_tools(document, whole, arms, still, moving)
    standing = [name for name in arms if name not in moved]
    for name in standing:
        yield f"{name}: stands at {still[arms[name].columns].tolist()}"
    yield from (f"never judged: {contact['links']} ({contact['reason']})" for contact in whole["allowed_contacts"])
    others = [f"the section {name}" for name in document["sections"] if name != "evidence"]
    yield f"verified: {SEEN}; not verified: {', '.join([UNSEEN, *others])}"


def limits_of(robot: Json) -> tuple[Array, Array]:
    """Least and largest values of joints."""
    endless = np.array(robot["continuous"])
    values = np.array([robot["limits"]["lower"], robot["limits"]["upper"]], float)
    lower, upper = np.where(endless, [[-MOST_TURNED], [MOST_TURNED]], values)
    return lower, upper


def together(document: Json, moved: Sequence[float]) -> tuple[Json, dict[str, Arm]]:
    """All arms as one robot without a gripper, fingers being parts of what carries them, and the arms by name."""
    robots, names = document["robots"], [each["name"] for each in document["arms"]]
    require(0 < len(names) <= MOST_ARMS and len({*names}) == len(names), "no arms, or two of one name")
    require([0 <= each["robot"] < len(robots) for each in document["arms"]], "a robot that is not there")
    require(len(moved) == len(robots), "fingers of other robots")
    for robot in robots:
        n = len(robot["joint_names"])
        continuous = robot.get("continuous") or [False] * n
        require([len(row) == n for row in (continuous, *robot["limits"].values())], "limits of other joints")
        require(len({*robot["joint_names"]}) == n, "two joints of one name")
    if all("joints" in each for each in document["arms"]):
        require(len(robots) == 1, "arms of several robots that have no place")
        return of_one(document, moved[0])
    require(["base" in each for each in document["arms"]], "an arm without a place")
    whole: Json = {key: [] for key in ("bodies", "joint_names", "shapes", "allowed_contacts", "link_frames")}
    whole |= {"limits": {key: [] for key in robots[0]["limits"]}, "continuous": [], "gripper": None}
    whole |= {"tool_body": 0, "tool_placement": np.eye(4).tolist(), "retreats": [], "named_poses": []}
    arms: dict[str, Arm] = {}
    for each in document["arms"]:
        robot, name, base = robots[each["robot"]], each["name"], frame(each["base"])
        tool = robot["tool_body"], frame(robot["tool_placement"])
        robot = holding(robot, each.get("carried", []), "", *tool)
        still = stiff(robot, moved[each["robot"]])
        bodies, joints = max(len(whole["bodies"]) - 1, 0), len(whole["joint_names"])

        def at(item: Json, key: str, fixed: bool, base: Array = base) -> Json:
            return ((base if fixed else np.eye(4)) @ frame(item[key])).tolist()

        def shifted(body: int, bodies: int = bodies) -> int:
            return body + bodies if body > 0 else body

        whole["bodies"] += robot["bodies"][:1] if not whole["bodies"] else []
        for body in robot["bodies"][1:]:
            own = {"placement": at(body, "placement", body["parent"] == 0), "q_index": body["q_index"] + joints}
            require(0 <= body["q_index"] < len(robot["joint_names"]), "a body that is moved by no joint")
            require(0 <= body["parent"] < len(robot["bodies"]), "a body before its parent")
            whole["bodies"].append({**body, **own, "parent": shifted(body["parent"])})
        for key, items in (("shapes", still["shapes"]), ("link_frames", robot.get("link_frames", []))):
            for item in items:
                require(0 <= item["body"] < len(robot["bodies"]), "a link on a body that is not there")
                own = {"link": f"{name}_{item['link']}", "body": shifted(item["body"])}
                whole[key].append({**item, **own, "pose": at(item, "pose", item["body"] == 0)})
        whole["allowed_contacts"] += [renamed(contact, name, "links") for contact in robot["allowed_contacts"]]
        whole["joint_names"] += [f"{name}_{joint}" for joint in robot["joint_names"]]
        whole["continuous"] += robot.get("continuous") or [False] * len(robot["joint_names"])
        for key, values in robot["limits"].items():
            whole["limits"][key] += values
        columns = [*range(joints, len(whole["joint_names"]))]
        require(0 <= tool[0] < len(robot["bodies"]), "a tool on a body that is not there")
        placed_tool = shifted(tool[0]), (base if tool[0] == 0 else np.eye(4)) @ tool[1]
        ways = [
            way | {"pairs": [renamed({"pair": p}, name, "pair")["pair"] for p in way["pairs"]]}
            for way in robot["retreats"]
        ]
        arms[name] = Arm(name, columns, placed_tool, ways, robot["named_poses"], each.get("carried", []))
    links = [
        {
            f"{name}_{it['link']}"
            for it in (*robots[each["robot"]]["shapes"], *robots[each["robot"]].get("link_frames", []))
        }
        for name, each in zip(names, document["arms"], strict=True)
    ]
    require(len({*whole["joint_names"]}) == len(whole["joint_names"]), "names that do not keep arms apart")
    require([not one & two for one, two in combinations(links, 2)], "names that do not keep arms apart")
    return whole, arms


def renamed(item: Json, name: str, key: str) -> Json:
    return {**item, key: [f"{name}_{link}" for link in item[key]]}


def holding(robot: Json, carried: Json, prefix: str, body: int, tool: Array) -> Json:
    """The robot with what an arm holds at its tool as links, which may touch their touch links."""
    shapes, contacts = [*robot["shapes"]], [*robot["allowed_contacts"]]
    links = {it["link"] for it in shapes}
    for it in carried:
        link, solid, at = prefix + it["name"], it["shape"], tool @ frame(it["pose"])
        known = {*(shape["link"] for shape in shapes), *(each["link"] for each in robot.get("link_frames", []))}
        require(link not in known, f"{link}: held, and a link")
        require({*it["touch_links"]} <= links, f"{link}: touches a link that is not there")
        parts = solid["parts"] if solid["kind"] == "compound" else [{"shape": solid, "pose": np.eye(4).tolist()}]
        require(
            [part["shape"]["kind"] not in ("compound", "cloud", "heights") for part in parts], f"{link}: not convex"
        )
        own = {"link": link, "body": body}
        shapes += [own | {"shape": part["shape"], "pose": (at @ frame(part["pose"])).tolist()} for part in parts]
        contacts += [{"links": [link, touched], "reason": "it is held there"} for touched in it["touch_links"]]
    return {**robot, "shapes": shapes, "allowed_contacts": contacts}


def stiff(robot: Json, x: float) -> Json:
    """The robot without a gripper: its fingers, moved by x, are parts of what carries them."""
    hand = World(robot, (), (), (), {}, x)
    require(hand.stands(robot["gripper_width"]), "fingers elsewhere")
    shapes = [
        {"link": shape["link"], "body": it.body, "shape": it.record, "pose": it.at.tolist()}
        for shape, it in zip(robot["shapes"], hand.solids, strict=True)
    ]
    return {**robot, "shapes": shapes, "gripper": None}


def of_one(document: Json, moved: float) -> tuple[Json, dict[str, Arm]]:
    """The same of one robot with several arms."""
    (robot,) = document["robots"]
    joints = robot["joint_names"]
    frames = {item["link"]: (item["body"], frame(item["pose"])) for item in robot.get("link_frames", [])}
    tool = robot["tool_body"], frame(robot["tool_placement"])
    for each in document["arms"]:
        own = frames[each["tool"]] if "tool" in each else tool
        robot = holding(robot, each.get("carried", []), f"{each['name']}_", *own)
    whole = {**stiff(robot, moved), "continuous": robot.get("continuous") or [False] * len(joints)}
    taken, arms = list[str](), dict[str, Arm]()
    for each in document["arms"]:
        there = bool(each["joints"]) and {*each["joints"]} <= {*joints}
        require(there, f"{each['name']}: joints that are not there")
        taken += each["joints"]
        columns = sorted(joints.index(joint) for joint in each["joints"])
        own = frames[each["tool"]] if "tool" in each else tool
        arms[each["name"]] = Arm(each["name"], columns, own, [], [], each.get("carried", []))
    require(len({*taken}) == len(taken), "a joint of two arms")
    return whole, arms


def alone(
    document: Json, whole: Json, world: Cell, arms: dict[str, Arm], still: Array, clock: Json, proof: Json
) -> tuple[Moving, list[str]]:
    """A motion by itself, beside what stands all the time, and what is shown of it, line by line."""
    result, asked, shared = clock["result"], clock["request"], len(clock["arms"]) > 1
    columns = [*range(len(still))] if shared else arms[clock["arms"][0]].columns
    points = np.array(result["path"]["waypoints"], float)
    require(points.ndim == 2 and points.shape[1] == len(columns), "not of these joints")
    spread = np.repeat(still[None], len(points), axis=0)
    spread[:, columns] = points
    if shared:
        own = [column for name in clock["arms"] for column in arms[name].columns]
        rest = np.delete(spread, own, axis=1)
        require(np.abs(rest - np.delete(still, own)) <= SLACK, "it moves other arms, too")
    require(np.abs(spread[0] - still) <= SLACK, "it does not begin where its arms stand")
    lower, upper = limits_of(whole)
    require((spread >= lower - SLACK) & (spread <= upper + SLACK), "a joint leaves its limits")
    require(clock["start"] >= 0, "it starts before the start")
    claim, curve = result["certificate"], Curve(spread, result["path"]["blends"])
    require(claim["certified"] and result["ok"], "a certificate that is none")
    same = all(claim[key] == proof[key] for key in ("clearance", "padding", "exempt", "part"))
    require(same, "the certificate claims something else than the evidence")
    require(proof["part"] is None and result["trajectory"]["part"] is None, "a part of a motion")
    world.judged, world.tool = frozenset(clock["arms"]), arms[clock["arms"][0]].tool
    robot = seen_by(whole, arms, clock["arms"], still)
    motion = Motion(0, "motion", spread, result["path"]["blends"], result, claim, None, [0.0, 0.0], [], [], ("", ""))
    rules = [*excused(world, curve, motion, robot, proof["exempt"], asked)]
    least = shown(world, proof, curve, 0.0, curve.length)
    constraints = [each for having in (result, asked or {}) for each in having.get("constraints", ())]
    fingers = Curve(np.column_stack([spread, np.zeros(len(spread))]), result["path"]["blends"])  # which do not move
    for constraint in constraints:
        kept(world, robot, constraint, fingers, 0.0, curve.length)
    for name in clock["arms"]:
        world.tool = arms[name].tool
        for constraint in (each for held in arms[name].carried for each in held.get("constraints", ())):
            kept(world, robot, constraint, fingers, 0.0, curve.length)
            constraints.append(constraint)
    limits = {key: np.array(values, float)[columns].tolist() for key, values in whole["limits"].items()}
    paced = in_time({"limits": limits}, result, asked, Curve(points, result["path"]["blends"]))
    ends = [*reached({"request": spread_request(asked, still, columns), "robot": robot}, motion)]
    h = np.array(result["trajectory"]["durations"], float)
    c = np.array(result["trajectory"]["coefficients"], float).reshape(-1, 4)
    lines = [f"{1e3 * least:.4f} mm" if least < math.inf else "nothing can collide", *paced, *rules, *ends]
    lines += [f"kept: {json.dumps(constraint)}" for constraint in constraints]
    return Moving(clock["arms"], float(clock["start"]), curve, h, c), lines


def at_tools(
    document: Json, whole: Json, arms: dict[str, Arm], still: Array, moving: Sequence[Moving]
) -> Iterator[str]:
    """Whether tools that were to be somewhere in another arm's tool frame are there when all arms are through."""
    end = still.copy()
    for motion in moving:
        for columns in (arms[name].columns for name in motion.arms):
            end[columns] = motion.curve.points[-1][columns]

    def tool(name: str) -> Array:
        body, at = arms[name].tool
        return tool_at({**whole, "tool_body": body, "tool_placement": at.tolist()}, end)

    for each in document["arms"]:
        if "at_tool" in each:
            name, other = each["name"], each["at_tool"]["arm"]
            require(other in arms and other != name, f"{name}: at the tool of no other arm")
            there = close(tool(name), tool(other) @ frame(each["at_tool"]["pose"]))
            require(there, f"{name}: its tool does not end where it was to be at {other}")
            yield f"{name}: its tool ends at {json.dumps(each['at_tool'])}"


def seen_by(whole: Json, arms: dict[str, Arm], moved: Sequence[str], still: Array) -> Json:
    """The whole with one arm's tool and its ways out of named poses; of several none of these."""
    body, at = arms[moved[0]].tool
    robot = {**whole, "tool_body": body, "tool_placement": at.tolist(), "retreats": [], "named_poses": []}
    if len(moved) == 1:
        arm = arms[moved[0]]
        poses = {pose["name"]: spread_q(pose["q"], still, arm.columns) for pose in arm.named_poses}
        robot["named_poses"] = [{"name": name, "q": q} for name, q in poses.items()]
        robot["retreats"] = [way | {"to": spread_q(way["to"], still, arm.columns)} for way in arm.retreats]
    elif not any(arm.named_poses for arm in arms.values()):  # one robot with several arms
        robot |= {key: whole[key] for key in ("retreats", "named_poses")}
    return robot


def spread_q(q: Json, still: Array, columns: Sequence[int]) -> list[float]:
    """Joints of an arm among those of the whole."""
    require(len(q) == len(columns), "a place of other joints")
    out = still.copy()
    out[[*columns]] = q
    return [float(x) for x in out]


def spread_request(request: Json, still: Array, columns: Sequence[int]) -> Json:
    """A request of some joints as one of the whole."""
    if request is None:
        return None
    goals = [
        goal | {"joints": spread_q(goal["joints"], still, columns)} if "joints" in goal else goal
        for goal in request["goals"]
    ]
    return request | {"start": spread_q(request["start"], still, columns), "goals": goals}


def both(
    document: Json,
    section: Json,
    world: Cell,
    arms: dict[str, Arm],
    still: Array,
    moving: Sequence[Moving],
    late: float,
) -> Iterator[str]:
    """Each two arms that move, over both of their clocks."""
    every = [(motion, name) for motion in moving for name in motion.arms]
    needed = [(one, two) for one, two in combinations(every, 2) if one[0] is not two[0] or late > 0]
    require(
        [each["arms"] for each in section["between"]] == [[one[1], two[1]] for one, two in needed],
        "proofs of other arms than the evidence needs",
    )
    delay = f"by up to {late:.6g} s" if late < math.inf else "for as long as they like"
    for proof, ((first, a), (second, b)) in zip(section["between"], needed, strict=True):
        try:
            least = apart(world, arms, still, proof, (first, a), (second, b), late)
        except (Invalid, LookupError, ValueError) as why:
            raise Invalid(f"{a} x {b}: {why.args[0]}") from why
        free = f"{1e3 * least:.4f} mm" if least < math.inf else "nothing can collide"
        yield f"{a} x {b}: {free} when each is late {delay}, at any time"
    if not needed:
        yield f"no two arms move on clocks of their own; they may be late {delay}"


def apart(
    world: Cell,
    arms: dict[str, Arm],
    still: Array,
    proof: Json,
    one: tuple[Moving, str],
    two: tuple[Moving, str],
    late: float,
) -> float:
    """The clearance that rectangles show between two arms; Invalid if they leave out a pair of places that occurs."""
    (first, a), (second, b) = one, two
    wanted = []
    for x, y in World.wanted(world):
        movers = world.movers[x.body], world.movers[y.body]
        if movers in ((frozenset({a}), frozenset({b})), (frozenset({b}), frozenset({a}))):
            wanted.append((x, y) if movers[0] == {a} else (y, x))
    if not wanted:
        require(proof["clearance"] is None, "a clearance of nothing")
        return math.inf
    require(proof["clearance"] is not None, "no clearance is claimed")
    claimed = float(proof["clearance"])
    require(claimed > LEAST_CLAIM, "a claim that shows no gap")
    times = [unpacked(text, "<f8", 1)[:, 0] for text in proof["times"]]
    for t, motion in zip(times, (first, second), strict=True):
        require(len(t) > 1 and (np.diff(t) >= 0).all(), "times in disorder")
        require(abs(t[0]) <= SLACK and abs(t[-1] - motion.duration) <= SLACK, "times of another motion")
    pairs = unpacked(proof["pairs"], "<i4", 2).astype(int)
    rows, n = np.split(unpacked(proof["rows"], "<i4", 8).astype(int), [5], axis=1)
    n = n / 2.0**30
    require(np.abs(np.linalg.norm(n, axis=1) - 1) < 1e-6, "a direction that is no unit vector")
    number, spans = rows[:, 0], (rows[:, 1:3], rows[:, 3:5])
    require((number >= 0) & (number < len(pairs)), "a pair that is not there")
    for span, t in zip(spans, times, strict=True):
        require((span[:, 0] >= 0) & (span[:, 0] < span[:, 1]) & (span[:, 1] < len(t)), "stretches in disorder")
    require((pairs >= 0).all() and (pairs < world.rides).all(), "pieces that are not there")
    bound = np.zeros(len(rows))
    for side, (motion, name) in enumerate((one, two)):
        bound += half(world, arms[name], still, motion, times[side], spans[side], pairs[number, side], (-n, n)[side])
    lead, least = second.start - first.start, math.inf
    low, high = lead - late - SLACK, lead + late + SLACK
    order = np.lexsort((pairs[number, 1], pairs[number, 0]))
    keys = pairs[number[order]]
    begins = np.flatnonzero(np.r_[True, (keys[1:] != keys[:-1]).any(axis=1)]) if len(keys) else np.zeros(0, int)
    groups = {
        tuple(keys[at].tolist()): group for at, group in zip(begins.tolist(), np.split(order, begins[1:]), strict=True)
    }
    require(len(groups) * 4 <= MOST_WORK, "more than can be checked")
    for x, y in wanted:
        for pair in product(range(x.first, x.end), range(y.first, y.end)):
            group = groups.get(pair)
            require(group is not None, f"{x.name} x {y.name}: nothing is shown")
            assert group is not None
            good = group[bound[group] >= claimed - ROUNDING]
            left = uncovered(times, spans[0][good], spans[1][good], low, high)
            if left is not None:
                best = bound[group].min()
                where = (
                    f"from {left[0]:.6g} to {left[1]:.6g} s and from {left[2]:.6g} to {left[3]:.6g} s of both motions"
                )
                what = f"{1e3 * claimed:.4f} mm claimed, rows show {1e3 * best:.4f} and more"
                raise Invalid(f"{x.name} x {y.name} is not shown apart {where}: {what}")
            least = min(least, bound[good].min(initial=math.inf))
    return least


def half(
    world: Cell, arm: Arm, still: Array, motion: Moving, times: Array, spans: Array, piece: Array, n: Array
) -> Array:
    """What one arm has of the bounds: how far pieces (m,) reach along n (m, 3) from the base's origin, and how far they
    move on stretches (m, 2) of time, both with a minus."""
    s, (stretch, which) = motion.s(times), np.unique(spans, axis=0, return_inverse=True)
    which = which.reshape(-1)
    # time_law lets s(t) turn back by no more than this on a whole motion
    off = NEAR * max(1.0, np.abs(motion.c[:, 1]).max(initial=0.0)) * max(motion.duration, 1.0)
    begin, end = s[stretch[:, 0]] - off, s[stretch[:, 1]] + off
    require(begin <= end, "a stretch that runs back")
    begin, end = np.clip(begin, 0.0, motion.curve.length), np.clip(end, 0.0, motion.curve.length)
    middle = (begin + end) / 2
    require(len(middle) * 16 * len(world.bodies) <= MOST_WORK, "more than can be checked")
    own = arm.columns
    q = np.repeat(still[None], len(middle), axis=0)
    q[:, own] = motion.curve.at(middle)[:, own]
    walked = [motion.curve.at(places, walked=True)[:, own] for places in (begin, middle, end)]
    moved = np.maximum(walked[1] - walked[0], walked[2] - walked[1]) + SLACK
    at, out = placed(world.bodies, q), np.zeros(len(piece))
    most = np.maximum(np.abs(motion.curve.points).max(axis=0), np.abs(still))
    order = np.argsort(piece, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(piece[order])) + 1) if len(order) else ():
        k = int(piece[group[0]])
        body = int(world.on[k])
        require(world.movers[body] == {arm.name}, "a piece of another arm")
        levers = world.levers(k, k + 1, 0, most)[own]
        out[group] = (
            -world.reach(np.full(len(group), k), n[group], at[body, which[group]]) - moved[which[group]] @ levers
        )
    return out


def uncovered(times: Sequence[Array], first: Array, second: Array, low: float, high: float) -> list[float] | None:
    """A rectangle that occurs and is in none of these, in seconds; None if there is none. ``low`` and ``high`` are the
    least and the largest difference of both clocks (lemma of lateness)."""
    x, y = (np.unique([0, len(t) - 1, *span.ravel()]) for t, span in zip(times, (first, second), strict=True))
    require(len(x) * len(y) <= MOST_ENTRIES, "a trail of too many places")
    grid = np.zeros((len(x), len(y)), np.int32)
    ends_of: list[Array] = [np.searchsorted(cuts, span) for cuts, span in ((x, first), (y, second))]
    i, j = ends_of
    for p, q, sign in ((0, 0, 1), (0, 1, -1), (1, 0, -1), (1, 1, 1)):
        np.add.at(grid, (i[:, p], j[:, q]), sign)
    open_ = grid.cumsum(0).cumsum(1)[:-1, :-1] == 0
    a, b = times[0][x], times[1][y]
    ends = a[-1], b[-1]
    a0, a1, b0, b1 = a[:-1, None], a[1:, None], b[None, :-1], b[None, 1:]
    met = (a1 - b0 >= low) & (a0 - b1 <= high)
    met[0] |= b0[0] <= max(-low, 0.0)
    met[-1] |= b1[0] >= min(ends[0] - high, ends[1])
    met[:, 0] |= a0[:, 0] <= max(high, 0.0)
    met[:, -1] |= a1[:, 0] >= min(ends[1] + low, ends[0])
    left: list[list[int]] = np.argwhere(open_ & met).tolist()
    if not left:
        return None
    p, q = left[0]
    return [float(a[p]), float(a[p + 1]), float(b[q]), float(b[q + 1])]
