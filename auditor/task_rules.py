"""What follows for each motion of a task from the one before: its scene, its load, its gripper, its start, and which
pairs may touch where because contact is meant.

Between two motions the gripper may take one obstacle, or leave one thing where it holds it; nothing else changes. So
every scene but the first is worked out here, and one that the file states has to be the same. These contacts are meant:
the robot's own way out of a pose that it names; fingers and what they take or leave, on the straight approach to where
the gripper closes or opens; a thing and what it stood or will stand on, near there; and what a start touches already,
no deeper than the trail shows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from auditor.trails import SLACK, Curve, World, frame, placed, require

Array = Any
Json = Any

SAME_PLACE = 1e-5  # metres and radians by which a thing may be taken beside where it stands: inverse kinematics
SAME_WIDTH = 1e-6  # metres
JOIN = 1e-6  # radians or metres between the end of a motion and the start of the next
APPROACH, SUPPORT = 0.10, 0.05  # metres of straight motion on which contact is meant, at most
OFF, TURNED = 1.1e-3, 5.5e-3  # metres and radians by which the tool may leave its line
OVERLAP = 0.003  # metres by which a start may overlap if a request does not say
LITTLE = 1e-7  # metres: what is written of a depth is rounded up
MEANT_OVERLAP = 1e-3  # metres by which the models of things that are meant to touch may overlap
SPACING, MOST_SAMPLES = 0.005, 4000  # radians of path


class Motion(NamedTuple):
    """A motion of the arm, or of the gripper alone if ``result`` is None. ``begin`` and ``end`` are the exchanges of
    the gripper before and after it: "taken" or "left", and the name."""

    number: int
    name: str
    points: Array
    blends: Json
    result: Json
    claim: Json
    part: Json
    widths: list[float]
    stand: Json
    hold: Json
    begin: tuple[str, str] | None
    end: tuple[str, str] | None


def motions(document: Json) -> Iterator[Motion]:
    """Each motion in its world, and before it that of the gripper alone, if there is one."""
    robot, scene = document["robot"], document["scene"]
    plan = {"name": "motion", "gripper_width": robot["gripper_width"], "gripper": None, "scene": None}
    segments = document["segments"] if "segments" in document else [plan | {"result": document["result"]}]
    require(segments, "a task without a motion")
    first = {item["name"]: item for item in scene["obstacles"]}
    stand, hold, width, ends = scene["obstacles"], scene["attached"], robot["gripper_width"], None
    steps = list[Any]()
    for segment in segments:
        name, now = segment["name"], segment["gripper_width"] if robot["gripper"] else robot["gripper_width"]
        require(now is not None, f"{name}: no width of the gripper")
        carried, exchange = (segment["scene"] or {"attached": hold})["attached"], None
        if ends is None:
            require(carried == hold, f"{name}: holds something else than the scene at the start")
            require(
                now <= width + SAME_WIDTH or not gripped(robot, hold), f"{name}: a gripper that drops what it holds"
            )
        else:
            where = f"{name}: after the motion before it"
            stand, hold, exchange = exchanged(robot, stand, hold, carried, ends, (width, now), where)
        if segment["scene"]:
            listed = [first.get(item) if isinstance(item, str) else item for item in segment["scene"]["obstacles"]]
            alike(listed, stand, name)
        points = np.array(segment["result"]["path"]["waypoints"], float)
        require(points.ndim == 2 and points.shape[1] == len(robot["joint_names"]), f"{name}: not of these joints")
        require(ends is None or np.abs(points[0] - ends).max() <= JOIN, f"{name}: begins elsewhere")
        alone = "segments" not in document
        require(alone or segment["result"]["trajectory"]["part"] is None, f"{name}: a part of a motion within a task")
        steps.append((segment, stand, hold, now, exchange))
        width, ends = now, points[-1]
    before, around = robot["gripper_width"], (scene["obstacles"], scene["attached"])
    for number, ((segment, stand, hold, width, begin), following) in enumerate(pairwise([*steps, None])):
        result, points = segment["result"], np.array(segment["result"]["path"]["waypoints"], float)
        grip = segment["gripper"]
        moves = before != width
        require(bool(grip) == moves, f"{segment['name']}: a motion of the gripper that its widths do not tell")
        if moves:
            require([grip["start_width"], grip["end_width"]] == [before, width], f"{segment['name']}: other widths")
            name, claim = f"gripper before {segment['name']}", grip["certificate"]
            yield Motion(number, name, points[[0, 0]], [], None, claim, None, [before, width], *around, begin, begin)
        end, part = None if following is None else following[4], result["trajectory"]["part"]
        yield Motion(
            *(number, segment["name"], points, result["path"]["blends"], result, result["certificate"]),
            *(part, [width, width], stand, hold, begin, end),
        )
        before, around = width, (stand, hold)


def gripped(robot: Json, hold: Json) -> list[str]:
    """What the fingers hold; the rest is mounted on the tool."""
    links = set((robot["gripper"] or {"links": []})["links"])
    return [item["name"] for item in hold if links & set(item["touch_links"])]


def tool_at(robot: Json, q: Array) -> Array:
    """Frames (m, 4, 4) of the tool at configurations q (m, n)."""
    bodies = [{"multiplier": 1.0, **body, "at": frame(body["placement"])} for body in robot["bodies"]]
    return placed(bodies, q)[robot["tool_body"]] @ frame(robot["tool_placement"])


def exchanged(
    robot: Json, stand: Json, hold: Json, carried: Json, q: Array, widths: tuple[float, float], where: str
) -> tuple[Json, Json, tuple[str, str] | None]:
    """What stands and what is held after the gripper has taken or left something at q, and what that was."""
    gained, lost = ([it for it in these if it not in those] for these, those in ((carried, hold), (hold, carried)))
    kept, opens = [it for it in hold if it in carried], widths[1] - widths[0]
    require(len(carried) == len(kept) + len(gained), f"{where}: something held twice")
    require(abs(opens) <= SAME_WIDTH or not gripped(robot, kept), f"{where}: the gripper moves on what it holds")
    if not gained and not lost:
        return stand, hold, None
    require(len(gained) + len(lost) == 1 and robot["gripper"], f"{where}: holds something else by more than one thing")
    tool, sucks = tool_at(robot, q[None])[0], robot["gripper"].get("kind") == "vacuum"
    (it,) = (*gained, *lost)
    place = tool @ frame(it["pose"])
    if lost:
        require(sucks or opens > SAME_WIDTH, f"{where}: {it['name']} left by a gripper that does not open")
        left = {"name": it["name"], "shape": it["shape"], "pose": place.tolist()}
        return [*stand, left], kept, ("left", it["name"])
    require(sucks or opens < -SAME_WIDTH, f"{where}: {it['name']} taken by a gripper that does not close")
    there = [one for one in stand if one["name"] == it["name"]]
    require(
        len(there) == 1 and there[0]["shape"] == it["shape"], f"{where}: holds {it['name']}, which does not stand there"
    )
    require(close(place, frame(there[0]["pose"])), f"{where}: {it['name']} is taken elsewhere than where it stands")
    require(
        set(it["touch_links"]) <= set(robot["gripper"]["links"]), f"{where}: more than fingers may touch {it['name']}"
    )
    return [one for one in stand if one is not there[0]], [*kept, it], ("taken", it["name"])


def close(a: Array, b: Array) -> bool:
    return bool(np.abs(a - b).max() <= SAME_PLACE)


def alike(listed: Json, stand: Json, name: str) -> None:
    """Require what a file says that stands around a motion to be what follows."""
    here, there = ({it["name"]: it for it in these if it} for these in (listed, stand))
    require(
        len(listed) == len(here) == len(stand) and here.keys() == there.keys(), f"{name}: other obstacles than follow"
    )
    for key, it in here.items():
        same = it["shape"] == there[key]["shape"] and close(frame(it["pose"]), frame(there[key]["pose"]))
        require(same, f"{name}: {key} is not where or what it was")


def excused(world: World, curve: Curve, motion: Motion, robot: Json, exempt: Json, request: Json) -> Iterator[str]:
    """Why each pair may touch on each exempt stretch, in words; Invalid for one that may not."""
    for each in exempt:
        begin, end, deep = each["s_start"], each["s_end"], each.get("depth")
        require(0 <= begin <= end <= curve.length + SLACK, "an exempt stretch that is not on the curve")
        stretch = f"from s = {begin:.6g} to {end:.6g}"
        for pair in each["pairs"]:
            require(pair[0] != pair[1] and {*pair} <= {it.name for it in world.solids}, f"{pair}: no such pair")
            if deep is not None:
                first = motion.number == 0 and motion.result is not None and begin <= (motion.part or [0.0])[0] + SLACK
                require(first and deep > 0, f"{pair} may overlap {stretch}, which is not where all begins")
                asked = 0.1 if request is None else request.get("start_overlap", OVERLAP)
                require(
                    deep <= asked + LITTLE, f"{pair} may be {1e3 * deep:.4f} mm deep, {1e3 * asked:g} mm were asked for"
                )
                there = overlap(world, curve, begin, *pair, exactly=True)
                require(
                    deep <= there + LITTLE, f"{pair} may be {1e3 * deep:.4f} mm deep, at the start {1e3 * there:.4f}"
                )
                yield f"{' x '.join(pair)}: at most {1e3 * deep:.4f} mm deep {stretch}, shown"
                continue
            rule, why = ruled(world, curve, motion, robot, (begin, end), frozenset(pair))
            require(rule, f"{' x '.join(pair)} is not judged {stretch}: {why or 'no rule allows that'}")
            yield f"not judged: {' x '.join(pair)} {stretch} ({rule})"


def ruled(
    world: World, curve: Curve, motion: Motion, robot: Json, stretch: tuple[float, float], pair: frozenset[str]
) -> tuple[str, str]:
    """The rule by which a pair may touch on a stretch, or "" and why not."""

    def link(name: str) -> str:
        return world.label("link", name)

    def object_(name: str) -> str:
        return world.label("standing", name)

    for way in robot["retreats"]:
        if pair in [frozenset(map(link, each)) for each in way["pairs"]]:
            rest = np.array(next(pose["q"] for pose in robot["named_poses"] if pose["name"] == way["pose"]), float)
            ends, knots = (rest, np.array(way["to"], float)), np.cumsum([0.0, *curve.steps])
            if curve.length == 0 and np.abs(curve.points[:, : len(rest)] - rest).max() <= SLACK:
                return f"it stays in {way['pose']}", ""
            for k, (low, high) in ((0, knots[:2]), (len(knots) - 2, knots[-2:])):
                piece = curve.points[k : k + 2, : len(rest)]
                straight = not np.append([0.0, 0.0], np.pad(curve.d, 1)[k : k + 2]).any()
                same = np.abs(piece - (ends if k == 0 else ends[::-1])).max() <= SLACK
                if straight and same and low - SLACK <= stretch[0] and stretch[1] <= high + SLACK:
                    return f"the way out of {way['pose']}", ""
            return "", f"only on the straight way out of {way['pose']} or back"
    fingers = {link(name) for name in world.grip["links"]}
    if motion.result is None:
        thing = object_(motion.begin[1]) if motion.begin else ""
        return ("fingers and what they take or leave" if thing in pair and pair - {thing} <= fingers else ""), ""
    standing = {it.name for it in world.solids if it.kind == "standing"}
    for exchange, close_by, others, longest in (
        (motion.end, True, ("taken", fingers), APPROACH),
        (motion.begin, False, ("left", fingers), APPROACH),
        (motion.begin, False, ("taken", standing), SUPPORT),
        (motion.end, True, ("left", standing), SUPPORT),
    ):
        kind, group = others
        if exchange is None or exchange[0] != kind or object_(exchange[1]) not in pair:
            continue
        thing = object_(exchange[1])
        if not pair - {thing} <= group:
            continue
        near, far = (curve.length, stretch[0]) if close_by else (0.0, min(stretch[1], curve.length))
        samples, why = tool_line(world, curve, near, far, longest)
        if why:
            return "", why
        (other,) = pair - {thing}
        places = samples[:1] if group is fingers else samples
        depths = [overlap(world, curve, s, thing, other) for s in places]
        most = MEANT_OVERLAP if close_by or group is fingers else max(MEANT_OVERLAP, depths[0])
        if max(depths) > most + 1e-6:
            return "", f"{thing} is up to {1e3 * max(depths):.2f} mm deep in {other} there"
        what = "fingers and what they take or leave" if group is fingers else "a thing and what it stands on"
        return f"{what}, looked at in {len(samples)} places", ""
    return "", ""


def tool_line(world: World, curve: Curve, near: float, far: float, longest: float) -> tuple[Array, str]:
    """Places from a contact to the other end of a stretch, and what is wrong if the tool does not go straight there
    along its approach, at most so far and never back."""
    count = math.ceil(abs(far - near) / SPACING)
    if count > MOST_SAMPLES:
        return np.zeros(0), f"{abs(far - near):.3g} rad are no straight line of a tool"
    samples = near + (far - near) * np.arange(count + 1) / max(count, 1)
    body, at = world.tool
    T = placed(world.bodies, curve.at(samples))[body] @ at
    moved, turns = T[:, :3, 3] - T[0, :3, 3], T[:, :3, :3]
    approach = turns[0] @ np.array(world.grip["approach"], float)
    travel = -(moved @ approach)
    aside = np.linalg.norm(moved + travel[:, None] * approach, axis=1).max()
    turned = np.sqrt(((turns - turns[0]) ** 2).sum((1, 2)) / 2).max()
    if aside > OFF or turned > TURNED or np.diff(travel).min(initial=0.0) < -OFF / 10:
        return samples, "the tool leaves the straight line along its approach there"
    return samples, "" if travel.max() <= longest + OFF else f"the tool is {1e3 * travel.max():.0f} mm away there"


def overlap(world: World, curve: Curve, s: float, one: str, two: str, *, exactly: bool = False) -> float:
    """How deep two things overlap at most at a place, metres: the least over some directions, between pieces."""
    at = placed(world.bodies, curve.at(np.array([s])))[:, 0]
    body, tool = world.tool
    deepest = 0.0
    firsts, seconds = ([it for it in world.solids if it.name == name] for name in (one, two))
    for first, second in ((a, b) for a in firsts for b in seconds):
        axes = [at[first.body] @ first.at, at[second.body] @ second.at, at[body] @ tool]
        n = np.vstack([x for T in axes for x in (T[:3, :3].T, -T[:3, :3].T)])
        for i, j in ((i, j) for i in range(first.end - first.first) for j in range(second.end - second.first)):
            directions, gap = n, -math.inf
            for step in (0.3, 0.1, 0.03, 0.01, 0.003, *((1e-3, 3e-4, 1e-4, 3e-5, 1e-5) if exactly else ())):
                gaps = _gaps(world, at, first.first + i, second.first + j, directions)
                gap, best = max(gap, gaps.max()), directions[gaps.argmax()]
                if gap >= (0.0 if exactly else -MEANT_OVERLAP):
                    break
                around = best + step * np.vstack([np.zeros(3), NEARBY])
                directions = around / np.linalg.norm(around, axis=1)[:, None]
            deepest = max(deepest, -gap)
    return deepest


def _gaps(world: World, at: Array, a: int, b: int, n: Array) -> Array:
    """Gaps (m,) between two pieces along directions n (m, 3)."""
    reaches = [
        world.reach(np.full(len(n), k), np.full(len(n), k + 1), x, np.tile(at[world.on[k]], (len(n), 1, 1)))
        for k, x in ((a, -n), (b, n))
    ]
    return -reaches[0] - reaches[1]


TURNS = np.arange(64) * (math.pi * (3 - math.sqrt(5)))
HEIGHTS = np.linspace(-1, 1, 64)
NEARBY = np.column_stack([np.sqrt(1 - HEIGHTS**2) * np.cos(TURNS), np.sqrt(1 - HEIGHTS**2) * np.sin(TURNS), HEIGHTS])


def reached(document: Json, last: Motion) -> Iterator[str]:
    """Whether a plan begins and ends where it was asked to; of a task only its parts are checked."""
    request, robot = document["request"], document["robot"]
    if request is None or "segments" in document:
        return
    near, index = request["start_tolerance"] + JOIN, last.result["goal_index"]
    turns = np.array(robot.get("continuous") or [False] * len(robot["joint_names"]))

    def away(q: Json, end: Array) -> float:
        off = np.abs(np.array(q, float) - end)
        return float(np.where(turns, np.abs((off + math.pi) % (2 * math.pi) - math.pi), off).max())

    require(len(request["start"]) == len(turns), "a start of other joints")
    begins = last.part is not None or away(request["start"], last.points[0]) <= near
    require(begins, "it does not begin at the start that was asked for")
    begun = "it begins where the request asks" if last.part is None else "it begins on its way"
    if index is None:
        yield f"{begun}; it ends at no goal"
        return
    require(0 <= index < len(request["goals"]), "a goal that is not there")
    goal = request["goals"][index]
    if "joints" in goal:
        same = len(goal["joints"]) == len(turns) and away(goal["joints"], last.points[-1]) <= near
        require(same, f"it does not end at goal {index}")
    elif goal["room"] is None:
        require(close(tool_at(robot, last.points[-1:])[0], frame(goal["pose"])), f"it does not end at goal {index}")
    else:
        yield f"{begun}; not verified: that it ends within the tolerances of goal {index}"
        return
    yield f"{begun} and ends at goal {index}"
