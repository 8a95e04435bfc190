"""Checks the evidence in a plan or task file, with numpy and the standard library alone.

    python -m auditor plan.json

Of each motion it measures the clearance that the trail of its proof shows (trails.py), bounds constraints
(verify_constraints.py), and checks that time runs along the curve within the limits (time_law.py). What it did not look
at stands in the last line. That the robot and the scene in the file are those in the room it cannot know: compare the
digests.

Its scene, load, gripper and start follow from the motion before: between two, the gripper may take one obstacle, or
leave one thing where it holds it; nothing else changes, and a scene that the file states has to be the same. These
contacts are meant: the robot's own way out of a pose that it names; fingers and what they take or leave, on the
straight approach to where the gripper closes or opens; a thing and what it stood or will stand on, near there; and what
a start touches already, no deeper than the trail shows.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np

from auditor.schema import Invalid, check_file, require
from auditor.time_law import in_time
from auditor.trails import SLACK, Curve, World, digest, frame, placed, shown
from auditor.verify_constraints import kept

__all__ = ["Invalid", "World", "digest", "verify"]

Array = Any
Json = Any

MOST_TURNED = 1000.0  # radians from zero that a joint without end may be at
SAME_PLACE = 1e-5  # metres and radians by which a thing may be taken beside where it stands: inverse kinematics
SAME_WIDTH = 1e-6  # metres
JOIN = 1e-6  # radians or metres between the end of a motion and the start of the next
APPROACH, SUPPORT = 0.10, 0.05  # metres of straight motion on which contact is meant, at most
OFF, TURNED = 1.1e-3, 5.5e-3  # metres and radians by which the tool may leave its line
OVERLAP = 0.003  # metres by which a start may overlap if a request does not say
LITTLE = 1e-7  # metres: what is written of a depth is rounded up
MEANT_OVERLAP = 1e-3  # metres by which the models of things that are meant to touch may overlap
SPACING, MOST_SAMPLES = 0.005, 4000  # radians of path
HEIGHTS, TURNS = np.linspace(-1, 1, 64), np.arange(64) * (math.pi * (3 - math.sqrt(5)))
NEARBY = np.column_stack([*(np.sqrt(1 - HEIGHTS**2) * [np.cos(TURNS), np.sin(TURNS)]), HEIGHTS])
STEPS = (0.3, 0.1, 0.03, 0.01, 0.003, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5)  # to better directions
SEEN = "clearance, limits of joints, their speeds and accelerations, s(t), scenes, loads and the gripper, constraints"
UNSEEN = (
    "padding away from the ends, torques, jerk, the speed of the tool, whether a grasp holds, hashes, start and goals "
    "of a task, which goal, dilation, the gripper's seconds, reports of counts, times, peaks and margins"
)


def verify(document: Json, named: Json = ()) -> Iterator[str]:
    """What a plan file's evidence shows, line by line; Invalid if that is not all that the file claims.

    ``named`` are the pairs that the caller allows to touch. A file that allows any other pair is refused.
    """
    check_file(document)
    require(document.get("ok", True), "a task that failed")
    robot, section, allowed, asked = (document[key] for key in ("robot", "sections", "allowed", "request"))
    section, n, stood = section["evidence"], len(robot["joint_names"]), None
    require(document["version"] == 3, "a file of another version")
    require(section["version"] in (4, 5), f"evidence of version {section['version']}, which is not read: write it anew")
    for part in ("robot", "scene"):
        require(section[part] == digest(document[part]), f"the evidence is for another {part}")
        yield f"{part} {section[part]}"
    for pair in allowed:
        words = "the file lets them touch everywhere; if they may, name them: --allow A B"
        require(set(pair) in map(set, named), f"{' x '.join(pair)}: {words}")
    every, endless = motions(document), np.array(robot.get("continuous") or [False] * n)
    require([len(row) == n for row in (endless, *robot["limits"].values())], "limits of other joints")
    require(len(every) == len(section["proofs"]), "other motions than the evidence is for")
    limits = np.array([robot["limits"]["lower"], robot["limits"]["upper"]], float)
    lower, upper = np.where(endless, [[-MOST_TURNED], [MOST_TURNED]], limits)
    for proof, motion in zip(section["proofs"], every, strict=True):
        name, points, result, claim = motion.name, motion.points, motion.result, motion.claim
        require((points >= lower - SLACK) & (points <= upper + SLACK), f"{name}: a joint leaves its limits")
        same = all(claim[key] == proof[key] for key in ("clearance", "padding", "exempt", "part"))
        same &= proof["motion"] == motion.number and proof["gripper"] == motion.widths
        require(same, f"{name}: the evidence is for another motion, or the certificate claims something else")
        (x, last), alone = proof["moved"], result is None
        require(claim["certified"] and (alone or result["ok"]), f"{name}: a certificate that is none")
        world = World(robot, motion.stand, motion.hold, allowed, section["boxes"], last, alone)
        hands = [World(robot, (), (), (), {}, at) for at in (x, last)]
        fits = (alone or x == last) and stood in (None, x) and all(map(World.stands, hands, motion.widths))
        require(fits, f"{name}: fingers elsewhere")
        curve = Curve(np.column_stack([points, np.linspace(x, last, len(points))]), motion.blends)
        (begin, end), (low, high) = (part or (0.0, curve.length) for part in (motion.part, proof["part"]))
        covers = low <= begin + SLACK and high >= end - SLACK
        require(covers, f"{name}: from s = {begin:.6g} to {end:.6g} it moves, from {low:.6g} to {high:.6g} is proven")
        having = [] if alone else [result, asked or {}, *motion.hold]
        constraints = [constraint for each in having for constraint in each.get("constraints", ())]
        try:
            rules = [*excused(world, curve, motion, robot, proof["exempt"], asked)]
            least = shown(world, proof, curve, low, high)
            for constraint in constraints:
                kept(world, robot, constraint, curve, begin, end)
            paced = [] if alone else in_time(robot, result, asked, Curve(points, motion.blends))
        except (Invalid, LookupError, ValueError) as why:
            raise Invalid(f"{name}: {why.args[0]}") from why
        part = f" from s = {low:.6g} to {high:.6g}" if proof["part"] else ""
        free = f"{1e3 * least:.4f} mm{part}" if least < math.inf else "nothing can collide"
        yield f"{name}: {free}" + f", {len(constraints)} constraints kept" * bool(constraints)
        yield from (f"  {line}" for line in (*paced, *rules))
        yield from (f"  kept: {json.dumps(constraint)}" for constraint in constraints)
        yield from (f"  not judged: {it['name']}, which is held, with {it['touch_links']}" for it in motion.hold)
        yield from (f"  not judged: {a['name']} x {b['name']}, held together" for a, b in combinations(motion.hold, 2))
        stood = last
    yield from (f"never judged: {contact['links']} ({contact['reason']})" for contact in robot["allowed_contacts"])
    yield from (f"never judged: {pair} (allowed by the author, and by who asked)" for pair in allowed)
    yield from reached(document, every[-1])
    others = [f"the section {name}" for name in document["sections"] if name != "evidence"]
    yield f"verified: {SEEN}; not verified: {', '.join([UNSEEN, *others])}"


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
    begin: tuple[str, str]
    end: tuple[str, str] = ("", "")


def motions(document: Json) -> list[Motion]:
    """Each motion in its world, and before it that of the gripper alone, if there is one."""
    robot, scene, alone, found = document["robot"], document["scene"], "segments" not in document, list[Motion]()
    plan = {"name": "motion", "gripper_width": robot["gripper_width"], "gripper": None, "scene": None}
    segments = [plan | {"result": document["result"]}] if alone else document["segments"]
    require(segments, "a task without a motion")
    first = {item["name"]: item for item in scene["obstacles"]}
    stand, hold, width, ends = scene["obstacles"], scene["attached"], robot["gripper_width"], None
    for number, segment in enumerate(segments):
        name, result, grip = segment["name"], segment["result"], segment["gripper"]
        now = segment["gripper_width"] if robot["gripper"] else robot["gripper_width"]
        require(now is not None, f"{name}: no width of the gripper")
        before, carried = (stand, hold), segment["scene"]["attached"] if segment["scene"] else hold
        stand, hold, exchange = exchanged(robot, stand, hold, carried, ends, now - width, f"{name}: at its start")
        if segment["scene"]:
            told = segment["scene"]["obstacles"]
            listed = [first.get(it, {"name": ""}) if isinstance(it, str) else it for it in told]
            here, there = (sorted(these, key=lambda it: it["name"]) for these in (listed, stand))
            alike = len(here) == len(there) and all(map(same, here, there))
            require(alike, f"{name}: other obstacles than follow")
        points = np.array(result["path"]["waypoints"], float)
        require(points.ndim == 2 and points.shape[1] == len(robot["joint_names"]), f"{name}: not of these joints")
        require(ends is None or np.abs(points[0] - ends).max() <= JOIN, f"{name}: begins elsewhere")
        part = result["trajectory"]["part"]
        require(alone or part is None, f"{name}: a part of a motion within a task")
        opened = [grip["start_width"], grip["end_width"]] if grip else [now, now]
        alike = bool(grip) == (now != width) and opened == [width, now]
        require(alike, f"{name}: a motion of the gripper that its widths do not tell")
        found[-1:] = [motion._replace(end=exchange) for motion in found[-1:]]
        claim, blends = result["certificate"], result["path"]["blends"]
        motion = Motion(number, name, points, blends, result, claim, part, [now, now], stand, hold, exchange)
        if grip:
            still = motion._replace(points=points[[0, 0]], blends=[], result=None, claim=grip["certificate"], part=None)
            still = still._replace(name=f"gripper before {name}", widths=opened, stand=before[0], hold=before[1])
            found.append(still._replace(end=exchange))
        found.append(motion)
        width, ends = now, points[-1]
    return found


def same(one: Json, two: Json) -> bool:
    """Whether two obstacles are one, in the same place."""
    alike = one["name"] == two["name"] and one["shape"] == two["shape"]
    return alike and close(frame(one["pose"]), frame(two["pose"]))


def close(a: Array, b: Array) -> bool:
    return bool(np.abs(a - b).max() <= SAME_PLACE)


def tool_at(robot: Json, q: Array) -> Array:
    """The frame (4, 4) of the tool at a configuration."""
    bodies = [{"multiplier": 1.0, **body, "at": frame(body["placement"])} for body in robot["bodies"]]
    return placed(bodies, q[None])[robot["tool_body"], 0] @ frame(robot["tool_placement"])


def exchanged(
    robot: Json, stand: Json, hold: Json, carried: Json, q: Array | None, opens: float, where: str
) -> tuple[Json, Json, tuple[str, str]]:
    """What stands and what is held after the gripper has taken or left something at q, and what that was."""
    gained, lost = ([it for it in these if it not in those] for these, those in ((carried, hold), (hold, carried)))
    kept, grip = [it for it in hold if it in carried], robot["gripper"] or {"links": []}
    require(len(carried) == len(kept) + len(gained), f"{where}: something held twice")
    gripped = any({*grip["links"]} & {*it["touch_links"]} for it in kept)  # the rest is mounted on the tool
    still = abs(opens) <= SAME_WIDTH or (q is None and opens < 0)
    require(still or not gripped, f"{where}: the gripper moves on what it holds")
    if not gained and not lost:
        return stand, hold, ("", "")
    require(q is not None, f"{where}: holds something else than the scene")
    require(len(gained) + len(lost) == 1 and robot["gripper"], f"{where}: holds something else by more than one thing")
    (it,), way = (*gained, *lost), ("left", "open") if lost else ("taken", "close")
    name, moves = it["name"], grip.get("kind") == "vacuum" or (opens if lost else -opens) > SAME_WIDTH
    require(moves, f"{where}: {name} {way[0]} by a gripper that does not {way[1]}")
    thing = {"name": name, "shape": it["shape"], "pose": (tool_at(robot, q) @ frame(it["pose"])).tolist()}
    if lost:
        return [*stand, thing], kept, ("left", name)
    rest = [one for one in stand if not same(one, thing)]
    require(len(rest) == len(stand) - 1, f"{where}: holds {name}, which does not stand there like that")
    require({*it["touch_links"]} <= {*grip["links"]}, f"{where}: more than fingers may touch {name}")
    return rest, [*kept, it], ("taken", name)


def excused(world: World, curve: Curve, motion: Motion, robot: Json, exempt: Json, request: Json) -> Iterator[str]:
    """Why each pair may touch on each exempt stretch, in words; Invalid for one that may not."""
    for each in exempt:
        begin, end, deep = each["s_start"], each["s_end"], each.get("depth")
        require(0 <= begin <= end <= curve.length + SLACK, "an exempt stretch that is not on the curve")
        stretch = f"from s = {begin:.6g} to {end:.6g}"
        for pair in each["pairs"]:
            names = " x ".join(pair)
            require(pair[0] != pair[1] and {*pair} <= {it.name for it in world.solids}, f"{pair}: no such pair")
            if deep is None:
                try:
                    rule = ruled(world, curve, motion, robot, begin, end, frozenset(pair))
                except Invalid as why:
                    raise Invalid(f"{names} is not judged {stretch}: {why}") from why
                yield f"not judged: {names} {stretch} ({rule})"
                continue
            first = motion.number == 0 and motion.result is not None and begin <= (motion.part or [0.0])[0] + SLACK
            require(first and deep > 0, f"{names} may overlap {stretch}, which is not where all begins")
            asked = 0.1 if request is None else request.get("start_overlap", OVERLAP)
            there = overlap(world, curve, begin, *pair, exactly=True)
            claimed = f"{names} may be {1e3 * deep:.4f} mm deep"
            require(deep <= asked + LITTLE, f"{claimed}, {1e3 * asked:g} mm were asked for")
            require(deep <= there + LITTLE, f"{claimed}, at the start {1e3 * there:.4f}")
            yield f"{names}: at most {1e3 * deep:.4f} mm deep {stretch}, shown"


def ruled(
    world: World, curve: Curve, motion: Motion, robot: Json, begin: float, end: float, pair: frozenset[str]
) -> str:
    """The rule by which a pair may touch on a stretch; Invalid if there is none."""
    fingers = {world.label("link", name) for name in world.grip["links"]}
    standing = {it.name for it in world.solids if it.kind == "standing"}
    for way in robot["retreats"]:
        if pair in [frozenset(world.label("link", name) for name in each) for each in way["pairs"]]:
            rest = next(pose["q"] for pose in robot["named_poses"] if pose["name"] == way["pose"])
            ends, points = np.array([rest, way["to"]], float), curve.points[:, : world.column]
            if curve.length == 0 and np.abs(points - rest).max() <= SLACK:
                return f"it stays in {way['pose']}"
            knots, d = np.cumsum([0.0, *curve.steps]), np.pad(curve.d, 1)
            for k, along in ((0, ends), (len(d) - 2, ends[::-1])):
                whole = np.abs(points[k : k + 2] - along).max() <= SLACK and not d[k : k + 2].any()
                if whole and knots[k] - SLACK <= begin and end <= knots[k + 1] + SLACK:
                    return f"the way out of {way['pose']}"
            raise Invalid(f"only on the straight way out of {way['pose']} or back")
    if motion.result is None:
        thing = world.label("standing", motion.begin[1])
        require(motion.begin[0] and thing in pair and pair - {thing} <= fingers, "no rule allows that")
        return "fingers and what they take or leave"
    rules = [(motion.end, curve.length, begin, "taken", fingers), (motion.begin, 0.0, end, "left", fingers)]
    rules += [(motion.begin, 0.0, end, "taken", standing), (motion.end, curve.length, begin, "left", standing)]
    for (kind, name), near, far, wanted, others in rules:
        thing = world.label("standing", name)
        if kind != wanted or thing not in pair or not pair - {thing} <= others:
            continue
        end, longest = min(far, curve.length), APPROACH if others is fingers else SUPPORT
        samples = tool_line(world, curve, near, end, longest, along_approach=others is fingers)
        (other,), places = pair - {thing}, samples[:1] if others is fingers else samples
        depths = [overlap(world, curve, s, thing, other) for s in places]
        most = depths[0] if wanted == "taken" and others is standing else 0.0
        deep = f"{thing} is up to {1e3 * max(depths):.2f} mm deep in {other} there"
        require(max(depths) <= max(MEANT_OVERLAP, most) + 1e-6, deep)
        what = "fingers and what they take or leave" if others is fingers else "a thing and what it stands on"
        return f"{what}, looked at in {len(samples)} places"
    raise Invalid("no rule allows that")


def tool_line(world: World, curve: Curve, near: float, far: float, longest: float, *, along_approach: bool) -> Array:
    """Places from a contact to the other end of a stretch; Invalid if the tool does not go straight there, along its
    approach where that is asked, at most so far and never back."""
    count = math.ceil(abs(far - near) / SPACING)
    require(count <= MOST_SAMPLES, f"{abs(far - near):.3g} rad are no straight line of a tool")
    samples, (body, at) = near + (far - near) * np.arange(count + 1) / max(count, 1), world.tool
    T = placed(world.bodies, curve.at(samples))[body] @ at
    moved, turns = T[:, :3, 3] - T[0, :3, 3], T[:, :3, :3]
    approach = turns[0] @ np.array(world.grip["approach"], float)
    if not along_approach:
        approach = -moved[-1] / max(float(np.linalg.norm(moved[-1])), 1e-300)
    travel = -(moved @ approach)
    aside = np.linalg.norm(moved + travel[:, None] * approach, axis=1).max()
    turned = np.sqrt(((turns - turns[0]) ** 2).sum((1, 2)) / 2).max()
    straight = aside <= OFF and turned <= TURNED and np.diff(travel).min(initial=0.0) >= -OFF / 10
    require(straight, f"the tool leaves the straight line{' along its approach' * along_approach} there")
    require(travel.max() <= longest + OFF, f"the tool is {1e3 * travel.max():.0f} mm away there")
    return samples


def overlap(world: World, curve: Curve, s: float, one: str, two: str, *, exactly: bool = False) -> float:
    """How deep two things overlap at most at a place, metres: the least over some directions, between pieces."""
    at, (body, tool), deepest = placed(world.bodies, curve.at(np.array([s])))[:, 0], world.tool, 0.0
    enough, steps = (0.0, STEPS) if exactly else (-MEANT_OVERLAP, STEPS[:5])
    for a, b in product(*([it for it in world.solids if it.name == name] for name in (one, two))):
        axes = [T[:3, :3].T for T in (at[a.body] @ a.at, at[b.body] @ b.at, at[body] @ tool)]
        (low, high), (others_low, others_high) = (world.extents(it, at[it.body]) for it in (a, b))
        for i in range(a.end - a.first):
            near = ((low[i] <= others_high) & (others_low <= high[i])).all(axis=1)
            for j in np.flatnonzero(near):
                n, gap = np.vstack([sign * own for own in axes for sign in (1, -1)]), -math.inf
                for step in steps:
                    ones = np.ones(len(n), int)
                    frames = np.repeat(at[[a.body, b.body], None], len(n), axis=1)
                    gaps = world.gaps((a.first + i) * ones, (b.first + j) * ones, n, frames)
                    gap, best = max(gap, gaps.max()), n[gaps.argmax()]
                    if gap >= enough:
                        break
                    n = best + step * np.vstack([np.zeros(3), NEARBY])
                    n /= np.linalg.norm(n, axis=1)[:, None]
                deepest = max(deepest, -gap)
    return deepest


def reached(document: Json, last: Motion) -> Iterator[str]:
    """Whether a plan begins and ends where it was asked to; of a task only its parts are checked."""
    request, robot = document["request"], document["robot"]
    if request is None or "segments" in document:
        return
    near, index, goals = request["start_tolerance"] + JOIN, last.result["goal_index"], request["goals"]
    turns = np.array(robot.get("continuous") or [False] * len(robot["joint_names"]))

    def met(q: Json, end: Array) -> bool:
        require(len(q) == len(turns), "a start or a goal of other joints")
        off = np.abs(np.array(q, float) - end)
        return bool(np.where(turns, np.abs((off + math.pi) % (2 * math.pi) - math.pi), off).max() <= near)

    begins = met(request["start"], last.points[0]) or last.part is not None
    require(begins, "it does not begin at the start that was asked for")
    begun = "it begins where the request asks" if last.part is None else "it begins on its way"
    if index is None:
        yield f"{begun}; it ends at no goal"
        return
    require(0 <= index < len(goals), "a goal that is not there")
    whole = last.part is None or last.part[1] >= last.result["path"]["length"] - SLACK
    require(whole, f"it ends before goal {index}")
    goal, end = goals[index], last.points[-1]
    if goal.get("room") is not None:
        yield f"{begun}; not verified: that it ends within the tolerances of goal {index}"
        return
    ends = met(goal["joints"], end) if "joints" in goal else close(tool_at(robot, end), frame(goal["pose"]))
    require(ends, f"it does not end at goal {index}")
    yield f"{begun} and ends at goal {index}"
